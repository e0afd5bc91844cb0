"""What the scorers of all tracks obey: scores of parts merge to the scores of the whole."""

from dataclasses import astuple

import numpy as np
import pytest
from hand_made_truths import (
    NEAR_PI_TOLERANCE,
    any_group,
    as_sparse,
    assert_same_table,
    hand_made,
    quick,
    score_classifier,
    score_density,
    score_hypotheses,
    seeds,
    some_claims,
    some_density,
    some_hypotheses,
)
from hypothesis import given, settings

from symsol_annot.bench.scoring.averages import figures, merge


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
