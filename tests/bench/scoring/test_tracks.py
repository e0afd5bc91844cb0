"""A track is its two objects: with one in each table, files with it are written, read, scored, compared and shown."""

import json
from types import SimpleNamespace

import numpy as np
import pytest
from bench_sets import small_set

from symsol_annot.bench.predictions.columns import dense_column
from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.predictions.proposals import heaviest
from symsol_annot.bench.predictions.tracks import table as track_table
from symsol_annot.bench.predictions.tracks.track import Track, TrackReader
from symsol_annot.bench.predictions.writing.submission import write_columns, write_hypotheses
from symsol_annot.bench.scoring.metric import LOWER, Metric, Place
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.reports.comparison import compare
from symsol_annot.bench.scoring.scorers.scorer import Scorer, TrackScoring
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import PredictionsError
from symsol_annot.rotations.so3 import rotations_about

IMAGES = 21  # of which one more than an interval needs


class GuessReader(TrackReader):
    """Reads one rotation per image, which may be any matrix."""

    name = "guess"

    def is_sound(self):
        return self._structure.is_shaped("guess_rotation", ("<f8",), (self._structure.rows, 3, 3))

    def blocks(self, image_index):
        for i in range(0, len(image_index), 5):
            stop = min(i + 5, len(image_index))
            found = self._file.read("guess_rotation", i, stop)
            self._faults.add_rows(self.name, "is NaN", i, np.isnan(found).any(axis=(1, 2)))
            yield SimpleNamespace(image_index=image_index[i:stop], rotation=found)

    def proposals(self, truth):
        return lambda block, row: heaviest(block.rotation[row][None], np.ones(1))


GUESS = Track(
    reader=GuessReader,
    title="the guess",
    datasets=("guess_rotation",),
    attributes={"effort": float},
    defaults=lambda dataset, given: {"effort": 1.0},
    columns=lambda answers: {"guess_rotation": dense_column(answers, "guess_rotation")},
    ranked_by="guess_error_rad",
)
METRICS = (
    Metric("guess_error_rad", LOWER, Place.SUMMARY, lambda of: of, "error of the guess, rad", row=1),
    Metric("pooled_error_rad", LOWER, Place.TABLES, lambda of: of, "pooled", row=2, is_pooled=True, is_detail=True),
    Metric("absent", LOWER, Place.TABLES, lambda _: None, "never there", row=3),
)


class GuessScorer(Scorer):
    metrics = METRICS

    def __init__(self, reader, truth):
        super().__init__(truth)
        self.facts = {}

    def _measure(self, block):
        sets = [self._truth.labels.symmetry_set(i) for i in block.image_index.tolist()]
        return np.array([s.distance(R[None])[0] for s, R in zip(sets, block.rotation, strict=True)])

    def notes(self):
        return ()


@pytest.fixture(autouse=True)
def _in_the_tables(monkeypatch):
    monkeypatch.setitem(track_table.TRACKS, "guess", GUESS)
    monkeypatch.setitem(track_table.TRACK_OF_DATASET, "guess_rotation", "guess")
    monkeypatch.setitem(SCORINGS, "guess", TrackScoring(track=GUESS, open=GuessScorer, metrics=METRICS))


@pytest.fixture(scope="module")
def tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", IMAGES)


@pytest.fixture
def guessed(tetX, tmp_path):
    """A file with guesses that are off by 0.1 rad, and with hypotheses that were added after them."""
    rotation = tetX.labels().rotation @ rotations_about((0, 0, 1), np.array([0.1]))
    write_columns(tmp_path / "preds.h5", tetX, "guess", {"guess_rotation": rotation}, method="guesses")
    write_hypotheses(tmp_path / "preds.h5", tetX, rotation[:, None], method="guesses")
    return tmp_path / "preds.h5", rotation


def test_a_new_track_is_scored_beside_the_others_by_image_and_by_member(guessed, tetX):
    path, _ = guessed
    scores = score_file(path, tetX.folder)
    assert list(scores.tracks) == ["hypotheses", "guess"]
    found = scores.tracks["guess"]
    np.testing.assert_allclose(found.per_image.values["guess_error_rad"], 0.1, atol=1e-9)
    assert list(found.figures["all"]) == ["guess_error_rad", "pooled_error_rad"]
    assert found.per_image.weights["guess_error_rad"].tolist() == [1] * IMAGES
    assert found.per_image.weights["pooled_error_rad"].tolist() == scores.truth.set_sizes.tolist()
    assert found.figures["all"]["guess_error_rad"].value == pytest.approx(0.1, abs=1e-9)
    assert not SCORINGS["guess"].is_exact(found.figures["all"])  # unless the track says which figures are


def test_a_new_track_is_in_tables_and_comparisons_and_pictures(guessed, tetX, tmp_path):
    path, rotation = guessed
    document = report.to_document([score_file(path, tetX.folder)])
    assert "error of the guess, rad \N{DOWNWARDS ARROW}" in tables.tables(document)
    for name in ("a.json", "b.json"):
        (tmp_path / name).write_text(report.to_json({**document, "method": name}))
    assert "tetX, guess; differences from a.json: guess" in compare([tmp_path / "a.json", tmp_path / "b.json"])
    assert json.loads((tmp_path / "a.json").read_text())["objects"]["tetX"]["per_image"]["guess"].keys() == {
        "guess_error_rad",
        "pooled_error_rad",
    }
    with open_predictions(path, tetX.folder) as predictions:
        (reader,) = (reader for reader in predictions.readers if reader.name == "guess")
        found = predictions.proposals(reader)
    np.testing.assert_array_equal(np.concatenate([one.rotations for one in found]), rotation)


def test_faults_of_a_new_track_have_its_name_and_rows(tetX, tmp_path):
    rotation = np.tile(np.eye(3), (IMAGES, 1, 1))
    rotation[7] = np.nan
    with pytest.raises(PredictionsError, match="guess: is NaN: row 7"):
        write_columns(tmp_path / "preds.h5", tetX, "guess", {"guess_rotation": rotation}, method="guesses")


def test_each_track_is_scored_and_has_data_sets_of_its_own_and_ranks_by_one_of_its_metrics():
    tracks = track_table.TRACKS
    assert list(tracks) == list(SCORINGS)
    every_dataset = [name for track in tracks.values() for name in track.datasets]
    assert len(set(every_dataset)) == len(every_dataset) == len(track_table.TRACK_OF_DATASET)
    for name, track in tracks.items():
        assert SCORINGS[name].track is track
        ranked_by = {track.ranked_by, track.ranked_by_if_there or track.ranked_by}
        assert ranked_by <= {metric.name for metric in SCORINGS[name].metrics}
