"""The scorer of a classifier, on truths made by hand."""

from types import SimpleNamespace

import h5py
import numpy as np
from hand_made_truths import (
    as_sparse,
    assert_same_table,
    hand_made,
    quick,
    relabelled,
    score_classifier,
    seeds,
    some_claims,
    with_labels,
)
from hypothesis import given
from hypothesis import strategies as st
from messy_predictions import Style, turned, write_messy

from symsol_annot.bench.scoring.averages import figures
from symsol_annot.bench.scoring.scorers.classifier import ClassifierScorer
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.grid import equivolumetric_grid


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
