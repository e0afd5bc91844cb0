"""Predictions of trained models: what the model says, image by image; and rotations that fit several views."""

import contextlib
import dataclasses
import re
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from bench_sets import small_set
from made_sets import make_set

from symsol_annot.bench.models import devices
from symsol_annot.bench.models.inference import identity, predict
from symsol_annot.bench.models.methods.hypotheses import method as hypothesis_method
from symsol_annot.bench.models.methods.logits import LogitsByIndex
from symsol_annot.bench.models.methods.method import HYPOTHESES, Asked
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.models.training.checkpoints import Checkpoint, new_model
from symsol_annot.bench.models.training.record import TrainingRecord
from symsol_annot.bench.models.views import in_all_views, probability_in_all_views
from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.errors import ModelError, PredictionsError, RotationError, SettingsError
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)
ROOT = Path(__file__).resolve().parents[3]
CPU = torch.device("cpu")


def checkpoint(name, of="tetX", size=(16, 16)):
    """A model with first weights, as if it had been trained."""
    recipe = load_recipe(name).for_object(of, has_marking=True)
    record = TrainingRecord(name, recipe, of, size, "", 1, 0, "", (), {})
    return Checkpoint(Path("model"), record, new_model(recipe, None, 0).eval())


@pytest.fixture(scope="module")
def few_images(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("inference"), "tetX", images=5)


def test_hypotheses_are_the_models_of_each_image(few_images, tmp_path, monkeypatch):
    monkeypatch.setattr(hypothesis_method, "_BLOCK", 2)
    given = checkpoint("small-wta")
    assert predict(given, few_images, tmp_path / "preds.h5", CPU) == ("hypotheses",)
    with h5py.File(tmp_path / "preds.h5") as file:
        assert (file.attrs["method"], file["hypotheses"].shape) == ("small-wta", (5, 30, 3, 3))
        for i, found in enumerate(file["hypotheses"]):
            expected = given.model(torch.from_numpy(few_images[i].image)[None])[0].detach()
            np.testing.assert_allclose(found, expected, atol=1e-5)


def test_probabilities_are_the_models_at_the_queries_and_on_the_grid(few_images, tmp_path):
    given = checkpoint("small-classifier")
    given.model.second_stage.logit.bias.data += 1.5  # so that some are above the floor
    assert predict(given, few_images, tmp_path / "preds.h5", CPU, method="mine", level=1) == ("classifier",)
    queries = Queries(few_images.fingerprint, few_images.symmetry_group)
    grid = torch.from_numpy(equivolumetric_grid(1)).float()
    with h5py.File(tmp_path / "preds.h5") as file, torch.no_grad():
        assert (file.attrs["method"], file.attrs["grid_level"]) == ("mine", 1)
        for i, sample in enumerate(few_images):
            asked = torch.from_numpy(queries.rotations(i, sample.rotation)).float()
            image = torch.from_numpy(sample.image)[None]
            at_queries, on_grid = (given.model(image, R)[0].sigmoid().numpy() for R in (asked, grid))
            np.testing.assert_allclose(file["query_probability"][i], at_queries, atol=1e-5)
            start, end = file["grid_offsets"][i : i + 2]
            dense = np.zeros(len(grid))
            dense[file["grid_indices"][start:end]] = file["grid_probabilities"][start:end]
            np.testing.assert_allclose(dense, on_grid, atol=1e-5)
            assert end - start == len(grid)


@pytest.fixture
def has_bfloat16(monkeypatch):
    monkeypatch.setattr(devices, "has_bfloat16", lambda _: True)


@pytest.mark.usefixtures("has_bfloat16")
def test_bfloat16_scores_rotations_to_its_own_rounding(few_images, tmp_path):
    given, found = checkpoint("small-classifier"), {}
    given.model.second_stage.logit.bias.data += 1.5
    for precision in ("float32", "bfloat16", "auto"):
        predict(given, few_images, tmp_path / precision, CPU, level=1, precision=precision)
        found[precision] = columns(tmp_path / precision)["query_probability"]
    np.testing.assert_allclose(found["bfloat16"], found["float32"], atol=5e-3)
    np.testing.assert_array_equal(found["bfloat16"], found["auto"])


@pytest.mark.usefixtures("has_bfloat16")
def test_answers_in_another_precision_are_not_resumed(few_images, tmp_path, monkeypatch):
    stop(monkeypatch, checkpoint("small-classifier"), few_images, tmp_path / "preds.h5", precision="bfloat16")
    with pytest.raises(PredictionsError, match="in bfloat16"):
        predict(checkpoint("small-classifier"), few_images, tmp_path / "preds.h5", CPU, level=0)


@pytest.mark.usefixtures("has_bfloat16")
def test_a_network_that_scores_no_rotations_answers_in_float32(few_images, tmp_path):
    for precision in ("float32", "bfloat16"):
        predict(checkpoint("small-wta"), few_images, tmp_path / precision, CPU, precision=precision)
    assert (tmp_path / "float32").read_bytes() == (tmp_path / "bfloat16").read_bytes()


def test_what_a_grid_brings_is_worked_out_once_by_threads_that_ask_together(few_images, monkeypatch):
    of_class = LogitsByIndex.__dict__["_shares_of_grid"]
    monkeypatch.setattr(of_class, "lock", contextlib.nullcontext(), raising=False)  # as from Python 3.12 on
    calls, shares = [], LogitsByIndex._shares

    def slow_shares(logits, R):
        calls.append(len(R))
        time.sleep(0.2)
        return shares(logits, R)

    monkeypatch.setattr(LogitsByIndex, "_shares", slow_shares)
    grid = equivolumetric_grid(0)
    asked = LogitsByIndex(checkpoint("small-classifier").model, 0, few_images, grid, Asked("mine", 0, "", {}))
    with ThreadPoolExecutor(3) as pool:
        first, *others = pool.map(asked.on_grid, [0, 0, 0])
    assert calls == [len(grid)]
    assert all(torch.equal(first, other) for other in others)


def test_covering_hypotheses_are_written_alone_and_say_so(few_images, tmp_path):
    given, path = checkpoint("mixture"), tmp_path / "preds.h5"
    assert predict(given, few_images, path, CPU, hypotheses="covering") == ("hypotheses",)
    with h5py.File(path) as file:
        assert file.attrs["method"] == "mixture-covering"
        assert file["hypotheses"].shape == (5, 180, 3, 3)
        assert "density" not in file
    assert predict(given, few_images, tmp_path / "surest.h5", CPU, hypotheses="surest") == ("hypotheses",)
    with h5py.File(tmp_path / "surest.h5") as file:
        assert file["hypotheses"].shape == (5, 1, 3, 3)
    names = {identity(given, hypotheses=which) for which in HYPOTHESES}
    assert len(names) == 3  # kept answers of one are not taken for another's


def test_hypotheses_that_a_model_does_not_choose_are_refused(few_images, tmp_path):
    with pytest.raises(SettingsError, match=r"'covering' can be asked of .*, and this is of the kind hypotheses"):
        predict(checkpoint("small-wta"), few_images, tmp_path / "preds.h5", CPU, hypotheses="covering")
    with pytest.raises(SettingsError, match="expected balanced, covering, surest, found 'many'"):
        predict(checkpoint("mixture"), few_images, tmp_path / "preds.h5", CPU, hypotheses="many")
    assert not list(tmp_path.iterdir())


def test_a_model_of_another_object_or_size_is_refused(few_images, tmp_path):
    with pytest.raises(ModelError, match=r"was trained on cylO, the set in .* is of tetX"):
        predict(checkpoint("small-wta", of="cylO"), few_images, tmp_path / "preds.h5", CPU)
    with pytest.raises(ModelError, match=r"on images of 224x224 pixels, those in .* have 16x16; .*--size 224"):
        predict(checkpoint("small-wta", size=(224, 224)), few_images, tmp_path / "preds.h5", CPU)
    assert not (tmp_path / "preds.h5").exists()


@pytest.mark.parametrize("recipe", ["small-classifier", "implicit-pdf"])
def test_weights_that_are_of_no_use_are_refused(few_images, tmp_path, recipe):
    given = checkpoint(recipe, size=(16, 16))
    given.model.second_stage.hidden.weight.data[0, 0] = float("nan")
    with pytest.raises(ModelError, match="image 0: the model's answers are not finite"):
        predict(given, few_images, tmp_path / "preds.h5", CPU, level=0)
    assert not (tmp_path / "preds.h5").exists()


def test_a_gpu_that_is_too_small_takes_fewer_images_at_once(few_images, tmp_path, monkeypatch):
    tried, run = [], hypothesis_method.all_hypotheses

    def hungry(model, images, batch_size):
        tried.append(batch_size)
        if batch_size > 2:
            raise torch.cuda.OutOfMemoryError
        return run(model, images, batch_size)

    monkeypatch.setattr(hypothesis_method, "all_hypotheses", hungry)
    predict(checkpoint("small-wta"), few_images, tmp_path / "preds.h5", CPU)
    assert tried == [64, 32, 16, 8, 4, 2]
    monkeypatch.setattr(hypothesis_method, "all_hypotheses", lambda *_: hungry(*_[:2], 64))
    with pytest.raises(ModelError, match="does not hold the network and a single image"):
        predict(checkpoint("small-wta"), few_images, tmp_path / "preds.h5", CPU)


# --- stopped, and resumed ---

MODELS = {"hypotheses": "small-wta", "classifier": "small-classifier"}
every_track = pytest.mark.parametrize("track", MODELS)


def stop(monkeypatch, given, images, path, **options):
    """Predict, and be interrupted at the fourth image."""
    hypotheses, on_grid, calls = hypothesis_method.all_hypotheses, LogitsByIndex.on_grid, []

    def interrupted_hypotheses(*arguments):
        calls.append(1)
        if len(calls) == 4:
            raise KeyboardInterrupt
        return hypotheses(*arguments)

    def interrupted_on_grid(logits, i):
        if i == 3:
            raise KeyboardInterrupt
        return on_grid(logits, i)

    with monkeypatch.context() as patch:
        patch.setattr(hypothesis_method, "_BLOCK", 1)
        patch.setattr(hypothesis_method, "all_hypotheses", interrupted_hypotheses)
        patch.setattr(LogitsByIndex, "on_grid", interrupted_on_grid)
        with pytest.raises(KeyboardInterrupt):
            predict(given, images, path, CPU, level=0, **options)


def other_weights(track):
    """A checkpoint of the same recipe whose weights differ in one number's last bit."""
    other = checkpoint(MODELS[track])
    weight = next(iter(other.model.parameters()))
    weight.data.view(torch.int32).view(-1)[0] ^= 1
    return other


def columns(path):
    with h5py.File(path) as file:
        return {name: file[name][...] for name in file}


@every_track
def test_the_same_model_resumes_and_a_line_says_what_is_kept(few_images, tmp_path, monkeypatch, caplog, track):
    path = tmp_path / "preds.h5"
    stop(monkeypatch, checkpoint(MODELS[track]), few_images, path)
    copied = dataclasses.replace(checkpoint(MODELS[track]), path=tmp_path / "a" / "copy")
    predict(copied, few_images, path, CPU, level=0)
    (line,) = caplog.messages
    assert re.search(r"3 of 5 answers are kept of small-\w+ after 0 of 1 epochs, SHA-256 [0-9a-f]{64}, by symsol", line)
    predict(checkpoint(MODELS[track]), few_images, tmp_path / "whole.h5", CPU, level=0)
    resumed, whole = columns(path), columns(tmp_path / "whole.h5")
    for name in whole:
        np.testing.assert_allclose(resumed[name], whole[name], atol=1e-5)


@every_track
def test_another_models_answers_are_refused_by_the_name_of_both(few_images, tmp_path, monkeypatch, track):
    path, first, second = tmp_path / "preds.h5", checkpoint(MODELS[track]), other_weights(track)
    stop(monkeypatch, first, few_images, path)
    assert identity(first) != identity(second)
    with pytest.raises(PredictionsError) as refused:
        predict(second, few_images, path, CPU, level=0)
    for model in (first, second):
        assert identity(model) in str(refused.value)
    assert len(list((tmp_path / "preds.h5.parts" / track).glob("*.answer"))) == 3
    assert not path.exists()
    predict(first, few_images, path, CPU, level=0)


@pytest.mark.parametrize(
    ("changes", "words"), [({"method": "b"}, "method there 'a', now 'b'"), ({}, "method there 'a'")]
)
def test_another_method_or_level_does_not_resume(few_images, tmp_path, monkeypatch, changes, words):
    path = tmp_path / "preds.h5"
    stop(monkeypatch, checkpoint("small-classifier"), few_images, path, method="a")
    with pytest.raises(PredictionsError, match=words):
        predict(checkpoint("small-classifier"), few_images, path, CPU, level=0, **changes)
    with pytest.raises(PredictionsError, match="grid_level there 0, now 1"):
        predict(checkpoint("small-classifier"), few_images, path, CPU, level=1, method="a")


@pytest.mark.parametrize("change", [{"epochs": 2}, {"rows": ({"loss": 1.0},)}])
def test_a_models_name_tells_its_training(change):
    given = checkpoint("small-wta")
    assert identity(given) == identity(checkpoint("small-wta"))
    assert identity(dataclasses.replace(given, record=dataclasses.replace(given.record, **change))) != identity(given)


def test_answers_of_another_version_of_the_program_are_another_models(monkeypatch):
    before = identity(checkpoint("small-wta"))
    monkeypatch.setattr("symsol_annot.__version__", "99.0")
    assert identity(checkpoint("small-wta")) != before


# --- several views ---


def test_a_rotation_fits_all_views_if_it_fits_each(few_images):
    """By the definition, view by view: R_w2c R is asked of the view's own image."""
    model = checkpoint("small-classifier").model
    images = torch.from_numpy(np.stack([few_images[i].image for i in range(3)]))
    R_w2c, R = (torch.from_numpy(uniform_rotations(n, np.random.default_rng(n))).float() for n in (3, 40))
    with torch.no_grad():
        each = torch.stack([model(images[v : v + 1], R_w2c[v] @ R)[0].sigmoid() for v in range(3)])
    found = probability_in_all_views(model, images, R_w2c, R)
    torch.testing.assert_close(found, each.amin(dim=0))
    threshold = float(found.median())
    assert torch.equal(in_all_views(model, images, R_w2c, R, threshold), (each > threshold).all(dim=0))
    turned = probability_in_all_views(model, images, R_w2c.mT, R)
    assert not torch.allclose(found, turned)


def test_one_view_in_its_own_frame_is_the_classifier(few_images):
    model = checkpoint("small-classifier").model
    image = torch.from_numpy(few_images[0].image)[None]
    R = torch.from_numpy(uniform_rotations(9, np.random.default_rng(0))).float()
    found = probability_in_all_views(model, image, torch.eye(3)[None], R)
    torch.testing.assert_close(found, model(image, R)[0].sigmoid().detach())


def test_rotations_that_are_not_one_a_view_are_refused(few_images):
    model = checkpoint("small-classifier").model
    images = torch.zeros((2, 16, 16, 3), dtype=torch.uint8)
    with pytest.raises(RotationError, match=r"for each of 2 views, \(2, 3, 3\).*found \(3, 3\)"):
        probability_in_all_views(model, images, torch.eye(3), torch.eye(3)[None])


def test_the_examples_of_the_training_page_run(tmp_path, monkeypatch):
    make_set(tmp_path / "data", "tetX", test=2, size=16, annotate="all").rename(tmp_path / "data" / "cylO")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(
        "symsol_annot.bench.models.training.checkpoints.open_checkpoint", lambda _: checkpoint("small-classifier")
    )
    names = {}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs/training.md").read_text(), flags=re.DOTALL):
        exec(block.replace("equivolumetric_grid()", "equivolumetric_grid(1)"), names)
    assert names["fits"].shape == (576,)
    both = load("data/cylO")
    np.testing.assert_allclose(names["R_w2c"][1] @ both[0].rotation, both[1].rotation, atol=1e-6)
