"""The scorer of a density, on truths made by hand."""

import numpy as np
from hand_made_truths import (
    TOLERANCE,
    any_group,
    as_sparse,
    assert_same_table,
    hand_made,
    quick,
    relabelled,
    score_density,
    seeds,
    some_density,
    with_labels,
)
from hypothesis import given
from messy_predictions import index_of

from symsol_annot.bench.scoring.scorers.density import REGIONS, region_metric


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


@quick
@given(any_group, seeds)
def test_regions_of_the_best_density_hold_the_sets_as_they_say_and_of_any_more_as_they_grow(group_name, seed):
    rng = np.random.default_rng(seed)
    truth = hand_made(group_name, 3, rng)
    names = [region_metric(percent) for percent in REGIONS]
    values = score_density(truth, some_density(truth, rng)).values
    shares = np.stack([values[name] for name in names])
    assert ((shares >= 0) & (shares <= 1) & (np.diff(shares, axis=0, prepend=0.0) >= 0)).all()
    rows = []
    for i in range(3):
        cells, counts = np.unique(index_of(1).nearest(truth.labels.symmetry_set(i)), return_counts=True)
        rows.append(dict(zip(cells.tolist(), np.log(counts / counts.sum() * (1 - 1e-12)), strict=True)))
    best = score_density(truth, as_sparse(rows)).values
    for percent, name in zip(REGIONS, names, strict=True):
        np.testing.assert_allclose(best[name], percent / 100.0, atol=1e-6)
