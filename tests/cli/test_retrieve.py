"""The command `retrieve`: from a set to predictions that are scored, and what it refuses in one message."""

import pytest
from made_sets import make_set


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder of sets: tetX, of tiny images."""
    folder = tmp_path_factory.mktemp("retrieving") / "data"
    make_set(folder, "tetX", train=20, test=3, size=16, annotate="all")
    return folder


def test_retrieve_and_score_from_the_command_line(data, here, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = here("retrieve", data / "tetX", "--out", "preds.h5", "--level", "1", "--size", "8")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("preds.h5: hypotheses, classifier, density about 3 images of tetX\nFitted on train")
    done = here("score", "preds.h5", "--data", data)
    assert done.stdout.startswith("tetX, test split, 3 images: retrieval")


def test_what_cannot_be_searched_is_told_in_one_message(data, here, tmp_path):
    bare = make_set(tmp_path, test=2)
    done = here("retrieve", bare, "--out", tmp_path / "preds.h5")
    assert (done.returncode, done.stdout) == (1, "")
    assert "has no split 'train'" in done.stderr
    done = here("retrieve", data / "tetX", "--size", "20", "--out", tmp_path / "preds.h5")
    assert done.returncode == 1
    assert "size: expected 1 to 16 for images of 16 pixels, found 20" in done.stderr
    assert not (tmp_path / "preds.h5").exists()
