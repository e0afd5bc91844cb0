"""What a training writes for TensorBoard, as TensorBoard reads it."""

import sys
from dataclasses import replace

import pytest
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tiny_training import CPU, HYPOTHESES, MIXTURE

from symsol_annot.bench.models.training import loop
from symsol_annot.bench.models.training.event_log import EVENTS_FOLDER, EventLog
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.validation import FIGURES
from symsol_annot.errors import MissingExtraError, OutputError

LOGGED = replace(CPU, has_events=True)


@pytest.fixture(autouse=True)
def no_curves(monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)


def _scalars(out):
    """By tag: steps and values."""
    read = EventAccumulator(str(out / EVENTS_FOLDER)).Reload()
    return {tag: [(one.step, one.value) for one in read.Scalars(tag)] for tag in read.Tags()["scalars"]}


def test_losses_by_step_and_all_figures_by_epoch_are_written(images, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "_STEPS_BETWEEN_CHECKS", 1)
    losses = []
    record = train(HYPOTHESES, images, tmp_path, LOGGED, on_loss=lambda _, mean: losses.append(mean))
    told = _scalars(tmp_path)
    for name in record.rows[0].keys() - {"epoch"}:
        tag = f"{'validation' if name in FIGURES else 'epochs'}/{name}"
        assert told.pop(tag) == [(row["epoch"], pytest.approx(row[name], rel=1e-5)) for row in record.rows], tag
    assert [step for step, _ in told["steps/loss"]] == [1, 2, 3, 4, 5, 6, 7, 8]
    means = [losses[0], 2 * losses[1] - losses[0]]  # of each step, from those of the epoch up to it
    assert [loss for _, loss in told.pop("steps/loss")][:2] == pytest.approx(means, rel=1e-4)
    assert [rate for _, rate in told.pop("steps/learning_rate")] == pytest.approx(6 * [1e-3] + 2 * [1e-4])
    assert told == {}


def test_an_epochs_last_steps_are_told_though_they_are_few(images, tmp_path):
    record = train(HYPOTHESES, images, tmp_path, LOGGED)
    steps = _scalars(tmp_path)["steps/loss"]
    assert steps == [(2 * row["epoch"], pytest.approx(row["loss"], rel=1e-5)) for row in record.rows]


def test_a_stopped_training_goes_on_in_the_same_log_without_what_it_did_not_finish(images, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "_STEPS_BETWEEN_CHECKS", 1)
    done = 0

    def stop_in_the_third_epoch(count):
        nonlocal done
        done += 1
        if done == 6:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(HYPOTHESES, images, tmp_path / "run", LOGGED, on_batch=stop_in_the_third_epoch)
    before = _scalars(tmp_path / "run")
    assert len(before["steps/loss"]) == 6
    record = train(HYPOTHESES, images, tmp_path / "run", LOGGED)
    told = _scalars(tmp_path / "run")
    assert told["steps/loss"][:4] == before["steps/loss"][:4]
    assert [step for step, _ in told["steps/loss"]] == [1, 2, 3, 4, 5, 6, 7, 8]
    assert [step for step, _ in told["epochs/loss"]] == [row["epoch"] for row in record.rows]


def test_a_log_that_is_asked_for_later_begins_with_the_epochs_before(images, tmp_path):
    train(HYPOTHESES, images, tmp_path, replace(CPU, epochs=2))
    record = train(HYPOTHESES, images, tmp_path, replace(LOGGED, epochs=3))
    told = _scalars(tmp_path)
    assert told["epochs/loss"] == [(row["epoch"], pytest.approx(row["loss"], rel=1e-5)) for row in record.rows]
    assert [step for step, _ in told["steps/loss"]] == [6]


def test_what_was_fitted_after_the_last_epoch_is_written(images, tmp_path):
    record = train(MIXTURE, images, tmp_path, replace(LOGGED, epochs=1))
    told = _scalars(tmp_path)
    assert record.calibration
    for name, value in record.calibration.items():
        assert told[f"calibration/{name}"] == [(1, pytest.approx(value, rel=1e-5))]


def test_nothing_is_written_unasked_and_without_tensorboard_nothing_begins(images, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "tensorboard", None)
    train(HYPOTHESES, images, tmp_path / "plain", replace(CPU, epochs=1))
    assert not (tmp_path / "plain" / EVENTS_FOLDER).exists()
    with pytest.raises(MissingExtraError, match=r"needs tensorboard, .*pip install 'symsol-annot\[tensorboard\]'"):
        train(HYPOTHESES, images, tmp_path / "run", LOGGED)
    assert not (tmp_path / "run").exists()


def test_a_folder_that_cannot_be_written_is_one_error(images, tmp_path):
    record = train(HYPOTHESES, images, tmp_path / "run", replace(CPU, epochs=1))
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="file"):
        EventLog(tmp_path / "file" / EVENTS_FOLDER, record, 2)
