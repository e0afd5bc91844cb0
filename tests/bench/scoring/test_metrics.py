"""Each metric against numbers worked out by hand, and at the edges of its definition."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot.bench.scoring import metrics
from symsol_annot.rotations.groups import tetrahedral_group
from symsol_annot.rotations.so3 import rotations_about

quick = settings(deadline=None, max_examples=100)
counts = st.integers(0, 10_000)


def about_z(*angles_deg):
    return rotations_about((0, 0, 1), np.radians(angles_deg))


def as_counts(*numbers):
    return np.array(numbers, dtype=np.int64)


# --- a known answer: four members a quarter turn apart, hypotheses at 0, 10 and 93 degrees ---

MEMBERS = about_z(0, 90, 180, 270)
HYPOTHESES = about_z(0, 10, 93)
THRESHOLDS = np.radians([1, 5, 10.5, 88])
RECALL_ERRORS_DEG = [0, 3, 87, 90]  # from 0 to 0, 90 to 93, 180 to 93, 270 to 0 a turn on
PRECISION_ERRORS_DEG = [0, 10, 3]


def test_known_answer_of_hypotheses():
    recall_errors, precision_errors = metrics.recall_and_precision_errors(MEMBERS, HYPOTHESES)
    np.testing.assert_allclose(np.degrees(recall_errors), RECALL_ERRORS_DEG, rtol=0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(precision_errors), PRECISION_ERRORS_DEG, rtol=0, atol=1e-12)
    assert metrics.mean_error(recall_errors) == pytest.approx(math.radians(45), abs=1e-14)
    assert metrics.mean_error(precision_errors) == pytest.approx(math.radians(13 / 3), abs=1e-14)
    coverage = metrics.share_within(recall_errors, THRESHOLDS)
    accuracy = metrics.share_within(precision_errors, THRESHOLDS)
    np.testing.assert_allclose(coverage, [1 / 4, 2 / 4, 2 / 4, 3 / 4])
    np.testing.assert_allclose(accuracy, [1 / 3, 2 / 3, 1, 1])
    np.testing.assert_allclose(metrics.harmonic_mean(coverage, accuracy), [2 / 7, 4 / 7, 2 / 3, 6 / 7])


def test_known_answer_of_weighted_hypotheses():
    """Weights 2, 1 and 1: the first hypothesis is half of all."""
    weights = np.array([2.0, 1.0, 1.0])
    _, errors = metrics.recall_and_precision_errors(MEMBERS, HYPOTHESES)
    assert metrics.mean_error(errors, weights) == pytest.approx(math.radians((2 * 0 + 10 + 3) / 4), abs=1e-14)
    np.testing.assert_allclose(metrics.share_within(errors, THRESHOLDS, weights), [2 / 4, 3 / 4, 1, 1])


def test_known_answer_of_a_classifier():
    """It finds 3 of 4 members and claims 1 of 576 grid rotations; then none and none; then all and the whole grid."""
    tp, fp = as_counts(3, 0, 4), as_counts(1, 0, 576)
    np.testing.assert_allclose(metrics.recall(tp, 4), [3 / 4, 0, 1])
    np.testing.assert_allclose(metrics.precision(tp, fp), [3 / 4, 1, 4 / 580])
    np.testing.assert_allclose(metrics.f_measure(tp, fp, 4), [6 / 8, 0, 8 / 584])
    np.testing.assert_allclose(metrics.classifier_accuracy(tp, fp, 4, 576), [578 / 580, 576 / 580, 4 / 580])


# --- hypotheses ---


def test_errors_are_of_the_nearest_by_the_angle_between():
    """The tetrahedron's rotations are 120 and 180 degrees apart; half way along an edge of the orbit, 60."""
    group = tetrahedral_group()
    recall_errors, precision_errors = metrics.recall_and_precision_errors(
        group, rotations_about((1, 1, 1), np.radians([60.0, 10.0]))
    )
    np.testing.assert_allclose(np.degrees(precision_errors), [60, 10], rtol=0, atol=1e-12)
    assert np.degrees(recall_errors).min() == pytest.approx(10)
    assert sorted(np.round(np.degrees(recall_errors), 6))[1] == 60  # the third turn that is 60 from the other one


def test_an_angle_of_exactly_the_threshold_is_within_it():
    errors = np.array([0.25, 0.5, 0.75, 1.0])
    np.testing.assert_array_equal(metrics.share_within(errors, np.array([0.5, 1.0])), [0.5, 1.0])
    np.testing.assert_array_equal(metrics.share_within(errors, np.array([0.5, 1.0]), np.ones(4)), [0.5, 1.0])


def test_a_harmonic_mean_of_nothing_is_0_and_of_one_side_0_is_0():
    both = metrics.harmonic_mean(np.array([0.0, 0.0, 1.0, 0.4]), np.array([0.0, 1.0, 0.0, 0.4]))
    np.testing.assert_allclose(both, [0, 0, 0, 0.4])


@quick
@given(st.lists(st.tuples(st.floats(0, np.pi), st.integers(1, 5)), min_size=1, max_size=12))
def test_a_whole_weight_is_so_many_copies(rows):
    errors, weights = np.array(rows).T
    copies = np.repeat(errors, weights.astype(int))
    thresholds = np.radians([1, 30, 90])
    assert metrics.mean_error(errors, weights) == pytest.approx(metrics.mean_error(copies), abs=1e-12)
    np.testing.assert_allclose(
        metrics.share_within(errors, thresholds, weights), metrics.share_within(copies, thresholds), atol=1e-12
    )


def test_a_weighted_share_of_all_is_exactly_1():
    rng = np.random.default_rng(0)
    for count in range(1, 60):
        for weights in (rng.random(count), rng.random(count).astype(np.float32).astype(float)):
            assert metrics.share_within(np.zeros(count), np.array([0.1]), weights) == [1.0]


# --- classifiers ---


def test_precision_is_1_where_nothing_is_predicted_and_recall_and_f_measure_are_0():
    tp, fp = as_counts(0), as_counts(0)
    assert (metrics.precision(tp, fp), metrics.recall(tp, 7), metrics.f_measure(tp, fp, 7)) == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("false_positives", [1, 9])
def test_false_positives_alone_have_precision_and_f_measure_0(false_positives):
    tp, fp = as_counts(0), as_counts(false_positives)
    assert (metrics.precision(tp, fp), metrics.f_measure(tp, fp, 7)) == (0.0, 0.0)


def test_metrics_take_single_counts_and_columns_of_them_alike():
    assert metrics.precision(np.array(3), np.array(1)) == 0.75
    np.testing.assert_array_equal(metrics.precision(as_counts(3, 0), as_counts(1, 0)), [0.75, 1.0])


@quick
@given(st.integers(1, 720), counts, st.data())
def test_f_measure_is_the_harmonic_mean_of_recall_and_precision_where_that_is_defined(set_size, fp, data):
    tp = data.draw(st.integers(1, set_size))
    recall, precision = metrics.recall(as_counts(tp), set_size), metrics.precision(as_counts(tp), as_counts(fp))
    expected = 2 * recall * precision / (recall + precision)
    np.testing.assert_allclose(metrics.f_measure(as_counts(tp), as_counts(fp), set_size), expected, rtol=1e-13)


@quick
@given(st.integers(1, 720), st.data())
def test_accuracy_counts_every_member_and_every_grid_rotation_once(set_size, data):
    tp, fp = data.draw(st.integers(0, set_size)), data.draw(st.integers(0, 576))
    wrong = (set_size - tp) + fp
    accuracy = metrics.classifier_accuracy(as_counts(tp), as_counts(fp), set_size, 576)
    np.testing.assert_allclose(accuracy, 1 - wrong / (set_size + 576), rtol=1e-13)


# --- densities ---


def test_known_answer_of_a_log_likelihood():
    """Of 72 cells, two members' have 1/2 and 1/8: the mean of ln 36 and ln 9, less ln pi^2, is ln 18 - ln pi^2."""
    found = metrics.log_likelihood(np.log([1 / 2, 1 / 8]), 72)
    assert found == pytest.approx(math.log(18) - 2 * math.log(math.pi), abs=1e-14)


def test_uniform_density_has_the_log_likelihood_of_the_literature():
    found = metrics.log_likelihood(np.log(np.full(5, 1 / 294_912)), 294_912)
    assert found == pytest.approx(-2.2895, abs=5e-5)
    assert metrics.log_likelihood(np.zeros(1), 294_912) == pytest.approx(10.30, abs=5e-3)
    assert metrics.log_likelihood(np.zeros(1), 2_359_296) == pytest.approx(12.38, abs=5e-3)


ANGLES_OF_CELLS = np.array([0.0, 0.5, 1.0, 2.0])


def test_cells_not_listed_share_what_is_left_evenly():
    """Cell 1 has 0.4; the other three have 0.2 each: 0.4 x 0.5 + 0.2 x (0 + 1 + 2)."""
    found = metrics.spread(np.array([0.4]), ANGLES_OF_CELLS[[1]], ANGLES_OF_CELLS)
    assert found == pytest.approx(0.4 * 0.5 + 0.2 * 3.0, abs=1e-14)


def test_spread_of_no_listed_cell_is_that_of_the_uniform_density():
    found = metrics.spread(np.zeros(0), np.zeros(0), ANGLES_OF_CELLS)
    assert found == pytest.approx(ANGLES_OF_CELLS.mean(), abs=1e-14)


def test_spread_of_all_cells_is_the_plain_sum():
    p = np.array([0.1, 0.2, 0.3, 0.4])
    assert metrics.spread(p, ANGLES_OF_CELLS, ANGLES_OF_CELLS) == pytest.approx(0.1 + 0.3 + 0.8, abs=1e-14)


def test_spread_of_all_mass_at_the_members_is_0():
    assert metrics.spread(np.array([1.0]), ANGLES_OF_CELLS[[0]], ANGLES_OF_CELLS) == 0.0


@quick
@given(st.integers(0, 2**32 - 1), st.integers(1, 71))
def test_listing_the_cells_that_share_the_rest_changes_no_spread(seed, listed):
    rng = np.random.default_rng(seed)
    angles = rng.uniform(0, np.pi, 72)
    p = rng.dirichlet(np.ones(listed)) * rng.uniform(0.1, 0.9)
    full = np.concatenate([p, np.full(72 - listed, (1 - p.sum()) / (72 - listed))])
    expected = metrics.spread(full, angles, angles)
    assert metrics.spread(p, angles[:listed], angles) == pytest.approx(expected, abs=1e-12)


# --- how much of a set the smallest regions of a density hold ---

HALF_AND_80 = np.array([0.5, 0.8])


def test_members_count_as_far_as_the_region_reaches_their_cells():
    listed = np.array([0.1, 0.4, 0.2, 0.3])
    found = metrics.share_in_regions(np.array([0.4, 0.2]), listed, 4, HALF_AND_80)
    np.testing.assert_allclose(found, [0.5, 0.75], atol=1e-12)  # the example of docs/metrics.md


@pytest.mark.parametrize("listed", [0, 3, 10])
def test_the_uniform_density_holds_of_every_set_what_it_says(listed):
    members = np.where(np.arange(5) < listed, 0.1, -1.0)
    found = metrics.share_in_regions(members, np.full(listed, 0.1), 10, HALF_AND_80)
    np.testing.assert_allclose(found, HALF_AND_80, atol=1e-12)


def test_a_set_that_a_sure_density_misses_is_in_no_region():
    assert metrics.share_in_regions(np.array([-1.0]), np.array([1.0]), 10, HALF_AND_80).tolist() == [0.0, 0.0]
    assert metrics.share_in_regions(np.array([-1.0]), np.array([0.97, 0.01]), 3, HALF_AND_80).tolist() == [0.0, 0.0]


@pytest.mark.parametrize("seed", range(5))
def test_cells_drawn_from_a_density_are_in_its_regions_as_often_as_they_hold(seed):
    rng = np.random.default_rng(seed)
    p = rng.choice([0.1, 0.2, 0.2, 1.0, 3.0], 40)  # many as probable as one another
    p /= p.sum()
    listed = p > p.min()
    masses = np.array([0.05, 0.3, 0.5, 0.9, 0.999])
    of_each = np.stack(
        [
            metrics.share_in_regions(np.array([one if of else -1.0]), p[listed], 40, masses)
            for one, of in zip(p, listed, strict=True)
        ]
    )
    np.testing.assert_allclose(p @ of_each, masses, atol=1e-9)
