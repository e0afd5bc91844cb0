"""Scores of sets that fill a volume, against figures from the volume's equation, and against laws."""

from types import SimpleNamespace

import numpy as np
import pytest
import volume_truths as plain
from hand_made_truths import as_sparse, score_classifier, score_density, score_hypotheses, with_labels
from scipy.spatial.transform import Rotation

from symsol_annot.annotation.volume import CELLS, Volume
from symsol_annot.bench.predictions.counted import grid_distances, grid_inside
from symsol_annot.bench.predictions.truth import part_of
from symsol_annot.bench.scoring.averages import figures
from symsol_annot.bench.scoring.scorers.around_hypotheses import distances_in_volume, share_of_ball
from symsol_annot.bench.scoring.scorers.classifier import ClassifierScorer
from symsol_annot.bench.scoring.scorers.hypotheses import ANGLES_DEG, SLACK_RAD, HypothesesScorer
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import angle_between, rotations_about, uniform_rotations

LEVEL = 1
THRESHOLDS = np.radians(ANGLES_DEG) + SLACK_RAD
CAP = plain.cap()
EVERYTHING = Volume(np.ones(CELLS, dtype=bool))


@pytest.fixture(scope="module")
def truth():
    return plain.made_truth(12, np.random.default_rng(1), CAP)


def ball(count=4):
    """A ball without marks: every rotation draws every image."""
    truth = plain.made_truth(count, np.random.default_rng(2), EVERYTHING)
    return with_labels(truth, volume=np.zeros(count, np.int32))


def claims_of(truth, rng, level=LEVEL):
    in_order = rng.choice([0.0, 0.5, 0.81, 1.0], size=(len(truth), 9, len(plain.CANDIDATES)))
    size = 72 * 8**level
    cells = [rng.choice(size, size=rng.integers(5, size // 2), replace=False) for _ in range(len(truth))]
    return in_order, [{int(n): float(rng.choice([0.3, 0.9, 1.0])) for n in row} for row in cells]


def true_claims(truth, level=LEVEL):
    in_order = np.zeros((len(truth), 9, len(plain.CANDIDATES)))
    in_order[:, 0] = truth.labels.symmetry_mask
    inside = {int(n): 1.0 for n in grid_inside(truth.labels.volumes[0], level)}
    return in_order, [inside if volume >= 0 else {} for volume in truth.labels.volume]


# --- the classifier ---


@pytest.mark.parametrize("level", [0, 1])
def test_a_classifier_has_the_figures_that_plain_counting_gives(truth, level):
    in_order, on_grid = claims_of(truth, np.random.default_rng(3), level)
    table = score_classifier(truth, in_order, as_sparse(on_grid), level=level)
    for i in range(len(truth)):
        expected = plain.classifier_figures(truth, i, in_order[i], on_grid[i], level)
        for metric, value in expected.items():
            assert table.values[metric][i] == pytest.approx(value, abs=1e-12, nan_ok=True), (i, metric)


def test_the_true_classifier_scores_exactly_one(truth):
    in_order, on_grid = true_claims(truth)
    values = score_classifier(truth, in_order, as_sparse(on_grid), level=LEVEL).values
    for metric in ("recall", "precision", "f_measure", "accuracy", "precision_beyond_half_degree"):
        np.testing.assert_array_equal(values[metric], 1.0, metric)
    for metric in ("decoy_false_positive_rate", "grid_positive_rate", "nothing_predicted_rate"):
        np.testing.assert_array_equal(values[metric], 0.0, metric)
    assert np.nanmax(values["hard_negative_rate"]) == 0


def test_half_of_a_volume_is_half_of_the_recall_and_claims_inside_it_are_never_false(truth):
    _, on_grid = true_claims(truth)
    halved = [dict(list(row.items())[::2]) for row in on_grid]
    in_order = np.zeros((len(truth), 9, len(plain.CANDIDATES)))
    values = score_classifier(truth, in_order, as_sparse(halved), level=LEVEL).values
    filled = truth.labels.volume >= 0
    np.testing.assert_allclose(values["recall"][filled], 0.5, atol=0.01)
    np.testing.assert_array_equal(values["precision"], 1.0)


def test_decoys_inside_a_volume_are_no_false_positives():
    truth = ball()
    values = score_classifier(truth, *(f(x) for f, x in zip((np.asarray, as_sparse), true_claims(truth), strict=True)))
    assert np.isnan(values.values["decoy_false_positive_rate"]).all()
    assert np.isnan(values.values["grid_positive_rate"]).all()


@pytest.mark.filterwarnings("error")
def test_a_plain_ball_is_scored_without_division_by_zero():
    truth = ball(25)
    everywhere = as_sparse([dict.fromkeys(range(576), 1.0)] * 25)
    claims = score_classifier(truth, true_claims(truth)[0], everywhere, level=LEVEL)
    np.testing.assert_array_equal(claims.values["f_measure"], 1.0)
    np.testing.assert_array_equal(claims.values["accuracy"], 1.0)
    nothing = score_classifier(truth, np.zeros((25, 9, 5)), as_sparse([{}] * 25), level=LEVEL)
    np.testing.assert_array_equal(nothing.values["recall"], 0.0)
    over_all = figures(claims, truth.strata)["all"]
    scorer = ClassifierScorer(SimpleNamespace(grid_level=4, floor=0.1), truth)
    assert scorer.warnings(over_all) == ()
    assert scorer.chance_and_best(over_all) == (1.0, 1.0)
    uniform = score_density(truth, as_sparse([{0: np.log(1 / 576)}] * 25), level=LEVEL).values
    np.testing.assert_allclose(uniform["log_likelihood"], -2 * np.log(np.pi))
    np.testing.assert_allclose(uniform["log_likelihood_ceiling"], -2 * np.log(np.pi))
    np.testing.assert_array_equal(uniform["spread_rad"], 0.0)
    hypotheses = score_hypotheses(truth, uniform_rotations(50, np.random.default_rng(0)).reshape(25, 2, 3, 3)).values
    np.testing.assert_array_equal(hypotheses["precision_mean_error_rad"], 0.0)
    np.testing.assert_array_equal(hypotheses["accuracy_at_1_deg"], 1.0)


def test_a_volume_without_a_rotation_of_the_grid_counts_its_member():
    cell = 1000
    R = equivolumetric_grid(5)[cell]
    truth = plain.made_truth(3, np.random.default_rng(0), Volume.of_cells(np.array([cell])))
    truth = with_labels(truth, rotation=np.stack([R, R, R]), volume=np.zeros(3, np.int32))
    for in_order, expected in ((np.ones((3, 9, 5)), 1.0), (np.zeros((3, 9, 5)), 0.0)):
        values = score_classifier(truth, in_order, as_sparse([{}] * 3), level=LEVEL).values
        np.testing.assert_array_equal(values["recall"], expected)
    np.testing.assert_array_equal(truth.counted_on(LEVEL).set_sizes, truth.labels.set_sizes)


# --- the density ---


@pytest.mark.parametrize("level", [0, 1])
def test_a_density_has_the_figures_that_plain_sums_give(truth, level):
    rng = np.random.default_rng(4)
    size = 72 * 8**level
    cells = [rng.choice(size, size=20, replace=False) for _ in range(len(truth))]
    listed = [dict(zip(c.tolist(), np.log(0.7 * rng.dirichlet(np.ones(20))), strict=True)) for c in cells]
    table = score_density(truth, as_sparse(listed), level=level)
    for i in range(len(truth)):
        for metric, value in plain.density_figures(truth, i, listed[i], level).items():
            tolerance = 3e-7 if metric.endswith("_rad") else 1e-9
            assert table.values[metric][i] == pytest.approx(value, abs=tolerance), (i, metric)


def test_the_density_of_a_volume_reaches_its_ceiling_and_an_equally_wide_one_beside_it_does_not(truth):
    rows = np.flatnonzero(truth.labels.volume >= 0)
    some = part_of(truth, rows)
    inside = grid_inside(CAP, LEVEL)
    mass = 1 - 1e-9
    right = {int(n): np.log(mass / len(inside)) for n in inside}
    values = score_density(some, as_sparse([right] * len(rows)), level=LEVEL).values
    without_a_member_beside = some.counted_on(LEVEL).is_counted.sum(axis=1) == 0
    assert without_a_member_beside.any()
    gap = (values["log_likelihood_ceiling"] - values["log_likelihood"])[without_a_member_beside]
    np.testing.assert_allclose(gap, 0, atol=1e-8)
    ceiling = np.log(576 / np.pi**2) - np.log(len(inside))
    np.testing.assert_allclose(values["log_likelihood_ceiling"][without_a_member_beside], ceiling)
    np.testing.assert_allclose(values["set_in_region_of_50_percent"][without_a_member_beside], 0.5, atol=1e-6)
    np.testing.assert_allclose(values["spread_rad"][without_a_member_beside], 0, atol=1e-6)
    wrong = {int(n): np.log(mass / len(inside)) for n in np.setdiff1d(np.arange(576), inside)[: len(inside)]}
    worse = score_density(some, as_sparse([wrong] * len(rows)), level=LEVEL).values
    assert (worse["log_likelihood"] < values["log_likelihood"] - 5).all()
    assert (worse["spread_rad"] > 0.1).all()


@pytest.mark.parametrize("level", [1, 3])
def test_distances_of_a_whole_grid_are_those_of_its_rotations_one_by_one(level):
    grid = equivolumetric_grid(level)
    np.testing.assert_allclose(grid_distances(CAP, level), CAP.distance(grid), atol=1e-7)
    np.testing.assert_allclose(grid_distances(CAP, level), plain.to_cap(grid), atol=1e-7)
    np.testing.assert_array_equal(grid_distances(CAP, level)[grid_inside(CAP, level)], 0.0)


# --- hypotheses ---


@pytest.mark.parametrize("count", [1, 30])
def test_hypotheses_have_the_figures_that_very_many_draws_give(truth, count):
    rng = np.random.default_rng(5)
    some = part_of(truth, np.flatnonzero(truth.labels.volume >= 0)[:1])
    hypotheses = uniform_rotations(count, rng)
    hypotheses[count // 2 :] = CAP.sample(count - count // 2, rng)
    found = {metric: float(values[0]) for metric, values in score_hypotheses(some, hypotheses[None]).values.items()}
    expected = plain.hypotheses_figures(some, 0, hypotheses, rng)
    assert found["recall_mean_error_rad"] == pytest.approx(expected["recall_mean_error_rad"], abs=0.01)
    assert found["precision_mean_error_rad"] == pytest.approx(expected["precision_mean_error_rad"], abs=1e-6)
    for degrees in ANGLES_DEG:
        coverage = f"coverage_at_{degrees}_deg"
        chance = 5 * np.sqrt(max(found[coverage], 1e-5) / 50_000)
        assert abs(found[coverage] - expected[coverage]) < 0.03 * found[coverage] + chance
        assert found[f"accuracy_at_{degrees}_deg"] == expected[f"accuracy_at_{degrees}_deg"]


def test_a_hypothesis_inside_the_volume_has_no_error_and_covers_its_ball():
    """A cap of 60 degrees and more has room for a ball of 30 degrees around a rotation that sees its middle."""
    middle = Rotation.from_euler("x", 180, degrees=True).as_matrix()  # sees the object from its z axis
    wide = Volume.of_directions(lambda v: v[:, 2] >= 0.5)
    errors, shares = distances_in_volume(wide, middle[None], THRESHOLDS)
    assert shares.sum() == pytest.approx(wide.measure)
    for degrees in ANGLES_DEG:
        within = shares[errors <= np.radians(degrees) + SLACK_RAD].sum()
        assert within == pytest.approx((np.radians(degrees) - np.sin(np.radians(degrees))) / np.pi, rel=2e-4)
    assert wide.distance(middle[None])[0] == 0


@pytest.mark.parametrize("offset_rad", [0.0, 1e-9, 1e-7, 1e-3])
def test_the_same_hypothesis_again_covers_nothing_more(offset_rad):
    first = CAP.sample(6, np.random.default_rng(0))
    again = np.concatenate([first, first @ rotations_about((0.6, 0, 0.8), [offset_rad])])
    once, twice = (distances_in_volume(CAP, R, THRESHOLDS) for R in (first, again))
    for limit in THRESHOLDS[2:]:
        shares = [weights[errors <= limit].sum() for errors, weights in (once, twice)]
        assert shares[1] == pytest.approx(shares[0], rel=0.2 if offset_rad else 1e-9)


def test_the_order_of_hypotheses_does_not_matter_for_a_volume(truth):
    rng = np.random.default_rng(0)
    rows = np.flatnonzero(truth.labels.volume >= 0)[:1]
    hypotheses = CAP.sample(20, rng)[None]
    one, other = (score_hypotheses(part_of(truth, rows), H).values for H in (hypotheses, hypotheses[:, ::-1]))
    for metric, values in one.items():
        np.testing.assert_allclose(values, other[metric], rtol=1e-9, err_msg=metric)


@pytest.mark.parametrize("count", [1, 50, 400])
def test_points_stand_for_the_whole_volume_however_many_hypotheses_there_are(count):
    R = uniform_rotations(count, np.random.default_rng(count))
    errors, shares = distances_in_volume(CAP, R, THRESHOLDS)
    assert shares.sum() == pytest.approx(plain.SHARE, rel=1e-9)
    assert (shares >= 0).all()
    assert errors.min() >= 0


def test_a_small_volume_has_points_too():
    small = Volume.of_cells(np.array([5000]))
    far_away = small.sample(1, np.random.default_rng(0)) @ rotations_about((1, 0, 0), [2.0])
    errors, shares = distances_in_volume(small, far_away, THRESHOLDS)
    assert shares.sum() == pytest.approx(small.measure)
    np.testing.assert_allclose(errors, 2.0, atol=0.06)


def test_a_set_weighs_as_many_rotations_as_the_grid_has_in_it(truth):
    filled = truth.labels.volume >= 0
    sizes = truth.set_sizes
    np.testing.assert_array_equal(sizes[~filled], truth.labels.set_sizes[~filled])
    np.testing.assert_allclose(sizes[filled], plain.SHARE * 294_912, rtol=0.03)  # the cap has whole rings of level 5
    tilted = Volume.of_directions(lambda v: v @ [0.48, -0.6, 0.64] > 0.4)
    truth = plain.made_truth(3, np.random.default_rng(0), tilted)
    np.testing.assert_allclose(truth.set_sizes[1:], tilted.measure * 294_912, rtol=0.005)


def test_the_best_that_hypotheses_can_have_is_what_their_balls_can_cover(truth):
    filled = part_of(truth, np.flatnonzero(truth.labels.volume >= 0))
    scorer = HypothesesScorer(SimpleNamespace(count=30), filled)
    coverage = 30 * (1 + 294_912 * share_of_ball(np.radians(5))) / filled.set_sizes
    chance, best = scorer.chance_and_best({})
    assert best == pytest.approx(np.mean(2 * coverage / (1 + coverage)), rel=1e-4)
    assert 0 < chance < best
    apart = uniform_rotations(4000, np.random.default_rng(1))
    apart = apart[CAP.contains(apart)]
    kept = [apart[0]]
    for R in apart[1:]:
        if len(kept) < 30 and angle_between(R, np.stack(kept)).min() > np.radians(11):
            kept.append(R)
    assert len(kept) == 30
    found = score_hypotheses(filled, np.stack([kept] * len(filled))).values["f_measure_at_5_deg"].mean()
    assert 0.7 * best < found < best


def test_sets_without_a_volume_have_the_figures_that_they_had(truth):
    """To the bit, whether or not other images of the split have a volume."""
    rows = np.flatnonzero(truth.labels.volume < 0)
    alone = with_labels(part_of(truth, rows), volume=None, volumes=())
    rng = np.random.default_rng(6)
    hypotheses = uniform_rotations(5 * len(truth), rng).reshape(-1, 5, 3, 3)
    in_order, on_grid = claims_of(truth, rng)
    log_p = [{n: np.log(0.9 * p / sum(row.values())) for n, p in row.items()} for row in on_grid]
    pairs = [
        (score_hypotheses(truth, hypotheses), score_hypotheses(alone, hypotheses[rows])),
        (score_density(truth, as_sparse(log_p), level=1), score_density(alone, as_sparse([log_p[i] for i in rows]))),
    ]
    for together, apart in pairs:
        for metric, values in apart.values.items():
            np.testing.assert_array_equal(values, together.values[metric][rows], metric)
            np.testing.assert_array_equal(apart.weights[metric], together.weights[metric][rows], metric)
    together = score_classifier(truth, in_order, as_sparse(on_grid))
    apart = score_classifier(truth, in_order[rows], as_sparse([on_grid[i] for i in rows]), images=rows)
    for metric, values in apart.values.items():
        np.testing.assert_array_equal(values, together.values[metric][rows], metric)


# --- conventions ---


def test_transposed_rotations_are_told_from_the_right_ones_on_sets_with_volume():
    truth = plain.made_truth(30, np.random.default_rng(8), Volume.of_directions(lambda v: v[:, 0] > 0.6))
    exact = truth.labels.rotation[:, None]
    for hypotheses, has_note in ((exact, False), (np.swapaxes(exact, -1, -2), True)):
        scorer = HypothesesScorer(SimpleNamespace(count=1), truth)
        scorer.score_block(SimpleNamespace(image_index=np.arange(30), hypotheses=hypotheses, weights=None))
        assert bool(scorer.notes()) == has_note
