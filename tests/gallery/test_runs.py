"""Predictions in a gallery: scores are the scorer's, and what is drawn was predicted."""

import h5py
import numpy as np
import pytest
from gallery_files import angles, array, documents, rotations, run_of

from symsol_annot import load
from symsol_annot.bench.predictions import proposals as predicted
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import PredictionsError, ScoresError
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.rotations.grid import equivolumetric_grid


def test_scores_are_the_scorers(index, data, preds):
    scores = score_file(preds["tetX"], data)
    for track, result in scores.tracks.items():
        _, run = run_of(index, track)
        assert run["name"] == result.name
        assert run["warnings"] == list(result.warnings)
        assert len(run["metrics"]) >= 5
        for metric in run["metrics"]:
            expected = result.per_image.values[metric["name"]]
            assert np.allclose(array(metric["values"]), expected, rtol=1e-6, equal_nan=True)
            for stratum, mean in metric["means"].items():
                value = result.figures[stratum][metric["name"]].value
                assert mean is None if np.isnan(value) else mean == pytest.approx(value, rel=1e-5)


def test_no_two_figures_of_an_image_are_the_same_by_definition(index):
    names = [metric["name"] for metric in run_of(index, "hypotheses")[1]["metrics"]]
    assert "recall_mean_error_rad" in names
    assert "recall_mean_error_image_mean_rad" not in names  # differs in the mean over images alone


def points(gallery, index, track, i, name="tetX"):
    n, run = run_of(index, track, name)
    _, document = documents(gallery / index["sets"][run["set"]]["folder"] / f"{i // 100:05d}" / f"run-{n}.js")
    offsets = array(document["offsets"])
    rows = slice(offsets[i % 100], offsets[i % 100 + 1])
    return rotations(document["quat_wxyz"])[rows], array(document["weights"])[rows], document["left_out"][i % 100]


def test_hypotheses_are_drawn_by_weight_and_absent_ones_are_not(gallery, index, preds):
    with h5py.File(preds["tetX"]) as file:
        for i in (0, 99, 100, 103):
            found, weights, left_out = points(gallery, index, "hypotheses", i)
            assert left_out == 0
            assert angles(found, file["hypotheses"][i][[0, 1, 3, 4]]).max() < 0.02
            assert weights.tolist() == [255, 128, 64, 32]


def test_a_classifiers_claims_are_drawn_of_candidates_and_of_the_grid(gallery, index, data):
    dataset, grid = load(data / "tetX"), equivolumetric_grid(1)
    for i in (1, 103):
        candidates = dataset[i].rotation @ dataset.symmetry_group
        expected = [R for R in np.concatenate([candidates, grid]) if 0.5 + 0.5 * R[0, 0] > 0.8]
        found, _, left_out = points(gallery, index, "classifier", i)
        assert len(found) == len(expected)
        assert left_out == 0
        assert max(angles(R, found).min() for R in expected) < 0.02


def test_the_densest_cells_are_drawn_and_the_others_counted(gallery, index, preds):
    with h5py.File(preds["tetX"]) as file:
        rows = slice(*file["density_offsets"][2:4])
        logs = file["density_log_probabilities"][rows]
        cells = equivolumetric_grid(1)[file["density_indices"][rows]]
    seen = logs >= logs.max() + np.log(0.01)
    found, weights, left_out = points(gallery, index, "density", 2)
    assert len(found) == seen.sum() < len(logs)
    assert left_out == len(logs) - seen.sum()
    assert max(angles(R, found).min() for R in cells[seen]) < 0.02
    assert weights[0] == 255
    assert (np.diff(weights.astype(int)) <= 0).all()


def test_more_rotations_than_a_plot_holds_are_counted(monkeypatch, data, preds):
    monkeypatch.setattr(predicted, "MAX_ROTATIONS", 3)
    (run,) = read_runs([preds["cylO"]], data, open_sources(data / "cylO"))
    assert {(len(one.weights), one.left_out) for one in run.predicted} == {(3, 1)}
    assert run.predicted[0].weights.tolist() == [1.0, 0.5, 0.25]


def test_all_images_are_scored_and_those_shown_alone_are_drawn(data, preds):
    for name in ("tetX", "cylO"):
        whole = read_runs([preds[name]], data, open_sources(data / name))
        first = read_runs([preds[name]], data, open_sources(data / name, limit=2))
        assert len(first) == len(whole) > 0
        for few, all_of_them in zip(first, whole, strict=True):
            assert len(few.predicted) == 2 < len(all_of_them.predicted)
            for one, same in zip(few.predicted, all_of_them.predicted, strict=False):
                np.testing.assert_array_equal(one.rotations, same.rotations)
            np.testing.assert_array_equal(few.leading.values, all_of_them.leading.values)
            assert len(few.leading.values) == len(all_of_them.predicted)


def test_predictions_about_images_that_are_not_shown_are_refused(data, preds, tmp_path):
    with pytest.raises(PredictionsError, match="is about tetX test, which the gallery does not show; it shows cylO"):
        read_runs([preds["tetX"]], data, open_sources(data / "cylO"))


def test_the_same_predictions_twice_are_refused(data, preds):
    with pytest.raises(ScoresError, match="give each once"):
        read_runs([preds["cylO"], preds["cylO"]], data, open_sources(data))
