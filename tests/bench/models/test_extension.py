"""A training with more epochs than it was begun with: what was done stays, the rest follows the stretched schedule."""

from dataclasses import replace

import pytest
from changed_checkpoints import same_tensors
from tiny_training import CLASSIFIER, CPU, HYPOTHESES, MIXTURE

from symsol_annot.bench.models.methods.mixture.learner import MixtureLearner
from symsol_annot.bench.models.training import loop
from symsol_annot.bench.models.training.checkpoints import read_record
from symsol_annot.bench.models.training.loop import train
from symsol_annot.bench.models.training.position import rate_position, stage_position
from symsol_annot.errors import TrainingError

FILES = ("weights.safetensors", "state.safetensors")


@pytest.fixture(autouse=True)
def no_curves(monkeypatch):
    monkeypatch.setattr(loop, "plot_curve", lambda *_: None)


def _epochs(count):
    return replace(CPU, epochs=count)


def test_a_finished_training_goes_on_and_its_record_says_after_which_epochs(images, tmp_path):
    out = tmp_path / "run"
    first = train(HYPOTHESES, images, out, _epochs(2))
    longer = train(HYPOTHESES, images, out, _epochs(4))
    assert longer.rows[:2] == first.rows
    assert (longer.epochs, longer.epochs_done, longer.extensions) == (4, 4, ((2, 2),))
    again = train(HYPOTHESES, images, out, _epochs(5))
    assert again.extensions == ((2, 2), (4, 4))
    assert read_record(out / "weights.safetensors") == again
    assert train(HYPOTHESES, images, tmp_path / "at once", _epochs(4)).extensions == ()


def test_the_learning_rate_follows_the_stretched_schedule_from_where_it_was_extended(images, tmp_path):
    cosine = replace(HYPOTHESES, schedule="cosine", learning_rates=(1e-3,), milestones=())
    out = tmp_path / "run"
    train(cosine, images, out, _epochs(2))
    extended = [row["learning_rate"] for row in train(cosine, images, out, _epochs(4)).rows]
    at_once = [row["learning_rate"] for row in train(cosine, images, tmp_path / "at once", _epochs(4)).rows]
    assert extended[2:] == at_once[2:]
    assert extended[1] < extended[2] > extended[3]
    assert not same_tensors(out / FILES[0], tmp_path / "at once" / FILES[0])


def test_what_was_freed_stays_free_and_winners_stay_few_in_an_extension(images, tmp_path):
    """At once in 12 epochs, 6 would be frozen, and 4 be all winners."""
    train(CLASSIFIER, images, tmp_path / "classifier", _epochs(4))
    rows = train(CLASSIFIER, images, tmp_path / "classifier", _epochs(5)).rows
    assert [row["is_frozen"] for row in rows] == [1, 1, 0, 0, 0]
    record = replace(read_record(tmp_path / "classifier" / FILES[0]), epochs=12)
    assert CLASSIFIER.is_frozen_at(rate_position(record, 4))
    assert not CLASSIFIER.is_frozen_at(stage_position(record, 4))
    train(HYPOTHESES, images, tmp_path / "hypotheses", _epochs(4))
    rows = train(HYPOTHESES, images, tmp_path / "hypotheses", _epochs(6)).rows
    assert [row["winners"] for row in rows] == [4, 4, 2, 1, 1, 1]


@pytest.mark.parametrize("steps", [1, 3])  # in the middle of the first epoch of the extension, and of the second
def test_an_extension_that_was_stopped_goes_on_to_the_same_bits(steps, images, tmp_path):
    class StopError(Exception):
        pass

    done = 0

    def stop(count):
        nonlocal done
        done += 1
        if done == steps:
            raise StopError

    for name in ("whole", "stopped"):
        train(HYPOTHESES, images, tmp_path / name, _epochs(2))
    train(HYPOTHESES, images, tmp_path / "whole", _epochs(4))
    before = [read_record(tmp_path / "stopped" / name) for name in FILES]
    with pytest.raises(StopError):
        train(HYPOTHESES, images, tmp_path / "stopped", _epochs(4), on_batch=stop)
    if steps == 1:  # nothing was finished, so what is there is the training before
        assert [read_record(tmp_path / "stopped" / name) for name in FILES] == before
    record = train(HYPOTHESES, images, tmp_path / "stopped", _epochs(4))
    assert record.extensions == ((2, 2),)
    assert all(same_tensors(tmp_path / "whole" / name, tmp_path / "stopped" / name) for name in FILES)


def test_one_that_is_not_finished_is_extended_from_where_it_stands(images, tmp_path):
    def stop_after_one(record):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        train(HYPOTHESES, images, tmp_path / "run", _epochs(3), on_epoch=stop_after_one)
    record = train(HYPOTHESES, images, tmp_path / "run", _epochs(4))
    assert (record.epochs_done, record.extensions) == (4, ((1, 3),))


def test_a_calibration_is_of_the_new_end(images, tmp_path, monkeypatch):
    told = []

    def calibrate(*_):
        told.append(1)
        return {"f_measure": len(told) / 10}

    monkeypatch.setattr(MixtureLearner, "calibrate", calibrate)
    assert train(MIXTURE, images, tmp_path / "run", _epochs(1)).calibration == {"f_measure": 0.1}
    between = []
    record = train(MIXTURE, images, tmp_path / "run", _epochs(3), on_epoch=lambda now: between.append(now.calibration))
    assert record.calibration == {"f_measure": 0.2}
    assert between == [{}, {"f_measure": 0.2}]


def test_another_number_of_epochs_says_what_to_do(images, tmp_path):
    out = tmp_path / "run"
    train(HYPOTHESES, images, out, _epochs(2))
    before = (out / FILES[1]).read_bytes()
    with pytest.raises(
        TrainingError, match=r"of 2 epochs, 2 of them finished, and 1 were .* --epochs 2 resumes .*short"
    ):
        train(HYPOTHESES, images, out, _epochs(1))
    with pytest.raises(TrainingError, match=r"and 4 were asked for; .* --epochs 2 resumes it; --epochs 4 extends"):
        train(HYPOTHESES, images, out, CPU)  # the recipe's own number: nobody asked for more
    with pytest.raises(TrainingError, match=r"(?s)- seed: there 0, asked for 3.*- epochs: there 2, asked for 1"):
        train(HYPOTHESES, images, out, replace(CPU, epochs=1, seed=3))
    assert (out / FILES[1]).read_bytes() == before
