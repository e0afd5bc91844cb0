"""Training on tiny images: it learns, goes on as if it had never stopped, and refuses what cannot be trained on."""

import csv
import hashlib
import json
import os
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import safetensors.torch
import torch
from bench_sets import DiscRenderer
from made_sets import make_plan, make_set, threads
from tiny_training import CLASSIFIER, CPU, HYPOTHESES, NARROW, RECIPES

from symsol_annot.bench.models.batches import decode_images
from symsol_annot.bench.models.devices import largest_that_fits
from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.kinds import MODEL_KINDS
from symsol_annot.bench.models.methods.hypotheses.method import HypothesisLearner
from symsol_annot.bench.models.recipe import recipe_to_toml
from symsol_annot.bench.models.training import batch_sources, checkpoints, loop, pretraining
from symsol_annot.bench.models.training.batch_sources import InMemory, Streamed, open_batches
from symsol_annot.bench.models.training.checkpoints import open_checkpoint, read_record
from symsol_annot.bench.models.training.curve import plot_curve
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.pretraining import best_network, trained_networks
from symsol_annot.bench.models.training.record import best_epoch, record_to_metadata
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import DataError, NotAnnotatedError, SettingsError, TrainingError, WeightsError
from symsol_annot.generation.generate import generate
from symsol_annot.sets.dataset import load

torch.set_num_threads(1)


@pytest.fixture(scope="module", autouse=True)
def _cheap():
    """No curve before the last epoch: drawing takes longer than the epochs."""

    def at_the_end(path, record):
        if record.is_finished:
            plot_curve(path, record)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(loop, "plot_curve", at_the_end)
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder of sets: tetX, of images so small that a training takes seconds."""
    folder = tmp_path_factory.mktemp("training") / "data"
    make_set(folder, "tetX", train=20, test=3, size=16, annotate="all")
    return folder


@pytest.fixture
def images(data):
    return load(data / "tetX", "train")


@pytest.fixture(scope="module")
def trained(data, tmp_path_factory):
    """A folder an architecture, each trained without a stop."""
    runs = tmp_path_factory.mktemp("runs")
    for name, recipe in RECIPES.items():
        train(recipe, load(data / "tetX", "train"), runs / name, CPU, name=name)
    return {name: runs / name for name in RECIPES}


def same_tensors(path_a, path_b):
    a, b = read_weights(path_a), read_weights(path_b)
    return set(a) == set(b) and all(torch.equal(a[name], b[name]) for name in a)


def copy_of(file, to, change=None, metadata=None):
    """A checkpoint's file with its tensors or metadata changed."""
    with safetensors.safe_open(file, framework="pt") as content:
        known = content.metadata()
    tensors = read_weights(file)
    if change:
        change(tensors)
    safetensors.torch.save_file(tensors, to, {**known, **(metadata or {})})
    return to


# --- learning ---


def test_a_handful_of_images_is_learnt_by_heart_and_scores_a_recall_over_0_9(tmp_path, monkeypatch):
    """On cylO, whose images have sets of one where the disc shows; predicted and scored on the images learnt."""
    plan = make_plan("cylO", train=8, test=0, size=32, annotate="all")
    generate(plan, tmp_path / "cylO", threads(partial(DiscRenderer, 32), exhaustive=True))
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)
    for name in ("save", "publish"):  # a few images make many epochs; only the last is kept
        keep = getattr(checkpoints, name)
        monkeypatch.setattr(checkpoints, name, lambda *given, keep=keep: given[1].is_finished and keep(*given))
    schedule = {"epochs": 30, "milestones": (20,), "validation_images": 0}
    wta = replace(HYPOTHESES, **schedule, meta_loss="wta", epochs_to_one=None)
    schedule = {"epochs": 180, "milestones": (160,), "validation_images": 0, "frozen_epochs": 179}
    frozen = replace(CLASSIFIER, **schedule, start="best-recall")
    path = tmp_path / "preds.h5"
    with load(tmp_path / "cylO", "train") as images:
        for track, recipe in {"hypotheses": wta, "classifier": frozen}.items():
            losses = [row["loss"] for row in train(recipe, images, tmp_path / track, CPU, name=track).rows]
            assert np.mean(losses[-5:]) < 0.5 * np.mean(losses[:5]), track
        assert (
            predict(open_checkpoint(tmp_path / "classifier"), images, path, torch.device("cpu"), level=1)
            == "classifier"
        )
    figures = score_file(path, tmp_path).tracks["classifier"].figures["shown"]
    assert figures["recall"].images == 6
    assert figures["recall"].value > 0.9
    assert figures["precision"].value > 0.5


@pytest.mark.parametrize("name", RECIPES)
def test_a_folder_holds_weights_state_recipe_figures_and_a_curve(name, trained):
    folder = trained[name]
    assert {path.name for path in folder.iterdir()} == {
        *("weights.safetensors", "best.safetensors", "state.safetensors", "recipe.toml", "metrics.csv", "curve.png"),
    }
    record = read_record(folder / "weights.safetensors")
    assert (record.name, record.recipe, record.object, record.image_size) == (name, RECIPES[name], "tetX", (16, 16))
    assert record.software["torch"] == torch.__version__
    with (folder / "metrics.csv").open() as file:
        rows = [{key: float(value) for key, value in row.items()} for row in csv.DictReader(file)]
    assert rows == [dict(row) for row in record.rows]
    assert [row["epoch"] for row in rows] == [1, 2, 3, 4]
    assert [row["learning_rate"] for row in rows] == [1e-3, 1e-3, 1e-3, 1e-4]
    best = best_epoch(record)
    best_rows = read_record(folder / "best.safetensors").rows
    assert len(best_rows) == best
    assert best_rows == record.rows[:best]
    assert (folder / "curve.png").read_bytes().startswith(b"\x89PNG")


def test_figures_of_validation_images_are_those_of_the_table_and_what_chooses_is_among_them(trained):
    for track, folder in trained.items():
        names = set(read_record(folder / "weights.safetensors").rows[-1])
        figures = names & {metric.name for metric in SCORINGS[track].metrics}
        told = {"epoch", "loss", "learning_rate", "images_per_second", "seconds", "processor_seconds"}
        assert names - figures == told | ({"winners", "concentration"} if track == "hypotheses" else {"is_frozen"})
        assert MODEL_KINDS[track].best_by in figures
        if track == "hypotheses":
            assert {name for names in pretraining._ERRORS.values() for name in names} <= figures


def test_k_and_freezing_follow_the_recipe(trained):
    k = [row["winners"] for row in read_record(trained["hypotheses"] / "weights.safetensors").rows]
    frozen = [row["is_frozen"] for row in read_record(trained["classifier"] / "weights.safetensors").rows]
    assert k == [4, 4, 2, 1]
    assert frozen == [1, 1, 0, 0]


def test_a_frozen_first_stage_is_that_of_the_network_it_began_with(trained, images, tmp_path):
    recipe = replace(CLASSIFIER, epochs=1, learning_rates=(1e-3,), milestones=(), frozen_epochs=1, start="best-recall")
    recipe = replace(recipe, epochs=1, frozen_epochs=1)
    record = train(recipe, images, tmp_path / "c", replace(CPU, pretrained=(trained["hypotheses"],)))
    ours, theirs = (read_weights(folder / "weights.safetensors") for folder in (tmp_path / "c", trained["hypotheses"]))
    stage = [name for name in ours if name.startswith("first_stage.")]
    assert len(stage) > 100
    assert all(torch.equal(ours[name], theirs[name]) for name in stage)
    digest = hashlib.sha256((trained["hypotheses"] / "weights.safetensors").read_bytes()).hexdigest()
    assert record.first_stage == f"hypotheses, sha256 {digest}"


def test_epochs_stretch_the_schedule(images, tmp_path):
    record = train(HYPOTHESES, images, tmp_path / "run", replace(CPU, epochs=2))
    rates = [row["learning_rate"] for row in record.rows]
    assert rates == [1e-3, 1e-4]  # of an epoch the last moment: 1.5 and 3.5 of 4
    assert record.is_finished


# --- going on ---


@pytest.mark.parametrize(("name", "stops"), [("hypotheses", 3), ("classifier", 1)])
def test_going_on_gives_the_weights_of_not_stopping(name, stops, trained, images, tmp_path):
    class StopError(Exception):
        pass

    done = 0

    def stop_in_the_middle(count):
        nonlocal done
        done += count
        if done == 16 * stops + 8:  # in the middle of an epoch
            raise StopError

    out = tmp_path / "run"
    with pytest.raises(StopError):
        train(RECIPES[name], images, out, CPU, name=name, on_batch=stop_in_the_middle)
    assert read_record(out / "weights.safetensors").epochs_done == stops
    (out / "weights.safetensors").unlink()  # as if it had been stopped between two files
    begun = []
    train(
        RECIPES[name], images, out, CPU, name=name, on_start=lambda *told: begun.append((told[0].epochs_done, told[1]))
    )
    assert begun == [(stops, 16)]
    for file in ("weights.safetensors", "state.safetensors", "best.safetensors"):
        assert same_tensors(out / file, trained[name] / file)


def test_a_finished_training_is_left_as_it_is(trained, images):
    before = (trained["hypotheses"] / "state.safetensors").read_bytes()
    record = train(HYPOTHESES, images, trained["hypotheses"], CPU, name="hypotheses")
    assert record.is_finished
    assert (trained["hypotheses"] / "state.safetensors").read_bytes() == before


def test_another_seed_is_another_training(trained, images):
    first, second = (checkpoints.new_model(HYPOTHESES, None, seed).state_dict()["output.weight"] for seed in (0, 1))
    assert not torch.equal(first, second)
    with pytest.raises(TrainingError, match=r"holds another training; nothing was touched.*\n  - seed: there 0"):
        train(HYPOTHESES, images, trained["hypotheses"], replace(CPU, seed=1), name="hypotheses")
    with pytest.raises(TrainingError, match=r"\n  - recipe: there HypothesisRecipe"):
        train(replace(HYPOTHESES, batch_size=4), images, trained["hypotheses"], CPU, name="hypotheses")


# --- batches ---


def test_an_epoch_has_each_image_once_in_an_order_of_its_own(images):
    held = InMemory(decode_images(images), 5, 3, torch.device("cpu"), on_device=True)
    epochs = [torch.cat([batch.R_gt for batch in held.batches(epoch)]) for epoch in (0, 1, 0)]
    assert all(len(torch.unique(R, dim=0)) == len(R) == 20 for R in epochs)
    assert torch.equal(epochs[0], epochs[2])
    assert not torch.equal(epochs[0], epochs[1])
    for batch in held.batches(0):
        for picture, R in zip(batch.images, batch.R_gt, strict=True):
            (row,) = [s for s in images if np.allclose(s.rotation, R, atol=1e-6)]
            assert np.array_equal(row.image, picture)


def test_images_that_are_fewer_than_a_batch_are_left_out_of_an_epoch(images):
    held = InMemory(decode_images(images), 8, 0, torch.device("cpu"), on_device=True)
    assert [len(batch.R_gt) for batch in held.batches(0)] == [8, 8]
    assert held.batches_per_epoch() == 2
    small = InMemory(decode_images(images[:6]), 8, 0, torch.device("cpu"), on_device=True)
    assert [len(batch.R_gt) for batch in small.batches(0)] == [6]


def test_workers_read_the_same_images_where_memory_is_too_small(images, monkeypatch):
    monkeypatch.setattr(batch_sources, "free_bytes", lambda _: 1000)
    monkeypatch.setattr(batch_sources, "cores", lambda: 2)
    streamed = open_batches(images, 5, 0, torch.device("cpu"))
    assert isinstance(streamed, Streamed)
    batches = list(streamed.batches(0))
    assert len(batches) == streamed.batches_per_epoch() == 4
    R_gt = torch.cat([batch.R_gt for batch in batches])
    assert len(torch.unique(R_gt, dim=0)) == 20
    assert batches[0].images.dtype == torch.uint8


# --- which network a classifier begins with ---


def test_the_best_network_has_the_lowest_error_and_on_a_tie_the_lower_other(trained, tmp_path):
    like = read_record(trained["hypotheses"] / "weights.safetensors")
    errors = {"a": (0.1004, 0.30), "b": (0.1001, 0.20), "c": (0.20, 0.10), "unfinished": (0.0, 0.0)}
    for name, (recall, precision) in errors.items():
        (tmp_path / name).mkdir()
        known = json.loads(json.dumps(list(like.rows)))
        known[-1] |= {"recall_mean_error_rad": recall, "precision_mean_error_rad": precision}
        record = replace(like, rows=tuple(known[: 3 if name == "unfinished" else 4]))
        copy_of(
            trained["hypotheses"] / "weights.safetensors",
            tmp_path / name / "weights.safetensors",
            metadata=record_to_metadata(record),
        )
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "weights.safetensors").write_bytes(b"not ours")
    candidates = trained_networks(tmp_path, like)
    assert [path.parent.name for path in candidates] == ["a", "b", "c"]
    assert best_network(candidates, like, "best-recall").parent.name == "b"
    assert best_network(candidates, like, "best-precision").parent.name == "c"


def test_no_network_or_one_that_does_not_fit_is_refused(trained, images, tmp_path):
    recipe = replace(CLASSIFIER, start="best-recall")
    with pytest.raises(WeightsError, match=r"there is none; train one .*small-wta.*--pretrained"):
        train(recipe, images, tmp_path / "alone" / "run", CPU)
    with pytest.raises(WeightsError, match="expected a hypothesis network"):
        train(recipe, images, tmp_path / "run", replace(CPU, pretrained=(trained["classifier"],)))
    record = replace(read_record(trained["hypotheses"] / "weights.safetensors"), image_size=(224, 224))
    with pytest.raises(WeightsError, match=r"was trained on \(16, 16\), the set has \(224, 224\)"):
        best_network([trained["hypotheses"]], record, "best-recall")
    like = read_record(trained["hypotheses"] / "weights.safetensors")
    other = replace(like, recipe=replace(recipe, backbone="resnet18"))
    with pytest.raises(WeightsError, match="has the backbone narrow-resnet18, the recipe resnet18"):
        best_network([trained["hypotheses"]], other, "best-recall")
    assert [path.parent.name for path in trained_networks(trained["hypotheses"].parent, like)] == ["hypotheses"]
    assert trained_networks(trained["hypotheses"].parent, other) == []
    assert not (tmp_path / "run").exists()


# --- refusals ---


def test_a_loss_that_is_not_finite_stops_and_keeps_the_last_good_epoch(images, tmp_path, monkeypatch):
    losses, calls = HypothesisLearner.losses, 0

    def broken(*arguments):
        nonlocal calls
        calls += 1
        return losses(*arguments) * (float("nan") if calls > 4 else 1.0)

    monkeypatch.setattr(HypothesisLearner, "losses", broken)
    with pytest.raises(TrainingError, match=r"no longer finite in epoch 3: a learning rate of 0.001 .* keeps epoch 2"):
        train(HYPOTHESES, images, tmp_path / "run", CPU, name="hypotheses")
    kept = open_checkpoint(tmp_path / "run")
    assert kept.record.epochs_done == 2
    assert all(tensor.isfinite().all() for tensor in kept.model.state_dict().values())


def test_a_mean_of_adam_s_that_is_not_finite_stops_though_loss_and_weights_are(images, tmp_path, monkeypatch):
    step = torch.optim.Adam.step

    def overflowing(self):
        step(self)
        next(iter(self.state.values()))["exp_avg_sq"].view(-1)[0] = float("inf")

    monkeypatch.setattr(torch.optim.Adam, "step", overflowing)
    with pytest.raises(TrainingError, match="no longer finite in epoch 1"):
        train(HYPOTHESES, images, tmp_path / "run", CPU, name="hypotheses")
    assert not (tmp_path / "run").exists()


def test_a_gpu_that_is_too_small_says_the_batch_that_fits(images, tmp_path, monkeypatch):
    losses = HypothesisLearner.losses

    def hungry(self, batch, *rest):
        if len(batch.images) > 3:
            raise torch.cuda.OutOfMemoryError
        return losses(self, batch, *rest)

    monkeypatch.setattr(HypothesisLearner, "losses", hungry)
    with pytest.raises(
        TrainingError, match=r"too small for a batch of 8 images; 2 fit: set batch_size = 2.*Nothing was kept"
    ):
        train(HYPOTHESES, images, tmp_path / "run", CPU)
    assert not (tmp_path / "run").exists()


def test_halving_ends_with_none_where_not_even_one_fits():
    def never(_):
        raise torch.cuda.OutOfMemoryError

    def hungry(batch_size):
        if batch_size > 20:
            raise torch.cuda.OutOfMemoryError
        return f"{batch_size} images"

    assert largest_that_fits(never, 64) is None
    assert largest_that_fits(hungry, 0) is None
    assert largest_that_fits(hungry, 64) == (16, "16 images")
    assert largest_that_fits(hungry, 7) == (7, "7 images")


def test_a_split_without_sets_is_trained_on_only_without_scores(tmp_path):
    folder = make_set(tmp_path, "tetX", train=10, test=2, size=16, annotate="test")
    with load(folder, "train") as images:
        with pytest.raises(NotAnnotatedError, match=r"--annotate all.*--validation-images 0"):
            train(HYPOTHESES, images, tmp_path / "run", CPU)
        record = train(
            replace(HYPOTHESES, validation_images=0, epochs=4), images, tmp_path / "run", replace(CPU, epochs=1)
        )
    assert "recall_mean_error_rad" not in record.rows[0]
    assert not (tmp_path / "run" / "best.safetensors").exists()


def test_validation_images_that_leave_none_and_a_device_that_is_not_here_are_refused(images, tmp_path):
    with pytest.raises(SettingsError, match=r"has 20 images, of which the recipe takes 19 for validation; 2 or more"):
        train(replace(HYPOTHESES, validation_images=19), images, tmp_path / "run", CPU)
    for name in ("cuda:9", "gpu"):
        with pytest.raises(SettingsError, match=f"there is no '{name}' here"):
            train(HYPOTHESES, images, tmp_path / "run", replace(CPU, device=name))
    with pytest.raises(SettingsError, match="epochs: expected 1 to 10000, found 0"):
        train(HYPOTHESES, images, tmp_path / "run", replace(CPU, epochs=0))


@pytest.mark.parametrize("damage", ["cut", "no checkpoint", "of a later version", "another architecture", "bad recipe"])
def test_a_damaged_or_foreign_checkpoint_is_refused(damage, trained, tmp_path):
    whole, path = trained["hypotheses"] / "weights.safetensors", tmp_path / "weights.safetensors"
    match damage:
        case "cut":
            path.write_bytes(whole.read_bytes()[:-1000])
            said = "the checkpoint is damaged"
        case "no checkpoint":
            safetensors.torch.save_file({"a": torch.zeros(1)}, path)
            said = "no checkpoint of `symsol-annot train`"
        case "of a later version":
            copy_of(whole, path, metadata={"format_version": "2"})
            said = "is of format version 2, newer than 1, .* update it"
        case "another architecture":
            copy_of(whole, path, lambda tensors: tensors.update(extra=tensors.pop("output.bias")))
            said = r"not the weights of its recipe, hypotheses:\n  - 1 missing: output.bias"
        case "bad recipe":
            copy_of(whole, path, metadata={"recipe": "model = 'hypotheses'"})
            said = "what it says of its training is damaged"
    with pytest.raises(WeightsError, match=said):
        open_checkpoint(path)


def test_a_damaged_state_is_refused_and_nothing_lost(trained, images, tmp_path):
    out = tmp_path / "run"
    out.mkdir()
    state = trained["hypotheses"] / "state.safetensors"

    def transpose(tensors):
        tensors["exp_avg/output.weight"] = tensors["exp_avg/output.weight"].T.contiguous()

    copy_of(state, out / "state.safetensors", transpose)
    before = (out / "state.safetensors").read_bytes()
    with pytest.raises(WeightsError, match=r"Adam's means of output.weight are not of its shape"):
        train(HYPOTHESES, images, out, CPU, name="hypotheses")
    assert (out / "state.safetensors").read_bytes() == before
    (out / "state.safetensors").write_bytes(before[:5000])
    with pytest.raises(WeightsError, match="is damaged"):
        train(HYPOTHESES, images, out, CPU, name="hypotheses")


def test_checkpoints_hold_no_pickles(trained):
    for folder in trained.values():
        tensors = {path for path in folder.iterdir() if path.suffix == ".safetensors"}
        assert {path.suffix for path in folder.iterdir()} - {".safetensors"} <= {".toml", ".csv", ".png", ".json"}
        assert {"weights.safetensors", "state.safetensors"} <= {path.name for path in tensors}
        for file in tensors:
            assert safetensors.torch.load(file.read_bytes())


def changed_record(whole, path, **changes):
    """A checkpoint's file whose record says otherwise."""
    with safetensors.safe_open(whole, framework="pt") as content:
        record = json.loads(content.metadata()["record"])
    rows = record["rows"]
    for name, value in changes.items():
        if name.startswith("row_"):
            rows[1][name.removeprefix("row_")] = value
        else:
            record[name] = value
    return copy_of(whole, path, metadata={"record": json.dumps(record)})


WRONG = {
    "a name of two lines": ({"name": "a\nb"}, "name: expected 1 to 200 printable"),
    "a name that is a number": ({"name": 3}, "name: expected 1 to 200 printable"),
    "an object that is a path": ({"object": "../../etc"}, "object: expected 1 to 64 letters"),
    "an object that is a list": ({"object": ["tetX"]}, "object: expected 1 to 64 letters"),
    "a size that is text": ({"image_size": "16"}, "image_size: expected two whole numbers"),
    "a size of one side": ({"image_size": [16]}, "image_size: expected two whole numbers"),
    "a size of true": ({"image_size": [True, 16]}, "image_size: expected two whole numbers"),
    "a size of fractions": ({"image_size": [16.0, 16]}, "image_size: expected two whole numbers"),
    "a huge size": ({"image_size": [10**9, 16]}, "image_size: expected two whole numbers"),
    "no epochs": ({"epochs": 0}, "epochs: expected 1 to 10000"),
    "epochs of true": ({"epochs": True}, "epochs: expected 1 to 10000"),
    "10^30 epochs": ({"epochs": 10**30}, "epochs: expected 1 to 10000"),
    "fewer epochs than rows": ({"epochs": 3}, "rows: expected a list of up to 3"),
    "a negative seed": ({"seed": -1}, "seed: expected 0 to"),
    "a seed of text": ({"seed": "0"}, "seed: expected 0 to"),
    "a fingerprint without end": ({"train_fingerprint": "x" * 2000}, "train_fingerprint: expected text of up to"),
    "a first stage that is none": ({"first_stage": None}, "first_stage: expected text"),
    "rows that are a number": ({"rows": 4}, "rows: expected a list"),
    "a row that is a list": ({"rows": [[1]]}, "not in 1"),
    "a figure that is a list": ({"row_loss": [1.0]}, "not in 2"),
    "a figure that is true": ({"row_recall_mean_error_rad": True}, "not in 2"),
    "a figure that is text": ({"row_seconds": "1.0"}, "not in 2"),
    "a loss that is not a number": ({"row_loss": float("nan")}, "not in 2"),
    "an infinite figure": ({"row_recall_mean_error_rad": float("inf")}, "not in 2"),
    "a figure of 400 digits": ({"row_seconds": 10**400}, "not in 2"),
    "another epoch's row": ({"row_epoch": 3}, "not in 2"),
    "a row without its loss": ({"rows": [{"epoch": 1}]}, "not in 1"),
    "versions that are a list": ({"software": []}, "software: expected texts"),
    "a version that is a number": ({"software": {"torch": 2}}, "software: expected texts"),
}


@pytest.mark.parametrize(("changes", "said"), WRONG.values(), ids=WRONG)
def test_a_record_of_other_types_or_beyond_bounds_is_refused(changes, said, trained, tmp_path):
    path = changed_record(trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", **changes)
    with pytest.raises(WeightsError, match="what it says of its training is damaged: ") as caught:
        read_record(path)
    assert said in str(caught.value)
    assert len(str(caught.value)) < 1000


@pytest.mark.parametrize(
    ("metadata", "said"),
    [
        ({"record": "[" * 100_000}, "is damaged"),
        ({"record": '"text"'}, "expected a record's parts by their names"),
        ({"record": "{}"}, "'image_size' is missing"),
        ({"record": '{"image_size": ' + "9" * 10_000 + "}"}, "is damaged"),
        ({"format_version": "9" * 5000}, "format_version 1, found '9999"),
        ({"format_version": "\u0661"}, "format_version 1, found"),
        ({"recipe": "a = " + "[" * 9999}, "is no TOML: it is nested too deep"),
        ({"recipe": "x" * 10**6}, "it has 1,000,000 characters, more than"),
    ],
)
def test_metadata_that_were_made_to_do_harm_are_one_short_error(metadata, said, trained, tmp_path):
    path = copy_of(trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", metadata=metadata)
    for opened in (read_record, open_checkpoint):
        with pytest.raises(WeightsError) as caught:
            opened(path)
        assert said in str(caught.value)
        assert len(str(caught.value)) < 1000


def test_a_record_that_asks_for_a_gigantic_model_is_refused_before_it_is_made(trained, tmp_path):
    text = recipe_to_toml(HYPOTHESES).replace("hypotheses = 4", "hypotheses = 1000000000")
    path = copy_of(trained["hypotheses"] / "weights.safetensors", tmp_path / "a.safetensors", metadata={"recipe": text})
    with pytest.raises(WeightsError, match="hypotheses: expected 1 to 10000, found 1000000000"):
        open_checkpoint(path)


def test_what_is_no_file_of_a_checkpoint_is_refused_without_waiting(tmp_path):
    for name, put in {
        "fifo": os.mkfifo,
        "device": lambda path: path.symlink_to("/dev/zero"),
        "folder": Path.mkdir,
    }.items():
        (tmp_path / name).mkdir()
        put(tmp_path / name / "weights.safetensors")
        for path in (tmp_path / name, tmp_path / name / "weights.safetensors"):
            with pytest.raises(WeightsError, match=r"is no regular file|is a folder|there is no such checkpoint"):
                open_checkpoint(path)
    (tmp_path / "other").mkdir()
    assert trained_networks(tmp_path, SimpleNamespace(train_fingerprint="", image_size=())) == []
    with pytest.raises(WeightsError, match="there is no such checkpoint"):
        open_checkpoint(tmp_path / "other")


def test_record_and_weights_of_a_checkpoint_are_those_of_one_file(trained, tmp_path, monkeypatch):
    """It is replaced by another's as soon as it is opened; and the digest is of what was read."""
    whole, other = (trained[name] / "weights.safetensors" for name in ("hypotheses", "classifier"))
    path = Path(shutil.copy(whole, tmp_path / "a.safetensors"))
    open_file = os.open

    def open_and_replace(name, *rest, **options):
        descriptor = open_file(name, *rest, **options)
        if Path(name) == path:
            Path(shutil.copy(other, tmp_path / "b.safetensors")).replace(path)
        return descriptor

    monkeypatch.setattr(os, "open", open_and_replace)
    opened = open_checkpoint(path)
    assert opened.record.name == "hypotheses"
    assert opened.sha256 == hashlib.sha256(whole.read_bytes()).hexdigest()
    assert torch.equal(opened.model.state_dict()["output.bias"], read_weights(whole)["output.bias"])
    assert path.read_bytes() == other.read_bytes()


def test_an_epoch_whose_figure_is_undefined_is_not_the_best(trained, tmp_path):
    whole = trained["hypotheses"] / "weights.safetensors"
    figure = "recall_mean_error_rad"
    best = best_epoch(read_record(whole))
    rows = [dict(row) for row in read_record(whole).rows]
    for undefined in range(4):
        changed = [row | ({figure: float("nan")} if epoch == undefined else {}) for epoch, row in enumerate(rows)]
        record = read_record(changed_record(whole, tmp_path / "a.safetensors", rows=changed))
        known = [epoch for epoch in range(4) if epoch != undefined]
        assert best_epoch(record) == min(reversed(known), key=lambda epoch: rows[epoch][figure]) + 1
    assert best in range(1, 5)


@pytest.mark.parametrize(
    ("options", "name", "said"),
    [
        ({"seed": -1}, "", "seed: expected 0 to"),
        ({"seed": 2**63}, "", "seed: expected 0 to"),
        ({"epochs": 10_001}, "", "epochs: expected 1 to 10000"),
        ({}, "a\nb", "name: expected 1 to 200 printable"),
        ({}, "x" * 201, "name: expected 1 to 200 printable"),
    ],
)
def test_what_no_checkpoint_can_hold_is_refused_before_training(options, name, said, images, tmp_path):
    with pytest.raises(SettingsError, match=said):
        train(HYPOTHESES, images, tmp_path / "run", replace(CPU, **options), name=name)
    assert not (tmp_path / "run").exists()


# --- the command ---


RECIPE_TOML = f"""
title = "tiny"
model = "hypotheses"
start = "random"
backbone = "{NARROW.name}"
hypotheses = 4
meta_loss = "wta"
embedded_loss = "cyclic-cosine"
batch_size = 8
epochs = 1
learning_rates = [1e-3]
milestones = []
validation_images = 4
"""


def test_train_predict_and_score_from_the_command_line(data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(RECIPE_TOML)
    done = here("train", "tiny.toml", "--data", data, "--device", "cpu")
    assert (done.returncode, done.stderr) == (0, "")  # no bar where there is no terminal
    assert "epoch 1/1: loss" in done.stdout
    assert "symsol-annot predict runs/tetX-tiny" in done.stdout
    again = here("train", "tiny.toml", "--data", data, "--device", "cpu")
    assert again.stdout.startswith("goes on after epoch 1 of 1")
    done = here("predict", "runs/tetX-tiny", "--data", data, "--device", "cpu", "--out", "preds.h5")
    assert (done.returncode, done.stderr) == (0, "")
    done = here("score", "preds.h5", "--data", data)
    assert done.stdout.startswith("tetX, test split, 3 images: tiny")


@pytest.mark.parametrize("name", ["..toml", "a b.toml", "..", "-x.toml", "tiny.v2.toml"])
def test_a_run_lies_in_runs_whatever_its_recipe_is_called(name, data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if name != "..":
        (tmp_path / name).write_text(RECIPE_TOML)
    done = here("train", "--data", data, "--device", "cpu", "--", name)
    folders = [path for path in tmp_path.iterdir() if path.is_dir()]
    if name == "..":
        assert (done.returncode, folders) == (1, [])
        return
    assert (done.returncode, folders) == (0, [tmp_path / "runs"])
    assert [path.name for path in (tmp_path / "runs").iterdir()] == [f"tetX-{name.removesuffix('.toml')}"]
    assert open_checkpoint(tmp_path / "runs" / f"tetX-{name.removesuffix('.toml')}").record.is_finished


@pytest.mark.parametrize("name", ["a\nb.toml", "\x1b[2J.toml"])
def test_a_recipe_whose_name_could_act_on_a_terminal_is_refused(name, data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).write_text(RECIPE_TOML)
    done = here("train", name, "--data", data, "--device", "cpu")
    assert (done.returncode, "rename it" in done.stderr) == (1, True)
    assert "\x1b" not in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == [name]


def test_the_command_lists_recipes(here):
    done = here("train", "--list")
    assert done.returncode == 0
    assert "small-wta" in done.stdout


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["no-such-recipe"], "no such file, and no built-in recipe of that name"),
        (["small-wta", "--data", "nowhere"], "nowhere: expected a set to train on, found none"),
        (["small-wta", "--object", "cube"], "holds no set of the object 'cube'"),
        (["small-wta"], "of which the recipe takes 200 for validation"),
        (["small-wta", "--validation-images", "0", "--device", "cuda:7"], "there is no 'cuda:7' here"),
    ],
)
def test_train_refuses_in_one_message(words, said, data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = words if "--data" in words else [*words, "--data", data]
    done = here("train", *words)
    assert done.returncode == 1
    assert said in done.stderr
    assert done.stderr.startswith("Error: ")
    assert list(tmp_path.iterdir()) == []


def test_train_refuses_a_set_without_a_train_split_and_several_without_a_name(data, here, tmp_path):
    make_set(tmp_path / "data", "tetX", test=2, size=16)
    done = here("train", "small-wta", "--data", tmp_path / "data", "--out", tmp_path / "run")
    assert (done.returncode, "has no split 'train'; it has test" in done.stderr) == (1, True)
    make_set(tmp_path / "data", "tet", test=2, size=16)
    done = here("train", "small-wta", "--data", tmp_path / "data", "--out", tmp_path / "run")
    assert (done.returncode, "several: tet, tetX; --object names one" in done.stderr) == (1, True)
    done = here("train", "small-wta", "--data", tmp_path / "data" / "tet", "--object", "cube")
    assert done.returncode == 1


def test_the_library_refuses_a_missing_split(data):
    with pytest.raises(DataError, match="has no split 'validation'"):
        load(data / "tetX", "validation")
    assert loop.Options().device == "auto"
