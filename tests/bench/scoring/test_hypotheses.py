"""The scorer of hypotheses, on truths made by hand."""

import numpy as np
import pytest
from hand_made_truths import (
    ROUND,
    TOLERANCE,
    any_group,
    assert_same_table,
    hand_made,
    quick,
    relabelled,
    score_hypotheses,
    seeds,
    some_hypotheses,
    with_labels,
)
from hypothesis import given
from hypothesis import strategies as st
from messy_predictions import messy_weights
from scoring_oracle import ANGLES_DEG

from symsol_annot.bench.scoring.scorers.hypotheses import F_UNWEIGHTED, HYPOTHESES_SCORING
from symsol_annot.rotations.so3 import uniform_rotations


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


@quick
@given(any_group, seeds)
def test_score_of_hypotheses_is_invariant_under_relabelling_by_a_symmetry(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 4, rng)
    hypotheses = some_hypotheses(truth, rng)
    other, _ = relabelled(truth, rng)
    assert_same_table(score_hypotheses(truth, hypotheses), score_hypotheses(other, hypotheses))


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


def test_weights_count_by_their_ratios_whatever_their_scale():
    truth = hand_made("tet", 2, np.random.default_rng(9))
    hypotheses = some_hypotheses(truth, np.random.default_rng(10))
    weights = np.array([[1.0, 2.0, 3.0, 4.0, 5.0]] * 2)
    expected = score_hypotheses(truth, hypotheses, weights)
    for scale in (2.0**1021, 2.0**-1074):
        assert_same_table(expected, score_hypotheses(truth, hypotheses, weights * scale))


@pytest.mark.parametrize(("group_name", "is_round"), [("tet", False), ("cone", True)])
def test_errors_to_arcs_are_those_of_bodies_with_circles_alone(group_name, is_round):
    truth = hand_made(group_name, 2, np.random.default_rng(11))
    values = score_hypotheses(truth, truth.labels.rotation[:, None]).values
    assert ("precision_mean_error_continuous_rad" in values) == is_round


@pytest.mark.parametrize(("count", "faults"), [(0, 1), (1, 0), (True, 1), ("9", 1)])
def test_a_result_of_one_hypothesis_is_one_and_of_none_is_a_fault(count, faults):
    assert len(list(HYPOTHESES_SCORING.faults_of_facts({"M": count}))) == faults
