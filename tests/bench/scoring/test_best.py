"""Which methods may be the best: the true one is among them as often as promised, however many there are."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot.bench.scoring.averages import DRAWS, MIN_IMAGES, resampled
from symsol_annot.bench.scoring.best import may_be_best

quick = settings(deadline=None, max_examples=15)
seeds = st.integers(0, 2**32 - 1)
IMAGES = 60


def asked(values, better="higher", weights=None):
    """values (N, k): a method per column."""
    weights = np.ones_like(values) if weights is None else weights
    return may_be_best([(values[:, i], weights[:, i]) for i in range(values.shape[1])], better)


def correlated(rng, methods, images=IMAGES):
    """Methods that find the same images hard."""
    return rng.normal(size=(images, 1)) + 0.5 * rng.normal(size=(images, methods))


@quick
@given(seeds, st.integers(2, 6))
def test_the_best_on_these_images_is_always_among_them(seed, methods):
    values = correlated(np.random.default_rng(seed), methods)
    assert asked(values)[values.mean(axis=0).argmax()]
    assert asked(values, "lower")[values.mean(axis=0).argmin()]


def test_of_many_equal_methods_a_given_one_is_left_out_in_at_most_one_case_of_twenty():
    rng = np.random.default_rng(0)
    left_out = sum(not asked(correlated(rng, 12))[0] for _ in range(150))
    assert left_out <= 15  # 7.5 expected; more than 15 by chance in 3 of 1,000 runs


def test_pairs_without_a_correction_would_leave_it_out_far_more_often():
    rng, left_out = np.random.default_rng(0), 0
    for _ in range(150):
        values = correlated(rng, 12)
        drawn = resampled(values, np.ones_like(values))
        ahead = drawn[:, 1:] - drawn[:, :1]
        left_out += bool((np.percentile(ahead, 5, axis=0) > 0).any())
    assert left_out > 30


@quick
@given(seeds)
def test_a_method_that_is_worse_on_every_image_by_the_same_is_never_among_them(seed):
    values = correlated(np.random.default_rng(seed), 3)
    behind = values[:, [values.mean(axis=0).argmax()]] - 0.01
    np.testing.assert_array_equal(asked(np.hstack([values, behind])), [*asked(values), False])


@quick
@given(seeds)
def test_copies_of_a_method_stand_and_fall_together(seed):
    values = correlated(np.random.default_rng(seed), 4)
    found = asked(values[:, [0, 1, 2, 3, 1]])
    assert found[1] == found[4]


def test_a_clear_winner_is_alone_and_a_naive_twin_agrees():
    rng = np.random.default_rng(1)
    values = correlated(rng, 5)
    values += np.array([0.0, 0.05, 0.3, 0.25, 1.0]) - values.mean(axis=0)
    assert asked(values).tolist() == [False, False, False, False, True]
    values[:, 4] -= 0.7
    weights = np.ones((IMAGES, 1))
    draws = np.stack([resampled(values[:, [i]], weights)[:, 0] for i in range(5)])
    means = values.mean(axis=0)
    naive = []
    for i in range(5):
        others = [j for j in range(5) if j != i]
        spread = {j: np.std([draws[j][b] - draws[i][b] for b in range(DRAWS)]) for j in others}
        chance = [
            max((draws[j][b] - draws[i][b] - means[j] + means[i]) / spread[j] for j in others) for b in range(DRAWS)
        ]
        naive.append(max((means[j] - means[i]) / spread[j] for j in others) <= np.percentile(chance, 95))
    assert asked(values).tolist() == naive
    assert 1 < sum(naive) < 5


def test_an_image_of_weight_0_counts_nowhere():
    values = correlated(np.random.default_rng(2), 3)
    weights = np.ones_like(values)
    weights[:5, 1] = 0.0
    other = np.where(weights > 0, values, np.nan)
    np.testing.assert_array_equal(asked(values, weights=weights), asked(other, weights=weights))


@pytest.mark.parametrize(("images", "said"), [(MIN_IMAGES - 1, False), (MIN_IMAGES, True)])
def test_few_images_say_nothing(images, said):
    assert (asked(correlated(np.random.default_rng(3), 3, images)) is not None) == said
