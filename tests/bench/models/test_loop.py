"""Training on tiny images: it learns, goes on as if it had never stopped, and refuses what cannot be trained on."""

import csv
import hashlib
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from bench_sets import DiscRenderer
from changed_checkpoints import same_tensors
from made_sets import make_plan, make_set, threads
from tiny_training import CLASSIFIER, CPU, HYPOTHESES, RECIPES

from symsol_annot.bench.models.inference import predict
from symsol_annot.bench.models.kinds import MODEL_KINDS
from symsol_annot.bench.models.methods.hypotheses.method import HypothesisLearner
from symsol_annot.bench.models.training import checkpoints, loop, pretraining, refusals
from symsol_annot.bench.models.training.checkpoints import open_checkpoint, read_record
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.record import best_epoch
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import NotAnnotatedError, SettingsError, TrainingError
from symsol_annot.generation.generate import generate
from symsol_annot.sets.dataset import load

pytestmark = pytest.mark.usefixtures("cheap_curves")


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
        predict(open_checkpoint(tmp_path / "classifier"), images, path, torch.device("cpu"), level=1)
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
    scheduled = {"hypotheses": {"winners", "concentration"}, "classifier": {"is_frozen"}}
    for kind, folder in trained.items():
        names = set(read_record(folder / "weights.safetensors").rows[-1])
        metrics = {metric.name for track in MODEL_KINDS[kind].tracks for metric in SCORINGS[track].metrics}
        figures = names & metrics
        told = {"epoch", "loss", "learning_rate", "images_per_second", "seconds", "processor_seconds"}
        assert names - figures == told | scheduled.get(kind, set())
        assert MODEL_KINDS[kind].best_by in figures
        if kind == "hypotheses":
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


def test_an_input_that_its_images_have_not_is_refused_before_training(images, tmp_path):
    with pytest.raises(SettingsError, match=r"images have 16 pixels a side, and the recipe's input_size is 32: render"):
        train(replace(HYPOTHESES, input_size=32), images, tmp_path / "run", CPU)
    assert not (tmp_path / "run").exists()


def test_bfloat16_is_refused_where_it_is_slow_or_wrong(images, tmp_path, monkeypatch):
    wanted = replace(HYPOTHESES, precision="bfloat16")
    monkeypatch.setattr(refusals, "has_bfloat16", lambda _: False)
    with pytest.raises(SettingsError, match=r"precision: the recipe asks for bfloat16, which .* does not compute in"):
        train(wanted, images, tmp_path / "run", CPU)
    monkeypatch.setattr(refusals, "has_bfloat16", lambda _: True)
    with pytest.raises(SettingsError, match="bfloat16 takes images of 17 pixels or more, these have 16; take float32"):
        train(wanted, images, tmp_path / "run", CPU)
    assert not (tmp_path / "run").exists()


def test_a_cosine_rises_then_falls_and_a_gradient_is_clipped(images, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)
    norms, clip = [], torch.nn.utils.clip_grad_norm_

    def watched(parameters, longest):
        parameters = list(parameters)
        clip(parameters, longest)
        norms.append(float(torch.stack([one.grad.norm() for one in parameters if one.grad is not None]).norm()))

    monkeypatch.setattr(torch.nn.utils, "clip_grad_norm_", watched)
    schedule = {"schedule": "cosine", "warm_up": 1.0, "learning_rates": (1e-3,), "milestones": ()}
    recipe = replace(HYPOTHESES, **schedule, clip_norm=1e-3, rolls=True, input_size=8)
    rates = [row["learning_rate"] for row in train(recipe, images, tmp_path / "run", CPU).rows]
    assert rates[0] == pytest.approx(1e-3 * 0.5 * (0.5 * (1 + np.cos(np.pi / 8)) + 0.002), rel=1e-3)  # half warmed up
    assert rates[1] > rates[2] > rates[3] > 0
    assert max(norms) <= 1.001e-3


def test_the_mean_loss_up_to_now_is_told_with_the_epoch_under_way(images, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)
    monkeypatch.setattr(loop, "_STEPS_BETWEEN_CHECKS", 1)
    told = []
    record = train(HYPOTHESES, images, tmp_path / "run", CPU, on_loss=lambda *what: told.append(what))
    assert [epoch for epoch, _ in told] == [1, 1, 2, 2, 3, 3, 4, 4]
    assert [loss for _, loss in told[1::2]] == pytest.approx([row["loss"] for row in record.rows])
