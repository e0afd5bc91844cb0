"""What is said while a set is made: rates and times that are true, lines that a machine can read."""

import json

import pytest
from symsol_annot_cli.reporting import Tally, failures_in_words, reporter

from symsol_annot.generation.events import ImagesMade, ShardBegunAgain, ShardFinished, Started, WorkersGone


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def tally(clock):
    return Tally(clock)


STARTED = Started(images=100, shards=5, images_there=40, shards_there=2)
FAILED = ShardBegunAgain("test-00003.h5", "node1/42", 1, "ended by signal SIGKILL")


def test_the_rate_counts_what_this_run_made_from_the_start_of_the_work(clock, tally):
    clock.now = 150.0
    tally.add(STARTED)
    assert (tally.images_per_second, tally.seconds_left) == (0, None)
    clock.now = 160.0
    tally.add(ImagesMade(20))
    assert tally.images_done == 60
    assert tally.images_per_second == pytest.approx(2.0)
    assert tally.seconds_left == pytest.approx(20.0)


def test_failures_are_counted_by_worker_and_named_by_shard(tally):
    for event in (
        STARTED,
        FAILED,
        FAILED,
        ShardBegunAgain("test-00004.h5", "", 1, "hung"),
        ShardFinished("x", 20, "w"),
    ):
        tally.add(event)
    assert tally.shards_done == 3
    assert tally.failures_by_worker() == {"node1/42": 2, "a worker": 1}
    (line,) = failures_in_words(tally)
    assert "test-00003.h5, test-00004.h5; failures by worker: node1/42 (2), a worker (1)" in line


def test_nothing_is_said_of_failures_where_there_were_none(tally):
    assert failures_in_words(tally) == []


def test_every_line_of_the_json_log_is_an_object_with_the_state_of_the_work(capsys):
    with reporter("json", "cylO") as report:
        for event in (STARTED, ImagesMade(1), ImagesMade(1), FAILED, WorkersGone(), ShardFinished("x", 20, "w")):
            report(event)
    lines = [json.loads(line) for line in capsys.readouterr().err.splitlines()]
    assert [line["event"] for line in lines] == [
        "started", "progress", "shard_begun_again", "workers_gone", "shard_finished", "finished",
    ]  # fmt: skip
    state = {"time", "images_done", "images", "shards_done", "shards", "images_per_second", "seconds_left", "failures"}
    assert all(state <= set(line) for line in lines)
    assert lines[2]["reason"] == "ended by signal SIGKILL"
    assert lines[-1]["images_done"] == 42
    assert lines[-1]["failures"] == {"node1/42": 1}


def test_the_json_log_ends_with_why_the_work_stopped(capsys):
    with pytest.raises(ValueError, match="the disk is full"), reporter("json", "cylO"):
        raise ValueError("the disk is full")
    last = json.loads(capsys.readouterr().err.splitlines()[-1])
    assert (last["event"], last["reason"]) == ("stopped", "the disk is full")


def test_failures_are_said_without_a_terminal_too_and_nothing_else_is(capsys):
    with reporter("text", "cylO") as report:
        for event in (STARTED, ImagesMade(1), FAILED, ShardFinished("x", 20, "w")):
            report(event)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err == "test-00003.h5: begun again after failure 1. ended by signal SIGKILL\n"
