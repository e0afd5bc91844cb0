"""Predictions of trained models: what the model says, image by image; and rotations that fit several views."""

import re
from pathlib import Path

import h5py
import numpy as np
import pytest
import torch
from bench_sets import small_set
from conftest import make_set

from symsol_annot.bench import inference
from symsol_annot.bench.checkpoints import Checkpoint, TrainingRecord, new_model
from symsol_annot.bench.inference import predict
from symsol_annot.bench.queries import Queries
from symsol_annot.bench.recipe import load_recipe
from symsol_annot.bench.views import in_all_views, probability_in_all_views
from symsol_annot.dataset import load
from symsol_annot.errors import ModelError, RotationError
from symsol_annot.grid import equivolumetric_grid
from symsol_annot.so3 import uniform_rotations

torch.set_num_threads(1)
ROOT = Path(__file__).resolve().parent.parent
CPU = torch.device("cpu")


def checkpoint(name, of="tetX", size=(16, 16)):
    """A model with first weights, as if it had been trained."""
    recipe = load_recipe(name).for_object(of, has_marking=True)
    record = TrainingRecord(name, recipe, of, size, "", 1, 0, "", (), {})
    return Checkpoint(Path("model"), record, new_model(recipe, None, 0).eval())


@pytest.fixture(scope="module")
def test_split(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("inference"), "tetX", images=5)


def test_hypotheses_are_the_models_of_each_image(test_split, tmp_path, monkeypatch):
    monkeypatch.setattr(inference, "_BLOCK", 2)
    given = checkpoint("small-wta")
    assert predict(given, test_split, tmp_path / "preds.h5", CPU) == "hypotheses"
    with h5py.File(tmp_path / "preds.h5") as file:
        assert (file.attrs["method"], file["hypotheses"].shape) == ("small-wta", (5, 30, 3, 3))
        for i, found in enumerate(file["hypotheses"]):
            expected = given.model(torch.from_numpy(test_split[i].image)[None])[0].detach()
            np.testing.assert_allclose(found, expected, atol=1e-5)


def test_probabilities_are_the_models_at_the_queries_and_on_the_grid(test_split, tmp_path):
    given = checkpoint("small-classifier")
    given.model.second_stage.logit.bias.data += 1.5  # so that some are above the floor
    assert predict(given, test_split, tmp_path / "preds.h5", CPU, method="mine", level=1) == "classifier"
    queries = Queries(test_split.fingerprint, test_split.symmetry_group)
    grid = torch.from_numpy(equivolumetric_grid(1)).float()
    with h5py.File(tmp_path / "preds.h5") as file, torch.no_grad():
        assert (file.attrs["method"], file.attrs["grid_level"]) == ("mine", 1)
        for i, sample in enumerate(test_split):
            asked = torch.from_numpy(queries.rotations(i, sample.rotation)).float()
            image = torch.from_numpy(sample.image)[None]
            at_queries, on_grid = (given.model(image, R)[0].sigmoid().numpy() for R in (asked, grid))
            np.testing.assert_allclose(file["query_probability"][i], at_queries, atol=1e-5)
            start, end = file["grid_offsets"][i : i + 2]
            dense = np.zeros(len(grid))
            dense[file["grid_indices"][start:end]] = file["grid_probabilities"][start:end]
            np.testing.assert_allclose(dense, on_grid, atol=1e-5)
            assert end - start == len(grid)


def test_a_model_of_another_object_or_size_is_refused(test_split, tmp_path):
    with pytest.raises(ModelError, match=r"was trained on cylO, the set in .* is of tetX"):
        predict(checkpoint("small-wta", of="cylO"), test_split, tmp_path / "preds.h5", CPU)
    with pytest.raises(ModelError, match=r"on images of 224x224 pixels, those in .* have 16x16; .*--size 224"):
        predict(checkpoint("small-wta", size=(224, 224)), test_split, tmp_path / "preds.h5", CPU)
    assert not (tmp_path / "preds.h5").exists()


def test_a_gpu_that_is_too_small_takes_fewer_images_at_once(test_split, tmp_path, monkeypatch):
    tried, run = [], inference.all_hypotheses

    def hungry(model, images, batch_size):
        tried.append(batch_size)
        if batch_size > 2:
            raise torch.cuda.OutOfMemoryError
        return run(model, images, batch_size)

    monkeypatch.setattr(inference, "all_hypotheses", hungry)
    predict(checkpoint("small-wta"), test_split, tmp_path / "preds.h5", CPU)
    assert tried == [64, 32, 16, 8, 4, 2]
    monkeypatch.setattr(inference, "all_hypotheses", lambda *_: hungry(*_[:2], 64))
    with pytest.raises(ModelError, match="does not hold the network and a single image"):
        predict(checkpoint("small-wta"), test_split, tmp_path / "preds.h5", CPU)


# --- several views ---


def test_a_rotation_fits_all_views_if_it_fits_each(test_split):
    """By the definition, view by view: R_w2c R is asked of the view's own image."""
    model = checkpoint("small-classifier").model
    images = torch.from_numpy(np.stack([test_split[i].image for i in range(3)]))
    R_w2c, R = (torch.from_numpy(uniform_rotations(n, np.random.default_rng(n))).float() for n in (3, 40))
    with torch.no_grad():
        each = torch.stack([model(images[v : v + 1], R_w2c[v] @ R)[0].sigmoid() for v in range(3)])
    found = probability_in_all_views(model, images, R_w2c, R)
    torch.testing.assert_close(found, each.amin(dim=0))
    threshold = float(found.median())
    assert torch.equal(in_all_views(model, images, R_w2c, R, threshold), (each > threshold).all(dim=0))
    turned = probability_in_all_views(model, images, R_w2c.mT, R)
    assert not torch.allclose(found, turned)


def test_one_view_in_its_own_frame_is_the_classifier(test_split):
    model = checkpoint("small-classifier").model
    image = torch.from_numpy(test_split[0].image)[None]
    R = torch.from_numpy(uniform_rotations(9, np.random.default_rng(0))).float()
    found = probability_in_all_views(model, image, torch.eye(3)[None], R)
    torch.testing.assert_close(found, model(image, R)[0].sigmoid().detach())


def test_rotations_that_are_not_one_a_view_are_refused(test_split):
    model = checkpoint("small-classifier").model
    images = torch.zeros((2, 16, 16, 3), dtype=torch.uint8)
    with pytest.raises(RotationError, match=r"for each of 2 views, \(2, 3, 3\).*found \(3, 3\)"):
        probability_in_all_views(model, images, torch.eye(3), torch.eye(3)[None])


def test_the_examples_of_the_training_page_run(tmp_path, monkeypatch):
    make_set(tmp_path / "data", "tetX", test=2, size=16, annotate="all").rename(tmp_path / "data" / "cylO")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("symsol_annot.bench.checkpoints.open_checkpoint", lambda _: checkpoint("small-classifier"))
    names = {}
    for block in re.findall(r"```python\n(.*?)```", (ROOT / "docs/training.md").read_text(), flags=re.DOTALL):
        exec(block.replace("equivolumetric_grid()", "equivolumetric_grid(1)"), names)
    assert names["fits"].shape == (576,)
    both = load("data/cylO")
    np.testing.assert_allclose(names["R_w2c"][1] @ both[0].rotation, both[1].rotation, atol=1e-6)
