"""Fixtures: small sets to predict, files of predictions about them, and the faults of a file that was changed."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
import valid_predictions
from bench_sets import small_set
from changed_predictions import MISSING
from made_sets import make_set
from valid_predictions import valid_attributes, valid_columns, write_file
from written_predictions import IMAGES, write

from symsol_annot import load
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import PredictionsError


@pytest.fixture(scope="session")
def tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture(scope="session")
def another_tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("other"), "tetX", IMAGES, seed=1)


@pytest.fixture(scope="session")
def alone(tetX, tmp_path_factory):
    """A file for each track."""
    folder = tmp_path_factory.mktemp("alone")
    for track in TRACKS:
        write(track, folder / f"{track}.h5", tetX)
    return {track: folder / f"{track}.h5" for track in TRACKS}


@pytest.fixture(scope="session")
def _two_tracks(alone, tetX, tmp_path_factory):
    path = Path(shutil.copy(alone["hypotheses"], tmp_path_factory.mktemp("two") / "preds.h5"))
    write("classifier", path, tetX)
    return path


@pytest.fixture
def written(_two_tracks, tmp_path):
    """A file with hypotheses and a classifier."""
    (tmp_path / "written").mkdir()
    return Path(shutil.copy(_two_tracks, tmp_path / "written"))


# --- files that are read ---


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A folder with a tetX set of 6 images."""
    folder = tmp_path_factory.mktemp("data")
    make_set(folder, "tetX", test=valid_predictions.IMAGES)
    return folder


@pytest.fixture(scope="session")
def valid(data):
    """The columns and attributes of a file with all tracks."""
    dataset = load(data / "tetX")
    return valid_columns(dataset, np.random.default_rng(0)), valid_attributes(dataset)


@pytest.fixture
def scores(tmp_path, data, valid):
    """Write a file with some columns and attributes changed, then score it."""

    def score(columns=None, attributes=None, edit=lambda _: None, tracks=TRACKS, **stored):
        wanted = {"image_index", *(name for track in tracks for name in TRACKS[track].datasets)}
        merged = {**{name: valid[0][name] for name in valid[0] if name in wanted}, **(columns or {})}
        attrs = {**valid[1], **(attributes or {})}
        write_file(
            tmp_path / "preds.h5",
            {name: column for name, column in merged.items() if column is not MISSING},
            {name: value for name, value in attrs.items() if value is not MISSING},
            **stored,
        )
        with h5py.File(tmp_path / "preds.h5", "r+") as file:
            edit(file)
        return score_file(tmp_path / "preds.h5", data)

    return score


@pytest.fixture
def faults(scores):
    """Score a file that must have faults, as `scores` takes them; return them, one per line."""

    def refused(*arguments, **keywords):
        with pytest.raises(PredictionsError) as caught:
            scores(*arguments, **keywords)
        assert str(caught.value).count("\n  - ") == len(caught.value.faults)
        assert all(line.isprintable() for line in str(caught.value).split("\n"))
        return "\n".join(caught.value.faults)

    return refused


@pytest.fixture
def refused(tmp_path, data):
    """Write bytes to a file and return why it is refused."""

    def why(content):
        (tmp_path / "preds.h5").write_bytes(content)
        with pytest.raises(PredictionsError) as caught:
            score_file(tmp_path / "preds.h5", data)
        assert all(line.isprintable() for line in str(caught.value).split("\n"))
        return "\n".join(caught.value.faults)

    return why


@pytest.fixture(scope="session")
def dozen(tmp_path_factory):
    """A test split of 12 images."""
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", 12)
