"""Scores of files: equal to an independent recomputation, and unmoved by what must not matter."""

import os
from dataclasses import astuple
from pathlib import Path

import h5py
import numpy as np
import pytest
from hand_made_truths import ANGLE_TOLERANCE, NEAR_PI_TOLERANCE, TOLERANCE
from label_sets import IMAGES
from messy_predictions import Style, grid_of, write_messy
from scoring_oracle import ScoreOracle, TruthOracle, digest, queries

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.on_grid import GridReader
from symsol_annot.bench.predictions.tracks.track import TrackReader
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.objects.spec import load_object
from symsol_annot.rotations.grid import equivolumetric_grid, grid_sha256

REAL_SETS = os.environ.get("SYMSOL_REAL_SETS")
REAL_NAMES = sorted(path.parent.name for path in Path(REAL_SETS).glob("*/manifest.json")) if REAL_SETS else []


def test_the_small_sets_have_shown_hidden_and_barely_shown_images_frayed_arcs_and_single_members(sets):
    for name in ("tetX", "cylO"):
        strata = sets[1][name].strata()
        assert len(strata["shown"]) + len(strata["hidden"]) == IMAGES[name]
        assert len(strata["hidden"]) >= 8
        assert len(strata["barely"]) >= 2
        assert len(strata["barely"]) < len(strata["shown"])
    truth = sets[1]["cylO"]
    after = dict(truth.pieces)
    ends = [sum(mask[g] and not mask[after[g]] for g in range(720)) for mask in truth.mask]
    assert max(ends) > 2  # an arc a circle has one end; more are frayed


def differences(scores, oracle):
    """Yield (what is compared, difference, whether it is an angle, whether one near pi is in it)."""
    assert set(scores.tracks) == set(oracle.per_image)
    for name, track in scores.tracks.items():
        assert set(track.per_image.values) == set(oracle.per_image[name]) == set(track.per_image.weights)
        assert track.per_image.image_index.tolist() == list(range(len(oracle.truth)))
        for metric, column in oracle.per_image[name].items():
            is_angle = metric.endswith("_rad")
            assert track.per_image.weights[metric].tolist() == [weight for _, weight in column]
            for i, (value, _) in enumerate(column):
                found = track.per_image.values[metric][i]
                yield f"{name} {metric} of image {i}", found, value, is_angle, oracle.is_near_pi[name][i]
        strata, expected = oracle.truth.strata(), oracle.figures(name)
        assert set(track.figures) == set(expected)
        for stratum, images in strata.items():
            assert set(track.figures[stratum]) == set(expected[stratum])
            is_near_pi = any(oracle.is_near_pi[name][i] for i in images)
            for metric, (value, defined, undefined) in expected[stratum].items():
                figure = track.figures[stratum][metric]
                assert (figure.images, figure.undefined) == (defined, undefined), (name, stratum, metric)
                yield f"{name} {metric} of {stratum}", figure.value, value, metric.endswith("_rad"), is_near_pi


def largest_differences(scores, oracle):
    """Return kind to (difference, where): angles, angles near pi, and anything else."""
    largest = {}
    for what, found, expected, is_angle, is_near_pi in differences(scores, oracle):
        kind = "other" if not is_angle else "angle near pi" if is_near_pi else "angle"
        both_undefined = np.isnan(found) and np.isnan(expected)
        off = 0.0 if both_undefined else abs(found - expected)
        if not off <= largest.get(kind, (-1.0, ""))[0]:  # NaN is the largest
            largest[kind] = (off, f"{what}: {found!r}, not {expected!r}")
    return largest


def assert_small(largest):
    allowed = {"angle": ANGLE_TOLERANCE, "angle near pi": NEAR_PI_TOLERANCE, "other": TOLERANCE}
    assert all(off <= allowed[kind] for kind, (off, _) in largest.items()), largest


@pytest.mark.parametrize(
    ("name", "style"),
    [
        ("tetX", Style(level=2)),
        ("tetX", Style(real="<f4", has_weights=True, floor=0.45)),
        ("cylO", Style(has_weights=True, floor=0.8)),
        ("cylO", Style(level=0, real="<f4", floor=0.3, seed=1)),
        ("cone", Style(has_weights=True, floor=0.0)),
        ("icosa", Style(seed=2)),
    ],
)
def test_every_figure_is_what_an_independent_recomputation_gives(sets, tmp_path, name, style):
    folder, truths = sets
    path = write_messy(tmp_path / "preds.h5", truths[name], style)
    oracle = ScoreOracle(path, truths[name])
    assert oracle.knife_edge_rad > 1e-8  # else a rounding error could decide
    assert_small(largest_differences(score_file(path, folder), oracle))


@pytest.mark.skipif(not REAL_NAMES, reason="SYMSOL_REAL_SETS names no folder of sets")
@pytest.mark.parametrize("name", REAL_NAMES or ["no set"])
@pytest.mark.parametrize(
    "style",
    [
        Style(level=2, real="<f8", tracks=("hypotheses", "density")),
        Style(level=2, real="<f4", has_weights=True, tracks=("hypotheses",)),
        Style(level=4, real="<f8", tracks=("classifier",)),
    ],
    ids=["hypotheses and density", "weighted float32 hypotheses", "classifier"],
)
def test_every_figure_of_real_sets_is_what_an_independent_recomputation_gives(tmp_path, name, style):
    truth = TruthOracle(Path(REAL_SETS) / name)
    path = write_messy(tmp_path / "preds.h5", truth, style)
    oracle = ScoreOracle(path, truth)
    largest = largest_differences(score_file(path, Path(REAL_SETS)), oracle)
    print(
        f"\n{name}, {len(truth)} images, {style}: knife edge {oracle.knife_edge_rad:.1e} rad",
        *largest.items(),
        sep="\n  ",
    )
    assert oracle.knife_edge_rad > 1e-9
    assert_small(largest)


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_query_rotations_are_those_of_the_documented_stream(sets, name):
    truth = sets[1][name]
    for i in (0, 7):
        found = Queries(truth.fingerprint, truth.group).rotations(i, truth.rotation[i])
        np.testing.assert_allclose(found, queries(truth.fingerprint, i, truth.rotation[i], truth.group), atol=1e-12)


def assert_same_scores(scores, others):
    for name, track in scores.tracks.items():
        for metric, values in track.per_image.values.items():
            np.testing.assert_array_equal(values, others.tracks[name].per_image.values[metric], metric)
        for stratum, made in track.figures.items():
            for metric, figure in made.items():
                np.testing.assert_equal(astuple(figure), astuple(others.tracks[name].figures[stratum][metric]))


def test_scores_do_not_depend_on_the_order_of_the_rows(sets, tmp_path):
    folder, truths = sets
    path = write_messy(tmp_path / "preds.h5", truths["tetX"], Style(has_weights=True))
    sorted_path = tmp_path / "sorted.h5"
    with h5py.File(path) as f, h5py.File(sorted_path, "w") as g:
        g.attrs.update(f.attrs)
        order = np.argsort(f["image_index"])
        for name in ("image_index", "hypotheses", "hypothesis_weights", "query_probability"):
            g[name] = f[name][()][order]
        for offsets, columns in (
            ("grid_offsets", ("grid_indices", "grid_probabilities")),
            ("density_offsets", ("density_indices", "density_log_probabilities")),
        ):
            bounds = f[offsets][()]
            g[offsets] = np.concatenate([[0], np.cumsum(np.diff(bounds)[order])])
            for name in columns:
                g[name] = np.concatenate([f[name][bounds[row] : bounds[row + 1]] for row in order])
    assert_same_scores(score_file(path, folder), score_file(sorted_path, folder))


def test_scores_do_not_depend_on_how_much_is_read_at_once(sets, tmp_path, monkeypatch):
    folder, truths = sets
    path = write_messy(tmp_path / "preds.h5", truths["tetX"], Style(has_weights=True))
    scores = score_file(path, folder)
    monkeypatch.setattr(TrackReader, "block_bytes", 3000)
    monkeypatch.setattr(GridReader, "block_entries", 50)
    assert_same_scores(scores, score_file(path, folder))


def test_the_digests_of_grid_and_group_are_those_of_an_independent_grid_and_group():
    assert grid_sha256(1) == digest(grid_of(1))
    np.testing.assert_allclose(equivolumetric_grid(2), grid_of(2), rtol=0, atol=1e-14)
    assert load_object("icosa").symmetry_group.shape == (60, 3, 3)
