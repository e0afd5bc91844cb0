"""The calls that write a track: what ends up in the file, and which settings they refuse."""

import numpy as np
import pytest
from methods import random_rotations
from written_predictions import (
    CELLS,
    IMAGES,
    LEVEL,
    METHOD,
    contents,
    hypothesise,
    left_beside,
    probability,
    refuse_to_answer,
    rows_of,
    write,
)

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.writing.submission import write_columns, write_hypotheses
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.rotations.grid import equivolumetric_grid, grid_size


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_an_array_is_in_the_file_as_it_was_given(tetX, tmp_path, dtype):
    hypotheses, weights = random_rotations().astype(dtype), np.random.default_rng(1).random((IMAGES, 3)).astype(dtype)
    write_hypotheses(tmp_path / "preds.h5", tetX, hypotheses, weights=weights, method=METHOD)
    columns, attributes = contents(tmp_path / "preds.h5")
    assert columns["hypotheses"].dtype == columns["hypothesis_weights"].dtype == dtype
    assert np.array_equal(columns["hypotheses"], hypotheses)
    assert np.array_equal(columns["hypothesis_weights"], weights)
    assert np.array_equal(columns["image_index"], np.arange(IMAGES))
    assert attributes == {
        "format": "symsol-annot predictions",
        "format_version": 1,
        "method": METHOD,
        "object": "tetX",
        "split": "test",
        "fingerprint": tetX.fingerprint,
    }
    assert left_beside(tmp_path / "preds.h5") == []


def test_a_callable_writes_the_bytes_that_its_array_does(tetX, tmp_path):
    write_hypotheses(tmp_path / "array.h5", tetX, random_rotations(), method=METHOD)
    write_hypotheses(tmp_path / "callable.h5", tetX, hypothesise, method=METHOD)
    assert (tmp_path / "array.h5").read_bytes() == (tmp_path / "callable.h5").read_bytes()


def test_images_with_fewer_hypotheses_are_padded_with_weight_0(tetX, tmp_path):
    given_ones = [random_rotations(7)[i, : 1 + i % 7] for i in range(IMAGES)]
    write_hypotheses(tmp_path / "preds.h5", tetX, given_ones.__getitem__, method=METHOD)
    columns, _ = contents(tmp_path / "preds.h5")
    assert columns["hypotheses"].shape == (IMAGES, 7, 3, 3)
    for row, weight, one in zip(columns["hypotheses"], columns["hypothesis_weights"], given_ones, strict=True):
        assert np.array_equal(weight, np.arange(7) < len(one))
        assert np.array_equal(row[: len(one)], one)


def test_images_of_two_precisions_are_stored_in_the_lower_one(tetX, tmp_path):
    off_by_less_than_a_float32_may = (random_rotations() * (1 + 3e-5)).astype(np.float32)
    write_hypotheses(
        tmp_path / "preds.h5",
        tetX,
        lambda i: off_by_less_than_a_float32_may[i] if i % 2 else hypothesise(i),
        method=METHOD,
    )
    stored = contents(tmp_path / "preds.h5")[0]["hypotheses"]
    assert stored.dtype == np.float32
    assert np.array_equal(stored[1::2], off_by_less_than_a_float32_may[1::2])
    assert np.array_equal(stored[::2], random_rotations()[::2].astype(np.float32))


@pytest.mark.parametrize("batch_size", [1, 50, 10**6])
def test_each_query_and_each_grid_rotation_is_asked_once_in_batches(tetX, tmp_path, batch_size):
    asked = [[] for _ in range(IMAGES)]

    def classify(i, R):
        asked[i].append(R.copy())
        R[:] = np.nan  # as whoever is asked may do
        return np.zeros(len(R))

    write("classifier", tmp_path / "preds.h5", tetX, classify, batch_size=batch_size)
    queries, rotation = Queries(tetX.fingerprint, tetX.symmetry_group), tetX.labels().rotation
    for i in range(IMAGES):
        assert max(map(len, asked[i])) <= batch_size
        expected = [queries.rotations(i, rotation[i]), equivolumetric_grid(LEVEL)]
        assert np.array_equal(np.concatenate(asked[i]), np.concatenate(expected))


def test_a_classifiers_answers_stand_where_its_rotations_were_asked(tetX, tmp_path):
    write("classifier", tmp_path / "preds.h5", tetX, floor=0.3, batch_size=50)
    columns, attributes = contents(tmp_path / "preds.h5")
    queries, rotation = Queries(tetX.fingerprint, tetX.symmetry_group), tetX.labels().rotation
    assert (attributes["floor"], attributes["grid_level"]) == (0.3, LEVEL)
    bounds = columns["grid_offsets"]
    listed, answers = rows_of(columns["grid_indices"], bounds), rows_of(columns["grid_probabilities"], bounds)
    for i in range(IMAGES):
        at_queries = probability(i, queries.rotations(i, rotation[i])).astype(np.float32)
        on_grid = probability(i, equivolumetric_grid(LEVEL)).astype(np.float32)
        assert np.array_equal(columns["query_probability"][i], at_queries)
        assert np.array_equal(listed[i], np.flatnonzero(on_grid > 0.3))
        assert np.array_equal(answers[i], on_grid[on_grid > 0.3])


def test_a_density_file_says_its_floor_and_forgets_that_of_a_track_that_is_replaced(tetX, tmp_path):
    path = tmp_path / "preds.h5"
    write("density", path, tetX, floor=1e-6)
    assert contents(path)[1]["density_floor"] == 1e-6
    write("hypotheses", path, tetX)
    assert contents(path)[1]["density_floor"] == 1e-6
    write("density", path, tetX)
    assert contents(path)[1]["density_floor"] == 1e-300
    columns = {name: contents(path)[0][name] for name in TRACKS["density"].datasets}
    write_columns(path, tetX, "density", columns, method=METHOD, grid_level=LEVEL)
    assert "density_floor" not in contents(path)[1]  # nobody said which one these have


@pytest.mark.parametrize(
    ("hypotheses", "error", "words"),
    [
        (5.0, SettingsError, "hypotheses: expected an array, found the number 5"),
        (None, SettingsError, "hypotheses: expected an array of numbers, found object"),
        ([[1.0], [1.0, 2.0]], SettingsError, "hypotheses: expected an array of numbers"),
        (np.zeros((IMAGES, 0, 3, 3)), PredictionsError, "M = 0: 1 to 10000"),
        (np.zeros((IMAGES, 3, 4)), PredictionsError, r"found f8 of shape \(24, 3, 4\)"),
        (random_rotations()[:-1], PredictionsError, rf"found f8 of shape \({IMAGES - 1}, 3, 3, 3\)"),
        (random_rotations().astype(np.float16), SettingsError, "expected float32 or float64 .* found float16"),
        (random_rotations() > 0, PredictionsError, "booleans"),
        (-random_rotations(), PredictionsError, "determinant -1"),
    ],
)
def test_an_array_that_is_no_hypotheses_is_refused(tetX, tmp_path, hypotheses, error, words):
    with pytest.raises(error, match=words):
        write_hypotheses(tmp_path / "preds.h5", tetX, hypotheses, method=METHOD)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("weights", "words"),
    [
        (np.ones((IMAGES, 2)), r"expected f4 or f8 of shape \(24, 3\), found f8 of shape \(24, 2\)"),
        (-np.ones((IMAGES, 3)), "not all finite and at least 0: rows 0, 1, 2, 3, 4 and 19 more"),
        (np.zeros((IMAGES, 3)), "has no positive one: rows 0"),
    ],
)
def test_weights_that_are_none_are_refused(tetX, tmp_path, weights, words):
    with pytest.raises(PredictionsError, match=words):
        write_hypotheses(tmp_path / "preds.h5", tetX, random_rotations(), weights=weights, method=METHOD)


def test_weights_belong_to_an_array(tetX, tmp_path):
    with pytest.raises(SettingsError, match="weights: belong to an array"):
        write("hypotheses", tmp_path / "preds.h5", tetX, refuse_to_answer, weights=np.ones((IMAGES, 3)))


@pytest.mark.parametrize(
    ("track", "options", "words"),
    [
        ("classifier", {"floor": -0.1}, "floor: expected 0 to 0.8, found -0.1"),
        ("classifier", {"floor": 0.81}, "floor: expected 0 to 0.8"),
        ("classifier", {"floor": float("nan")}, "floor: expected 0 to 0.8, found nan"),
        ("density", {"floor": 0.0}, "floor: expected at least 1e-300 and less than 1, found 0.0"),
        ("density", {"floor": 1.0}, "floor: expected at least 1e-300 and less than 1"),
        ("density", {"floor": float("nan")}, "floor: .*nan"),
        *[(track, {"level": level}, "level: expected 0 to 5") for track in TRACKS if track != "hypotheses"
          for level in (-1, 6, 1.5)],
        *[(track, {"batch_size": size}, "batch_size: expected at least 1") for track in TRACKS if track != "hypotheses"
          for size in (0, -1)],
    ],
)  # fmt: skip
def test_settings_that_make_no_file_are_refused_before_anything_is_asked(tetX, tmp_path, track, options, words):
    with pytest.raises(SettingsError, match=words):
        write(track, tmp_path / "preds.h5", tetX, refuse_to_answer, **options)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("track", "columns", "attributes", "words"),
    [
        ("hypothesis", {}, {}, "there is no track 'hypothesis'; tracks are hypotheses, classifier, density"),
        ("hypotheses", {"image_index": np.arange(IMAGES)}, {}, "image_index: not of the track 'hypotheses'"),
        ("density", {"hypotheses": np.eye(3)}, {}, "hypotheses: not of the track 'density', which has density_offsets"),
        ("classifier", {}, {"flor": 0.2}, "flor: not of the track 'classifier', which has .*floor"),
        ("density", {}, {"format": "mine"}, "format: not of the track"),
    ],
)
def test_columns_and_attributes_of_another_track_are_refused(tetX, tmp_path, track, columns, attributes, words):
    with pytest.raises(SettingsError, match=words):
        write_columns(tmp_path / "preds.h5", tetX, track, columns, method=METHOD, **attributes)


def test_all_that_a_track_lacks_is_said_at_once(tetX, tmp_path):
    with pytest.raises(PredictionsError) as refused:
        write_columns(
            tmp_path / "preds.h5",
            tetX,
            "classifier",
            {"grid_offsets": np.zeros(IMAGES, dtype=int)},
            method=METHOD,
            grid_level=0,
        )
    said = str(refused.value)
    for words in ("'query_probability' is missing", "'grid_indices' is missing", "'grid_probabilities' is missing"):
        assert words in said
    assert "'grid_offsets': expected i8 or i4 of shape (25), found i8 of shape (24,)" in said


def test_the_grid_of_these_tests_has_as_many_cells_as_they_say():
    assert grid_size(LEVEL) == CELLS
