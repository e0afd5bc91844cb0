"""Which region a density claims: the threshold of the highest expected F-measure, and F as `score` has it."""

import math

import numpy as np
import pytest

from symsol_annot.bench.models.methods.mixture.claims import CLAIM_LOGIT, Calibration, best_threshold, f_measure


def test_the_threshold_is_that_of_the_formula_at_every_sample():
    rng = np.random.default_rng(0)
    log_p = rng.normal(6.0, 2.0, 50)
    members, cells = 12, 294_912
    expected = []
    for j, t in enumerate(sorted(log_p, reverse=True), 1):
        inside = [one for one in log_p if one >= t]
        true = members * j / 50
        false = cells * sum(math.exp(-one) for one in inside) / 50
        expected.append((2 * true / (true + false + members), t))
    f, log_t = max(expected)
    assert best_threshold(log_p, members, cells) == pytest.approx((log_t, f))


def test_a_ball_that_holds_all_is_claimed_whole():
    """Samples of a density that is the same everywhere in a ball of 1e-4 of all rotations: 29 of the grid, S = 1."""
    log_t, f = best_threshold(np.full(1000, math.log(1e4)), 1, 294_912)
    assert log_t == pytest.approx(math.log(1e4))
    assert f == pytest.approx(2 / (1 + 29.4912 + 1))


def test_a_set_with_volume_is_claimed_up_to_its_edge():
    """Of a density that is 2 in the set, half of all rotations, and less outside, as the grid's own count has it."""
    cells = 1000
    log_p = np.concatenate([np.full(900, math.log(1.8)), np.full(100, math.log(0.2))])
    log_t, f = best_threshold(log_p, 500, cells, has_volume=True)
    assert log_t == pytest.approx(math.log(1.8))
    assert f == pytest.approx(2 * 0.9 * 500 / (cells * 900 / 1.8 / 1000 + 500))  # 2 TP / (claimed + S)


def test_of_a_set_that_is_given_in_part_its_size_counts():
    at_set, on_grid = np.array([2.0, -1.0]), np.array([3.0, -0.5])
    assert f_measure(at_set, on_grid, np.array([0.0]), 10) == pytest.approx([2 * 1 / (1 + 1 + 10)])


def test_f_is_twice_the_true_ones_over_what_is_claimed_and_what_is_there():
    at_members, on_grid = np.array([2.0, 1.0, -1.0]), np.array([3.0, 0.5, -0.5, -2.0])
    found = f_measure(at_members, on_grid, np.array([0.0, 0.8, 9.0]))
    assert found == pytest.approx([2 * 2 / (2 + 2 + 3), 2 * 2 / (2 + 1 + 3), 0.0])


def test_a_claim_at_the_threshold_is_0_8():
    assert 1 / (1 + math.exp(-CLAIM_LOGIT)) == pytest.approx(0.8)


def test_a_calibration_comes_back_from_a_record_that_holds_more():
    known = Calibration(precision=2.0, shown_logit=-0.5)
    assert Calibration.from_record({**known.to_record(), "f_measure": 0.3}) == known
    assert Calibration.from_record({}) == Calibration()
