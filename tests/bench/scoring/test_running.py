"""A metric in a training loop: batches in any order, on one process or several, give the figures of the whole split."""

import os
import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from bench_sets import small_set

import symsol_annot
from symsol_annot.bench import Metric
from symsol_annot.errors import RotationError, ScoresError, SettingsError
from symsol_annot.rotations.so3 import rotation_to_quat_wxyz, uniform_rotations

IMAGES = 24
RANK = Path(__file__).parents[2] / "support/gloo_ranks.py"


def probability(i, R):
    return np.where(i % 3, 0.5 + 0.5 * np.sin(5 * R[:, 0, 0]), 0.0)


def log_density(i, R):
    return 3.0 * R[:, 1, 1] * np.cos(i)


ASKED = {"classifier": probability, "density": log_density}


@pytest.fixture(scope="module")
def test(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="module")
def hypotheses():
    return uniform_rotations(IMAGES * 5, np.random.default_rng(1)).reshape(IMAGES, 5, 3, 3).astype(np.float32)


@pytest.fixture
def batches():
    order = np.random.default_rng(5).permutation(IMAGES)
    return [order[:1], order[1:8], order[8:8], order[8:]]


def assert_same(scores, expected):
    """Figures of strata, columns, facts, warnings and notes, to the bit."""
    assert repr(scores.tracks.keys()) == repr(expected.tracks.keys())
    for name, track in expected.tracks.items():
        assert repr(scores.tracks[name].figures) == repr(track.figures)
        assert (scores.tracks[name].facts, scores.tracks[name].notes) == (track.facts, track.notes)
        for metric, values in track.per_image.values.items():
            assert scores.per_image[name][metric].tobytes() == values.tobytes()
    assert scores.image_index.tolist() == expected.image_index.tolist()


@pytest.mark.parametrize("ragged", [False, True])
def test_batches_in_any_order_score_as_the_whole(test, hypotheses, batches, ragged):
    rows = [hypotheses[i, : 1 + i % 5] for i in range(IMAGES)] if ragged else list(hypotheses)
    metric = Metric(test, intervals=True)
    for index in batches:
        metric.update([rows[i] for i in index] if ragged else hypotheses[index], index)
    assert len(metric) == IMAGES
    assert_same(metric.compute(), symsol_annot.score(rows, test))


@pytest.mark.parametrize("track", ASKED)
def test_batches_of_a_callable_score_as_the_whole(test, batches, track):
    metric = Metric(test, track, level=1)
    for index in batches:
        metric.update(ASKED[track], index)
    expected = symsol_annot.score(ASKED[track], test, track=track, level=1, intervals=False)
    assert_same(metric.compute(), expected)
    metric.reset()
    assert len(metric) == 0
    metric.update(ASKED[track], range(3))
    assert len(metric.compute().image_index) == 3


def test_tensors_of_a_loader_go_in_as_they_are(test, hypotheses):
    torch = pytest.importorskip("torch")
    from symsol_annot.torch import SymsolDataset

    metric = Metric(test)
    for batch in torch.utils.data.DataLoader(SymsolDataset(test), batch_size=7):
        metric.update(torch.tensor(hypotheses)[batch["index"]].requires_grad_(), batch["index"])
    assert_same(metric.compute(), symsol_annot.score(hypotheses, test, intervals=False))


def test_an_image_that_is_given_twice_counts_once(test, hypotheses):
    metric = Metric(test)
    metric.update(hypotheses, np.arange(IMAGES))
    metric.update(hypotheses[::-1], np.arange(IMAGES))
    assert_same(metric.compute(), symsol_annot.score(hypotheses, test, intervals=False))


def test_some_images_are_scored_by_themselves_and_named_by_their_index(test, hypotheses):
    metric = Metric(test)
    assert repr(metric).startswith("<Metric hypotheses: 0 of 24 images")
    with pytest.raises(ScoresError, match="no image was given yet"):
        metric.compute()
    metric.update(hypotheses[10:14], [10, 11, 12, 13])
    scores = metric.compute()
    assert not scores.is_whole
    assert scores.image_index.tolist() == [10, 11, 12, 13]
    assert_same(scores, symsol_annot.score(hypotheses[10:14], test[10:14], intervals=False))
    of_slice = Metric(test[8:16])
    of_slice.update(hypotheses[10:14], [10, 11, 12, 13])
    assert_same(of_slice.compute(), scores)
    with pytest.raises(SettingsError, match="has no image 16"):
        of_slice.update(hypotheses[16:17], [16])


@pytest.mark.parametrize("track", ["hypotheses", *ASKED])
def test_states_of_parts_merge_to_the_whole(test, hypotheses, track):
    def part(rows):
        metric = Metric(test, track, level=0)
        metric.update(ASKED.get(track, hypotheses[rows]), rows)
        return metric

    first, second, both = part(range(14)), part(range(9, IMAGES)), part(range(IMAGES))
    empty = Metric(test, track, level=0)
    for state in (first.state(), second.state()):
        empty.merge(pickle.loads(pickle.dumps(state)))
    assert_same(empty.compute(), both.compute())
    first.merge(first.state(), second.state())
    assert_same(first.compute(), both.compute())


def test_two_processes_of_torch_give_the_figures_of_one(test, hypotheses, tmp_path):
    pytest.importorskip("torch")
    np.save(tmp_path / "hypotheses.npy", hypotheses)
    command = [sys.executable, RANK]
    words = ["2", tmp_path / "rendezvous", test.folder, tmp_path / "hypotheses.npy"]
    environment = {**os.environ, "GLOO_SOCKET_IFNAME": "lo", "OMP_NUM_THREADS": "1"}
    ranks = [
        subprocess.Popen([*command, str(rank), *words], stdout=subprocess.PIPE, text=True, env=environment)
        for rank in range(2)
    ]
    printed = [process.communicate(timeout=300)[0] for process in ranks]
    assert [process.returncode for process in ranks] == [0, 0]
    expected = [
        symsol_annot.score(hypotheses, test, intervals=False).figures,
        symsol_annot.score(log_density, test, track="density", level=0, intervals=False).figures,
    ]
    assert printed == ["".join(f"{figures!r}\n" for figures in expected)] * 2


REFUSED = {
    "quaternions": (lambda R: (rotation_to_quat_wxyz(R), range(4)), "quat_wxyz_to_rotation"),
    "no index": (lambda R: (R, 3), 'batch["index"]'),
    "real index": (lambda R: (R, np.ones(4)), "expected whole numbers"),
    "another count": (lambda R: (R, range(3)), "expected"),
    "outside": (lambda R: (R, [0, 1, 2, 99]), "has no image 99"),
    "negative": (lambda R: (R, [0, 1, 2, -1]), "has no image -1"),
    "a reflection": (lambda R: (-R, range(4)), "image 0"),
    "nothing": (lambda R: (None, range(4)), "predictions: expected an array of numbers"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_batch_is_refused_and_nothing_of_it_stays(test, hypotheses, what):
    make, words = REFUSED[what]
    metric = Metric(test)
    with pytest.raises((SettingsError, RotationError)) as caught:
        metric.update(*make(hypotheses[:4]))
    assert words in str(caught.value)
    assert len(metric) == 0


def test_states_of_something_else_are_refused(test, hypotheses, tmp_path):
    metric = Metric(test)
    other = small_set(tmp_path, "tetX", 5, seed=3)
    for state, words in (
        (Metric(test, "density", level=0).state(), "of the track 'density'"),
        (Metric(other).state(), "of the fingerprint"),
        ({}, r"expected what Metric\.state returns"),
        (None, r"expected what Metric\.state returns"),
    ):
        with pytest.raises(SettingsError, match=words):
            metric.merge(state)
    with pytest.raises(SettingsError, match="did you mean 'density'"):
        Metric(test, "densities")
    with pytest.raises(SettingsError, match=r"expected what symsol_annot\.load returns"):
        Metric("data/tetX")
