"""Scores: equal to an independent recomputation, and unmoved by what must not matter."""

import os
from dataclasses import astuple, dataclass, replace
from functools import lru_cache, partial
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_plan, threads
from scipy.spatial.transform import Rotation
from scoring_oracle import (
    ANGLES_DEG,
    SWEPT,
    ScoreOracle,
    TruthOracle,
    angles,
    digest,
    grid,
    queries,
    query_order,
)

from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.classifier import ClassifierBlock
from symsol_annot.bench.predictions.tracks.density import DensityBlock
from symsol_annot.bench.predictions.tracks.hypotheses import HypothesesBlock
from symsol_annot.bench.predictions.tracks.on_grid import GridReader, SparseRows
from symsol_annot.bench.predictions.tracks.track import TrackReader
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.averages import figures, merge
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.scorers.classifier import ClassifierScorer
from symsol_annot.bench.scoring.scorers.density import DensityScorer
from symsol_annot.bench.scoring.scorers.hypotheses import F_UNWEIGHTED, HypothesesScorer
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of, metrics_shown
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.renderer import View
from symsol_annot.rotations.grid import GridIndex, equivolumetric_grid, grid_sha256
from symsol_annot.rotations.groups import cyclic_group, dihedral_group, nearest_element, tetrahedral_group
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.dataset import Labels

SIZE = 160  # of the images; shown with under 10.2 pixels is barely shown
IMAGES = {"tetX": 32, "cylO": 28, "cone": 5, "icosa": 6}
ANGLE_TOLERANCE, NEAR_PI_TOLERANCE, TOLERANCE = 1e-9, 1e-7, 1e-12
REAL_SETS = os.environ.get("SYMSOL_REAL_SETS")
REAL_NAMES = sorted(path.parent.name for path in Path(REAL_SETS).glob("*/manifest.json")) if REAL_SETS else []

quick = settings(deadline=None, max_examples=20)


# --- small sets, with arcs like those of real ones ---


class LabelRenderer:
    """Draws nothing; a marking's area is that of a flat patch seen by the camera, with frayed ends."""

    AREA_PX = 25.0

    def __init__(self, name):
        normals = {"tetX": -np.ones(3) / 3**0.5, "cylO": np.array([1.0, 0.0, 0.0])}
        centres = {"tetX": -np.ones(3) / 3**1.5, "cylO": np.array([0.656, 0.0, 0.55])}
        self._normal, self._centre = normals.get(name), centres.get(name)
        self.versions = {"renderer": "labels"}

    def render(self, R_m2c):
        pixels = float(self.marking_pixels(R_m2c[None])[0])
        return View(np.zeros((SIZE, SIZE, 3), dtype=np.uint8), np.zeros((SIZE, SIZE), dtype=np.uint8), pixels)

    def marking_pixels(self, R_m2c):
        if self._normal is None:
            return np.zeros(len(R_m2c))
        ray = R_m2c @ self._centre + [0.0, 0.0, 4.0]
        facing = -np.einsum("ij,ij->i", R_m2c @ self._normal, ray) / 4.0
        is_frayed = (facing > 0) & (facing < 0.05) & (np.sin(1e4 * facing) > 0)
        return np.where(is_frayed, 0.0, np.ceil(4 * self.AREA_PX * np.maximum(facing, 0.0)) / 4)

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()


@pytest.fixture(scope="module")
def sets(tmp_path_factory):
    """A folder of small sets, and the oracle's reading of each."""
    folder = tmp_path_factory.mktemp("sets")
    for name, images in IMAGES.items():
        generate(
            make_plan(name, test=images, size=SIZE),
            folder / name,
            threads(partial(LabelRenderer, name), exhaustive=True),
        )
    return folder, {name: TruthOracle(folder / name) for name in IMAGES}


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


# --- messy predictions, written with h5py ---


@dataclass(frozen=True)
class Style:
    """What differs from one messy file to another."""

    level: int = 1
    real: str = "<f8"
    has_weights: bool = False
    floor: float = 0.1
    tracks: tuple[str, ...] = ("hypotheses", "classifier", "density")
    seed: int = 0


grid_of = lru_cache(grid)
index_of = lru_cache(GridIndex)


def turned(R, angle_rad, rng):
    axis = rng.normal(size=3)
    return R @ Rotation.from_rotvec(angle_rad * axis / np.linalg.norm(axis)).as_matrix()


def messy_hypotheses(truth, i, noise, rng):
    """Hits, duplicates, near misses at every threshold's scale, half turns and strays, in random order."""
    members = truth.symmetry_set(i)
    is_round = len(truth.group) >= 360 and len(members) > 1
    between = Rotation.from_euler("z", 6.1e-3 if is_round else 0.0).as_matrix()  # where no threshold is met exactly
    hit = rng.choice(members) @ between
    close = turned(hit, 10.0 ** rng.uniform(-12, -5), rng)
    misses = [turned(rng.choice(members), np.radians(rng.choice(ANGLES_DEG) * rng.uniform(0.6, 1.1)), rng)]
    misses += [turned(rng.choice(members), np.radians(rng.choice(ANGLES_DEG) * rng.uniform(0.6, 1.1)), rng)]
    misses += [*Rotation.random(2, random_state=int(rng.integers(2**32))).as_matrix()]
    misses = np.array(misses) + rng.uniform(-noise, noise, (len(misses), 3, 3))
    across = np.cross([0.0, 0.0, 1.0] if len(truth.group) >= 360 else np.ones(3), rng.normal(size=3))
    half_turn = Rotation.from_rotvec(np.pi * across / np.linalg.norm(across)).as_matrix()  # from a whole circle, too
    half_turns = [truth.rotation[i] @ half_turn]
    half_turns += [turned(truth.rotation[i], np.pi - 10.0 ** rng.uniform(-9, -2), rng)]
    return rng.permutation(np.stack([hit, hit, close, *misses, *half_turns]))


def messy_weights(count, rng):
    """Some are 0, at least one is not, and scales differ."""
    weights = rng.choice([0.0, 1e-3, 0.3, 1.0, 7.0], size=count)
    weights[rng.integers(count)] = 0.5
    return weights


def messy_probabilities(count, above, real, rng):
    """Between `above` and 1; in float64, which holds the thresholds as they are, many at exactly a threshold."""
    anywhere = above + (1.0 - above) * rng.uniform(1e-6, 1.0, count)
    exact = np.array([p for p in (0.0, *SWEPT, 1.0) if p > above]) if real == "<f8" else np.ones(1)
    return np.where(rng.random(count) < 0.4, rng.choice(exact, size=count), anywhere)


def messy_queries(truth, i, real, rng):
    """Answers that know the members, more or less, and claim some decoys; for every fifth image, nothing."""
    order = len(truth.group)
    is_member = np.concatenate([truth.mask[i], np.zeros(8 * order, dtype=bool)])
    answers = np.maximum(messy_probabilities(9 * order, -1e-9, real, rng), 0.0)
    answers = np.where(is_member | (rng.random(9 * order) < 0.3), answers, 0.0)
    return np.zeros(9 * order) if i % 5 == 0 else answers[query_order(truth.fingerprint, i, order)]


def messy_cells(truth, i, style, rng):
    """Cells near the members and others, ascending; none for every third image."""
    if i % 3 == 0:
        return np.zeros(0, dtype=int)
    if style.level < 4:
        cells = grid_of(style.level)
        near = [int(angles(member, cells).argmin()) for member in rng.choice(truth.symmetry_set(i), 3)]
    else:
        near = index_of(style.level).within(truth.symmetry_set(i), np.radians(1.0))
    return np.union1d(near, rng.integers(72 * 8**style.level, size=rng.integers(1, 40)))


def messy_density(truth, i, style, rng):
    """Cells and log-probabilities: of all cells, of none, or of some that leave a tenth or more to the others."""
    size = 72 * 8**style.level
    if i % 4 == 0:
        p = rng.dirichlet(np.full(size, 0.5)) + 1e-9
        return np.arange(size), np.log(p / p.sum())
    cells = messy_cells(truth, i, style, rng)
    p = rng.dirichlet(np.ones(len(cells))) if len(cells) else np.zeros(0)
    return cells, np.log(p * rng.uniform(0.1, 0.9) + 1e-12)


def write_messy(path, truth, style):
    """Write a predictions file by the format alone, its rows in random order."""
    rng = np.random.default_rng(style.seed)
    rows = rng.permutation(len(truth))
    columns = {"image_index": rows.astype("<i4")}
    attributes = {
        "format": "symsol-annot predictions",
        "format_version": 1,
        "method": "messy",
        "object": truth.object,
        "split": truth.split,
        "fingerprint": truth.fingerprint,
        "grid_level": style.level,
        "grid_sha256": digest(grid_of(style.level)),
        "group_sha256": digest(truth.group),
        "floor": style.floor,
    }
    if "hypotheses" in style.tracks:
        noise = 2e-6 if style.real == "<f4" else 1e-7  # within what is allowed
        hypotheses = np.stack([messy_hypotheses(truth, i, noise, rng) for i in rows])
        if style.has_weights:
            weights = np.stack([messy_weights(hypotheses.shape[1], rng) for _ in rows])
            hypotheses[weights == 0] = np.nan
            columns["hypothesis_weights"] = weights.astype(style.real)
        columns["hypotheses"] = hypotheses.astype(style.real)
    if "classifier" in style.tracks:
        columns["query_probability"] = np.stack([messy_queries(truth, i, style.real, rng) for i in rows])
        cells = [messy_cells(truth, i, style, rng) for i in rows]
        claims = [messy_probabilities(len(c), style.floor, style.real, rng) for c in cells]
        columns |= sparse("grid", "probabilities", cells, claims)
    if "density" in style.tracks:
        cells, log_p = zip(*[messy_density(truth, i, style, rng) for i in rows], strict=True)
        columns |= sparse("density", "log_probabilities", cells, log_p)
    with h5py.File(path, "w") as f:
        f.attrs.update(attributes)
        for name, column in columns.items():
            f[name] = column.astype(style.real) if column.dtype == np.float64 else column
    return path


def sparse(prefix, values_name, cells, values):
    return {
        f"{prefix}_offsets": np.concatenate([[0], np.cumsum([len(c) for c in cells])]).astype("<i8"),
        f"{prefix}_indices": np.concatenate(cells).astype("<i4"),
        f"{prefix}_{values_name}": np.concatenate(values).astype(np.float64),
    }


# --- equal to the oracle ---


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


# --- the table of metrics ---


@pytest.fixture(scope="module")
def every_metric(sets, tmp_path_factory):
    """Scores with all that scorers return: of an object with arcs, with weights, down to the lowest floor."""
    folder, truths = sets
    path = write_messy(
        tmp_path_factory.mktemp("every") / "preds.h5", truths["cylO"], Style(level=0, floor=0.0, has_weights=True)
    )
    return score_file(path, folder).tracks


def test_the_table_has_each_metric_that_a_scorer_returns_once_and_no_other(every_metric):
    assert set(every_metric) == set(SCORINGS)
    for track, scoring in SCORINGS.items():
        assert [metric.name for metric in scoring.metrics] == list(every_metric[track].per_image.values)


def test_metrics_are_pooled_that_weigh_an_image_by_its_set(sets, every_metric):
    sizes = np.array([sum(mask) for mask in sets[1]["cylO"].mask])
    assert len(set(sizes)) > 2
    for track, scoring in SCORINGS.items():
        for metric in scoring.metrics:
            table = every_metric[track].per_image
            expected = sizes if metric.is_pooled else np.ones(len(sizes))
            is_defined = ~np.isnan(table.values[metric.name])
            assert table.weights[metric.name].tolist() == np.where(is_defined, expected, 0).tolist(), metric


def test_what_tables_show_has_a_row_of_its_own_and_what_ranks_is_better_on_one_side_and_has_a_column():
    for track, scoring in SCORINGS.items():
        in_tables = [metric for metric in scoring.metrics if metric.place > Place.FILE]
        assert sorted(metric.row for metric in in_tables) == list(range(1, len(in_tables) + 1))
        assert not metrics_shown(track, Place.TABLES)[0].is_detail
        by = metric_of(track, scoring.track.ranked_by)
        assert by.better
        assert by.place >= Place.LEADERBOARD


# --- unmoved by what must not matter: files ---


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


# --- unmoved by what must not matter: scorers, on truths made by hand ---

GROUPS = {
    "tet": tetrahedral_group(),
    "fifths": cyclic_group(5),
    "cone": cyclic_group(360),
    "cyl": dihedral_group(360),
}
ROUND = ("cone", "cyl")
seeds = st.integers(0, 2**32 - 1)
any_group = st.sampled_from(list(GROUPS))


def hand_made(group_name, count, rng, rotation=None):
    """A truth with full sets, sets of one, arcs with single members beside them, and random sets; R_gt always in."""
    group = GROUPS[group_name]
    mask = rng.random((count, len(group))) < rng.choice([0.0, 0.5, 0.97, 1.0], size=(count, 1))
    for row in mask[::3]:
        row[rng.integers(len(row)) :] = False
    mask[:, 0] = True
    rotation = uniform_rotations(count, rng) if rotation is None else rotation
    visible = ~mask.all(axis=1)
    pixels = np.where(visible, 30.0, 0.0).astype(np.float32)
    return Truth("made", "test", "made by hand", True, 224 * 224, Labels(rotation, mask, group, pixels, visible))


def with_labels(truth, **changed):
    return replace(truth, labels=replace(truth.labels, **changed))


def scored(scorer_type, truth, block, **facts):
    scorer = scorer_type(SimpleNamespace(density_floor=None, **facts), truth)
    return scorer.score_block(block)


def score_hypotheses(truth, hypotheses, weights=None, images=None):
    images = np.arange(len(truth)) if images is None else images
    return scored(HypothesesScorer, truth, HypothesesBlock(images, hypotheses, weights), count=hypotheses.shape[1])


def some_hypotheses(truth, rng, count=5):
    """Of each image, some near its members and some anywhere; no angle is exactly a threshold."""
    made = uniform_rotations(len(truth) * count, rng).reshape(len(truth), count, 3, 3)
    for i, row in enumerate(made):
        members = truth.labels.symmetry_set(i)
        for k in range(count - 2):
            row[k] = turned(rng.choice(members), np.radians(rng.uniform(0.1, 20)), rng)
    return made


def as_sparse(rows):
    """From a list of {index: value} to sparse rows."""
    ordered = [sorted(row.items()) for row in rows]
    entries = [entry for row in ordered for entry in row]
    return SparseRows(
        np.concatenate([[0], np.cumsum([len(row) for row in ordered])]).astype(np.int64),
        np.array([n for n, _ in entries], dtype=np.int64),
        np.array([v for _, v in entries], dtype=np.float64),
    )


def assert_same_table(table, other, metrics=None):
    assert set(table.values) == set(other.values)
    for metric in metrics or table.values:
        tolerance = NEAR_PI_TOLERANCE if metric.endswith("_rad") else TOLERANCE
        np.testing.assert_allclose(table.values[metric], other.values[metric], rtol=0, atol=tolerance, err_msg=metric)
        np.testing.assert_array_equal(table.weights[metric], other.weights[metric], err_msg=metric)


@quick
@given(any_group, seeds, st.booleans())
def test_order_of_hypotheses_does_not_matter(group_name, seed, is_weighted):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses = some_hypotheses(truth, rng)
    weights = np.stack([messy_weights(5, rng) for _ in range(4)]) if is_weighted else None
    order = rng.permutation(5)
    shuffled = None if weights is None else weights[:, order]
    assert_same_table(
        score_hypotheses(truth, hypotheses, weights), score_hypotheses(truth, hypotheses[:, order], shuffled)
    )


@quick
@given(any_group, seeds)
def test_equal_weights_change_nothing_and_neither_does_an_absent_hypothesis(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses = some_hypotheses(truth, rng)
    plain = score_hypotheses(truth, hypotheses)
    padded = np.insert(hypotheses, 2, np.nan, axis=1)
    for weighted in (
        score_hypotheses(truth, hypotheses, np.full((4, 5), 0.3)),
        score_hypotheses(truth, padded, np.insert(np.ones((4, 5)), 2, 0.0, axis=1)),
    ):
        assert_same_table(plain, weighted.select(list(plain.values)))
        np.testing.assert_allclose(weighted.values[F_UNWEIGHTED], plain.values["f_measure_at_5_deg"], atol=1e-12)


@quick
@given(any_group, seeds)
def test_a_weight_of_two_is_two_of_the_same_hypothesis(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses = some_hypotheses(truth, rng)
    twice = score_hypotheses(truth, np.concatenate([hypotheses, hypotheses[:, :2]], axis=1))
    weighted = score_hypotheses(truth, hypotheses, np.array([[2.0, 2.0, 1.0, 1.0, 1.0]] * 4))
    assert_same_table(twice, weighted.select(list(twice.values)))


@quick
@given(any_group, seeds)
def test_one_hypothesis_more_lowers_no_coverage_and_raises_no_recall_error(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses = some_hypotheses(truth, rng)
    fewer, more = score_hypotheses(truth, hypotheses[:, :-1]), score_hypotheses(truth, hypotheses)
    for metric, values in more.values.items():
        if metric.startswith("coverage"):
            assert (values >= fewer.values[metric]).all()
        if metric.startswith("recall_mean_error"):
            assert (values <= fewer.values[metric] + TOLERANCE).all()


@quick
@given(any_group, seeds)
def test_turning_the_world_changes_no_score_of_hypotheses(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses, Q = some_hypotheses(truth, rng), uniform_rotations(1, rng)[0]
    turned_truth = with_labels(truth, rotation=Q @ truth.labels.rotation)
    assert_same_table(score_hypotheses(truth, hypotheses), score_hypotheses(turned_truth, Q @ hypotheses))


def relabelled(truth, rng):
    """Name each image by another member R_gt g0 of its set; also return (N, G), where g0 g is in the group."""
    group, rotation, mask = truth.labels.symmetry_group, truth.labels.rotation.copy(), truth.labels.symmetry_mask.copy()
    moved = np.empty(mask.shape, dtype=int)
    for i in range(len(truth)):
        g0 = group[rng.choice(np.flatnonzero(mask[i]))]
        moved[i] = nearest_element(group, g0 @ group)
        rotation[i], mask[i] = rotation[i] @ g0, mask[i][moved[i]]
    return with_labels(truth, rotation=rotation, symmetry_mask=mask), moved


@quick
@given(any_group, seeds)
def test_score_of_hypotheses_is_invariant_under_relabelling_by_a_symmetry(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses = some_hypotheses(truth, rng)
    other, _ = relabelled(truth, rng)
    assert_same_table(score_hypotheses(truth, hypotheses), score_hypotheses(other, hypotheses))


def some_claims(truth, rng, level=1):
    """Answers of a classifier: (N, 9, G) at candidates and decoys, not yet shuffled, and on the grid."""
    in_order = rng.choice([0.0, 0.05, 0.5, 0.8, 0.9, 1.0], size=(len(truth), 9, len(truth.labels.symmetry_group)))
    cells = [rng.choice(72 * 8**level, size=rng.integers(30), replace=False) for _ in range(len(truth))]
    return in_order, as_sparse([{int(n): rng.choice([0.3, 0.8, 0.85, 1.0]) for n in row} for row in cells])


def score_classifier(truth, in_order, on_grid, images=None, level=1, floor=0.1):
    images = np.arange(len(truth)) if images is None else images
    shuffled = [
        row.reshape(-1)[query_order(truth.fingerprint, i, row.shape[1])]
        for i, row in zip(images.tolist(), in_order, strict=True)
    ]
    block = ClassifierBlock(images, np.stack(shuffled), on_grid)
    return scored(ClassifierScorer, truth, block, grid_level=level, floor=floor)


@quick
@given(st.sampled_from(["tet", "fifths", "cone"]), seeds)
def test_score_of_a_classifier_is_invariant_under_relabelling_by_a_symmetry(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 3, rng)
    in_order, on_grid = some_claims(truth, rng)
    other, moved = relabelled(truth, rng)
    its_order = in_order.copy()
    for i in range(len(truth)):
        its_order[i, 0] = in_order[i, 0][moved[i]]  # the same answers at the same rotations
    assert_same_table(score_classifier(truth, in_order, on_grid), score_classifier(other, its_order, on_grid))


def some_density(truth, rng, level=1):
    size = 72 * 8**level
    cells = [rng.choice(size, size=rng.integers(1, 60), replace=False) for _ in range(len(truth))]
    mass = [rng.dirichlet(np.ones(len(row))) * 0.7 for row in cells]
    return as_sparse([dict(zip(c.tolist(), np.log(p), strict=True)) for c, p in zip(cells, mass, strict=True)])


def score_density(truth, log_p, images=None, level=1):
    block = DensityBlock(np.arange(len(truth)) if images is None else images, log_p)
    return scored(DensityScorer, truth, block, grid_level=level)


@quick
@given(any_group, seeds)
def test_score_of_a_density_is_invariant_under_relabelling_but_for_its_value_at_the_label(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 3, rng)
    log_p = some_density(truth, rng)
    other, _ = relabelled(truth, rng)
    table = score_density(truth, log_p)
    metrics = [metric for metric in table.values if "at_gt" not in metric]
    assert_same_table(table, score_density(other, log_p), metrics)


@settings(quick, max_examples=8)
@given(any_group, seeds)
def test_scores_of_parts_merge_to_the_scores_of_the_whole(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 6, rng)
    hypotheses, log_p = some_hypotheses(truth, rng), some_density(truth, rng)
    order = rng.permutation(6)
    parts = np.split(order, sorted(rng.choice(np.arange(1, 6), size=2, replace=False)))
    in_parts = merge([score_hypotheses(truth, hypotheses[part], images=part) for part in parts])
    whole = score_hypotheses(truth, hypotheses)
    assert_same_table(whole, in_parts)
    whole_figures, merged_figures = figures(whole, truth.strata), figures(in_parts, truth.strata)
    for stratum, made in whole_figures.items():
        for metric, figure in made.items():
            merged = merged_figures[stratum][metric]
            np.testing.assert_allclose(astuple(figure), astuple(merged), rtol=0, atol=NEAR_PI_TOLERANCE)
    parts_of_density = []
    for part in parts:
        rows = [dict(zip(*(column.tolist() for column in log_p.row(i)), strict=True)) for i in part]
        parts_of_density.append(score_density(truth, as_sparse(rows), images=part))
    assert_same_table(score_density(truth, log_p), merge(parts_of_density))


@pytest.mark.parametrize("group_name", ["tet", "cone"])
def test_classifier_scores_of_parts_merge_to_those_of_the_whole(group_name):
    rng = np.random.default_rng(0)
    truth = hand_made(group_name, 6, rng)
    in_order, on_grid = some_claims(truth, rng)
    parts = []
    for part in (np.array([5, 0]), np.array([3, 1, 2, 4])):
        rows = [dict(zip(*(column.tolist() for column in on_grid.row(i)), strict=True)) for i in part]
        parts.append(score_classifier(truth, in_order[part], as_sparse(rows), images=part))
    assert_same_table(score_classifier(truth, in_order, on_grid), merge(parts))


# --- known scores ---


@pytest.mark.parametrize("group_name", ["tet", "fifths"])
def test_the_truth_scores_exactly_one_with_and_without_weights(group_name):
    rng = np.random.default_rng(0)
    truth = hand_made(group_name, 30, rng)
    most = len(truth.labels.symmetry_group)
    hypotheses, weights = np.tile(np.eye(3), (30, most, 1, 1)), np.zeros((30, most))
    for i in range(30):
        members = truth.labels.symmetry_set(i)
        hypotheses[i, : len(members)], weights[i, : len(members)] = members, rng.uniform(0.1, 1.0, len(members))
    table = score_hypotheses(truth, hypotheses, weights)
    for metric, values in table.values.items():
        if metric.endswith("_rad"):
            assert np.abs(values).max() < 1e-12
        else:
            np.testing.assert_array_equal(values, 1.0, metric)


def test_the_truth_of_round_bodies_has_no_error():
    rng = np.random.default_rng(1)
    truth = hand_made("cyl", 3, rng)
    for i in range(3):
        members = truth.labels.symmetry_set(i)[None]
        values = score_hypotheses(truth, members, images=np.array([i])).values
        assert all(np.abs(values[metric]).max() < 1e-12 for metric in values if metric.endswith("_rad"))
        assert all((values[metric] == 1.0).all() for metric in values if not metric.endswith("_rad"))


@pytest.mark.parametrize("group_name", ROUND)
def test_a_true_rotation_covers_its_neighbours_up_to_each_threshold_and_the_one_at_it(group_name):
    """The neighbours of a member are whole degrees away, and so are the thresholds."""
    truth = hand_made(group_name, 20, np.random.default_rng(2))
    labels = truth.labels
    truth = with_labels(truth, symmetry_mask=np.ones_like(labels.symmetry_mask))
    table = score_hypotheses(truth, labels.rotation[:, None])
    for degrees in ANGLES_DEG:
        covered = table.values[f"coverage_at_{degrees}_deg"] * len(labels.symmetry_group)
        np.testing.assert_allclose(covered, 2 * degrees + 1, atol=1e-9, err_msg=f"{degrees} degrees")


def test_the_true_classifier_scores_exactly_one_and_claims_no_decoy():
    truth = hand_made("tet", 10, np.random.default_rng(3))
    in_order = np.zeros((10, 9, 12))
    in_order[:, 0] = truth.labels.symmetry_mask
    values = score_classifier(truth, in_order, as_sparse([{}] * 10)).values
    for metric in ("recall", "precision", "f_measure", "accuracy", "precision_beyond_half_degree"):
        np.testing.assert_array_equal(values[metric], 1.0, metric)
    for metric in ("decoy_false_positive_rate", "grid_positive_rate", "nothing_predicted_rate"):
        np.testing.assert_array_equal(values[metric], 0.0, metric)
    is_full = truth.labels.symmetry_mask.all(axis=1)
    assert is_full.any()
    np.testing.assert_array_equal(np.isnan(values["hard_negative_rate"]), is_full)
    assert (values["hard_negative_rate"][~is_full] == 0).all()


def classifier_warnings(truth, in_order, on_grid, level=4):
    scorer = ClassifierScorer(SimpleNamespace(grid_level=level, floor=0.1), truth)
    table = score_classifier(truth, in_order, on_grid, level=level)
    return " ".join(scorer.warnings(figures(table, truth.strata)["all"]))


def test_yes_to_whatever_is_asked_and_nothing_on_the_grid_does_not_rank_and_the_truth_does():
    truth = hand_made("tet", 10, np.random.default_rng(3))
    yes, honest, nowhere = np.ones((10, 9, 12)), np.zeros((10, 9, 12)), as_sparse([{}] * 10)
    honest[:, 0] = truth.labels.symmetry_mask
    assert "does not rank" in classifier_warnings(truth, yes, nowhere)
    assert classifier_warnings(truth, honest, nowhere) == ""
    assert "do not rank" in classifier_warnings(truth, honest, nowhere, level=3)


def test_a_probability_of_exactly_the_threshold_is_no_claim():
    truth = hand_made("tet", 1, np.random.default_rng(4))
    claims = [np.full((1, 9, 12), p) for p in (0.8, np.nextafter(0.8, 1.0))]
    on_grid = [as_sparse([{5: p[0, 0, 0], 9: p[0, 0, 0]}]) for p in claims]
    at, above = (score_classifier(truth, c, g).values for c, g in zip(claims, on_grid, strict=True))
    assert (at["recall"], at["grid_positive_rate"], at["decoy_false_positive_rate"]) == (0.0, 0.0, 0.0)
    assert (above["recall"], above["grid_positive_rate"], above["decoy_false_positive_rate"]) == (1.0, 2 / 576, 1.0)
    assert (at["nothing_predicted_rate"], above["nothing_predicted_rate"]) == (1.0, 0.0)
    assert (at["recall_above_0.7"], above["recall_above_0.9"]) == (1.0, 0.0)


def test_grid_rotations_within_half_a_degree_of_a_member_count_against_precision_only_where_it_is_plain():
    rng = np.random.default_rng(5)
    cells = rng.choice(576, size=3, replace=False)
    offsets = np.radians([0.49, 0.51, 30.0])
    rotation = np.stack([turned(equivolumetric_grid(1)[n], a, rng) for n, a in zip(cells, offsets, strict=True)])
    truth = hand_made("fifths", 3, rng, rotation)
    truth = with_labels(truth, symmetry_mask=np.eye(1, 5, dtype=bool).repeat(3, axis=0))
    truth, _ = relabelled(truth, rng)
    in_order = np.zeros((3, 9, 5))
    in_order[:, 0, 0] = 1.0
    values = score_classifier(truth, in_order, as_sparse([{int(n): 0.9} for n in cells])).values
    assert values["precision"].tolist() == [0.5, 0.5, 0.5]
    assert values["precision_beyond_half_degree"].tolist() == [1.0, 0.5, 0.5]


def test_hard_negatives_begin_after_five_steps_of_the_lattice():
    """The set is one arc of the elements 0 to 9 of a circle; 10 to 14 and 355 to 359 are within 5 degrees of it."""
    truth = hand_made("cone", 1, np.random.default_rng(6))
    mask = (np.arange(360) < 10)[None]
    truth = with_labels(truth, symmetry_mask=mask)
    for element, expected in ((12, 0.0), (14, 0.0), (355, 0.0), (15, 1 / 340), (354, 1 / 340)):
        in_order = np.zeros((1, 9, 360))
        in_order[0, 0, element] = 1.0
        assert score_classifier(truth, in_order, as_sparse([{}])).values["hard_negative_rate"] == expected


@quick
@given(any_group, seeds)
def test_no_density_is_likelier_than_the_ceiling_and_the_best_one_is_as_likely(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 3, rng)
    table = score_density(truth, some_density(truth, rng)).values
    assert (table["log_likelihood"] <= table["log_likelihood_ceiling"]).all()
    rows = []
    for i in range(3):
        cells, shares = np.unique(index_of(1).nearest(truth.labels.symmetry_set(i)), return_counts=True)
        rows.append(dict(zip(cells.tolist(), np.log(shares / shares.sum() * (1 - 1e-12)), strict=True)))
    best = score_density(truth, as_sparse(rows)).values
    for metric in ("log_likelihood", "log_likelihood_at_gt"):
        np.testing.assert_allclose(best[metric], best[f"{metric}_ceiling"], rtol=0, atol=1e-10)
    np.testing.assert_allclose(best["spread_rad"], best["spread_at_ceiling_rad"], rtol=0, atol=1e-10)


def test_the_uniform_density_has_the_log_likelihood_of_one_over_the_volume_however_it_is_listed():
    truth = hand_made("tet", 3, np.random.default_rng(7))
    uniform = np.log(1 / 576)
    rows = [{}, dict.fromkeys(range(100), uniform), dict.fromkeys(range(576), uniform)]
    values = score_density(truth, as_sparse(rows)).values
    np.testing.assert_allclose(values["log_likelihood"], -np.log(np.pi**2), rtol=0, atol=TOLERANCE)
    np.testing.assert_allclose(values["log_likelihood_at_gt"], -np.log(np.pi**2), rtol=0, atol=TOLERANCE)


def test_a_cell_of_a_very_small_probability_has_its_logarithm():
    """What log_softmax returns is often under -745, where exp is 0."""
    truth = hand_made("tet", 1, np.random.default_rng(8))
    truth = with_labels(truth, symmetry_mask=np.eye(1, 12, dtype=bool))
    cell = int(index_of(1).nearest(truth.labels.rotation)[0])
    values = score_density(truth, as_sparse([{cell: -1000.0}])).values
    expected = -1000.0 + np.log(576 / np.pi**2)
    np.testing.assert_allclose(values["log_likelihood"], expected, rtol=0, atol=1e-9)
    np.testing.assert_allclose(values["log_likelihood_at_gt"], expected, rtol=0, atol=1e-9)


def test_weights_count_by_their_ratios_whatever_their_scale():
    truth = hand_made("tet", 2, np.random.default_rng(9))
    hypotheses = some_hypotheses(truth, np.random.default_rng(10))
    weights = np.array([[1.0, 2.0, 3.0, 4.0, 5.0]] * 2)
    expected = score_hypotheses(truth, hypotheses, weights)
    for scale in (2.0**1021, 2.0**-1074):
        assert_same_table(expected, score_hypotheses(truth, hypotheses, weights * scale))


def test_a_float32_answer_of_the_threshold_is_no_claim_either(sets, tmp_path):
    """float32(0.8) is 0.80000001; a method that answers 0.8 does not answer more than 0.8."""
    folder, truths = sets
    truth = truths["icosa"]
    path = write_messy(tmp_path / "preds.h5", truth, Style(real="<f4", tracks=("classifier",)))
    with h5py.File(path, "r+") as f:
        f["query_probability"][...] = np.float32(0.8)
        f["grid_probabilities"][...] = np.float32(0.8)
    values = score_file(path, folder).tracks["classifier"].per_image.values
    assert (values["recall"] == 0).all()
    assert (values["grid_positive_rate"] == 0).all()


def test_the_digests_of_grid_and_group_are_those_of_an_independent_grid_and_group():
    assert grid_sha256(1) == digest(grid_of(1))
    np.testing.assert_allclose(equivolumetric_grid(2), grid_of(2), rtol=0, atol=1e-14)
    assert load_object("icosa").symmetry_group.shape == (60, 3, 3)
