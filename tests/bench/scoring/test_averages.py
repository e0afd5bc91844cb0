"""Averages over images: the value, the bootstrap interval, and when there is none."""

import math
from dataclasses import astuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from symsol_annot.bench.scoring import averages
from symsol_annot.bench.scoring.averages import DRAWS, MIN_IMAGES, PerImage, difference, figures, merge

quick = settings(deadline=None, max_examples=15)
seeds = st.integers(0, 2**32 - 1)


def table_of(**columns):
    """Name to values, or to (values, weights)."""
    pairs = {name: c if isinstance(c, tuple) else (c, np.ones(len(c))) for name, c in columns.items()}
    values = {name: np.asarray(v, dtype=float) for name, (v, _) in pairs.items()}
    weights = {name: np.asarray(w, dtype=float) for name, (_, w) in pairs.items()}
    return PerImage(np.arange(len(next(iter(values.values())))), values, weights)


def everything(count):
    return {"all": np.ones(count, dtype=bool)}


def random_table(rng, count=25):
    undefined = rng.random(count) < 0.1
    return table_of(
        plain=rng.normal(size=count),
        pooled=(rng.random(count), rng.integers(1, 720, count)),
        patchy=(np.where(undefined, np.nan, rng.random(count)), (~undefined).astype(float)),
    )


def random_strata(rng, count=25):
    shown = rng.random(count) < 0.9
    return {**everything(count), "shown": shown, "hidden": ~shown}


# --- values ---


def test_known_answer_of_a_mean_and_a_pooled_mean():
    """Two sets of 1 and 3 members with errors 0 and 4: (0 + 4 + 4 + 4) / 4 pooled, 2 an image."""
    made = figures(table_of(pooled=([0.0, 4.0], [1, 3]), image_mean=[0.0, 4.0]), everything(2))["all"]
    assert (made["pooled"].value, made["image_mean"].value) == (3.0, 2.0)


def test_an_image_of_weight_0_is_undefined_and_left_out_whatever_its_value():
    for anything in (np.nan, np.inf, 5.0):
        made = figures(table_of(a=([1.0, anything, 3.0], [1, 0, 1])), everything(3))["all"]["a"]
        assert (made.value, made.images, made.undefined) == (2.0, 2, 1)


def test_a_figure_that_no_image_defines_is_nan_and_not_0():
    made = figures(table_of(a=([np.nan] * 25, [0] * 25), b=np.ones(25)), everything(25))["all"]
    np.testing.assert_equal(astuple(made["a"]), (math.nan, math.nan, math.nan, 0, 25))
    assert astuple(made["b"]) == (1.0, 1.0, 1.0, 25, 0)


def test_a_table_of_which_no_image_defines_anything_has_nan_figures():
    made = figures(table_of(a=([np.nan] * 25, [0] * 25)), everything(25))["all"]["a"]
    np.testing.assert_equal(astuple(made), (math.nan, math.nan, math.nan, 0, 25))


def test_an_empty_stratum_has_nan_of_0_images():
    strata = {**everything(30), "hidden": np.zeros(30, dtype=bool)}
    made = figures(table_of(a=np.arange(30.0)), strata)
    np.testing.assert_equal(astuple(made["hidden"]["a"]), (math.nan, math.nan, math.nan, 0, 0))
    assert made["all"]["a"].value == 14.5


def test_a_stratum_holds_its_own_images_only():
    strata = {"even": np.arange(40) % 2 == 0, "odd": np.arange(40) % 2 == 1}
    made = figures(table_of(a=np.arange(40) % 2, b=np.full(40, 7.0)), strata)
    assert astuple(made["even"]["a"]) == (0.0, 0.0, 0.0, 20, 0)
    assert astuple(made["odd"]["a"]) == (1.0, 1.0, 1.0, 20, 0)
    assert astuple(made["odd"]["b"]) == (7.0, 7.0, 7.0, 20, 0)


# --- intervals ---


def quantile(numbers, share):
    """Linear between the ordered numbers."""
    numbers = sorted(numbers)
    place = share * (len(numbers) - 1)
    below = math.floor(place)
    above = min(below + 1, len(numbers) - 1)
    return numbers[below] + (place - below) * (numbers[above] - numbers[below])


def plain_bootstrap(table, rows, metric):
    """Resample all images as often as the package does; the stratum's ratio is taken in each draw."""
    ratios = []
    for counts in np.concatenate(list(averages._draws(len(rows)))):
        total = weight = 0.0
        for i, times in enumerate(counts):
            w = table.weights[metric][i] * rows[i]
            if w > 0:
                total += times * w * table.values[metric][i]
                weight += times * w
        if weight > 0:
            ratios.append(total / weight)
    return quantile(ratios, 0.025), quantile(ratios, 0.975)


def test_the_interval_is_that_of_a_plain_loop_over_the_same_draws():
    rng = np.random.default_rng(0)
    table, strata = random_table(rng, 40), random_strata(rng, 40)
    assert np.count_nonzero(strata["shown"] & (table.weights["patchy"] > 0)) >= MIN_IMAGES
    made = figures(table, strata)
    for stratum in ("all", "shown"):
        for metric in table.values:
            figure = made[stratum][metric]
            expected = plain_bootstrap(table, strata[stratum], metric)
            np.testing.assert_allclose((figure.low, figure.high), expected, rtol=0, atol=1e-12)


def test_draws_are_2000_samples_with_replacement_that_depend_on_the_count_alone():
    first, again = (np.concatenate(list(averages._draws(30))) for _ in range(2))
    assert DRAWS == 2000
    assert first.shape == (DRAWS, 30)
    np.testing.assert_array_equal(first, again)
    assert (first.sum(axis=1) == 30).all()
    assert len(np.unique(first, axis=0)) == DRAWS
    assert first.var() == pytest.approx(29 / 30, rel=0.02)  # of a binomial of 30 draws with 1/30
    assert np.abs(first.mean(axis=0) - 1).max() < 0.1


def test_draws_stay_the_same_for_good_however_many_are_made_at_once(monkeypatch):
    drawn = np.concatenate(list(averages._draws(7)))
    assert drawn[:2].tolist() == [[1, 1, 1, 1, 2, 0, 1], [1, 0, 1, 1, 1, 1, 2]]  # else every interval changes
    for at_once in (300, 2000, 3000):
        monkeypatch.setattr(averages, "_DRAWS_AT_ONCE", at_once)
        np.testing.assert_array_equal(np.concatenate(list(averages._draws(7))), drawn)


def test_intervals_of_normal_samples_hold_the_mean_95_times_in_100_and_are_as_wide_as_theory_says():
    images, samples = 200, 400
    rng = np.random.default_rng(1)
    columns = {f"sample {k}": rng.normal(loc=3.0, size=images) for k in range(samples)}
    made = figures(table_of(**columns), everything(images))["all"].values()
    hits = sum(figure.low <= 3.0 <= figure.high for figure in made)
    assert 0.91 * samples <= hits <= 0.98 * samples
    widths = [figure.high - figure.low for figure in made]
    assert np.mean(widths) == pytest.approx(2 * 1.96 / images**0.5, rel=0.03)
    assert all(figure.low < figure.value < figure.high for figure in made)


def test_there_is_no_interval_under_20_images_that_define_the_figure():
    assert MIN_IMAGES == 20
    for defined, has_interval in ((19, False), (20, True)):
        weights = np.arange(30) < defined
        figure = figures(table_of(a=(np.arange(30.0), weights)), everything(30))["all"]["a"]
        assert (figure.images, figure.undefined) == (defined, 30 - defined)
        assert np.isfinite(figure.value)
        assert np.isfinite([figure.low, figure.high]).tolist() == [has_interval] * 2


def test_the_number_of_images_of_the_stratum_counts_not_that_of_the_split():
    strata = {**everything(100), "few": np.arange(100) < 19}
    made = figures(table_of(a=np.arange(100.0)), strata)
    assert np.isfinite(made["all"]["a"].low)
    assert np.isnan([made["few"]["a"].low, made["few"]["a"].high]).all()


# --- differences ---


@quick
@given(seeds)
def test_a_table_differs_from_itself_by_exactly_0(seed):
    rng = np.random.default_rng(seed)
    table, strata = random_table(rng), random_strata(rng)
    for made in difference(table, table, strata).values():
        for figure in made.values():
            assert figure.value == 0.0 or figure.images == 0
            assert {figure.low, figure.high} == {0.0} or figure.images < MIN_IMAGES


def test_both_sides_of_a_difference_are_drawn_alike():
    """Whatever the images' spread, a method that is better by 0.1 on each is better by 0.1 in every draw."""
    a = np.random.default_rng(2).normal(scale=100.0, size=50)
    made = difference(table_of(a=a), table_of(a=a + 0.1), everything(50))["all"]["a"]
    np.testing.assert_allclose((made.value, made.low, made.high), 0.1, rtol=0, atol=1e-11)


def test_a_difference_is_the_second_less_the_first_with_the_interval_of_a_plain_loop():
    rng = np.random.default_rng(3)
    weights = rng.integers(1, 100, 30)
    a, b = table_of(m=(rng.random(30), weights)), table_of(m=(rng.random(30), weights))
    made = difference(a, b, everything(30))["all"]["m"]
    expected = np.average(b.values["m"], weights=weights) - np.average(a.values["m"], weights=weights)
    assert made.value == pytest.approx(expected, abs=1e-12)
    drawn = [
        np.average(b.values["m"], weights=counts * weights) - np.average(a.values["m"], weights=counts * weights)
        for counts in np.concatenate(list(averages._draws(30)))
    ]
    np.testing.assert_allclose((made.low, made.high), (quantile(drawn, 0.025), quantile(drawn, 0.975)), atol=1e-12)


def test_a_difference_counts_the_images_that_both_sides_define():
    a = table_of(m=(np.ones(30), np.arange(30) != 0))
    b = table_of(m=(np.ones(30), np.arange(30) != 1))
    made = difference(a, b, everything(30))["all"]["m"]
    assert (made.images, made.undefined) == (28, 2)


# --- tables ---


@quick
@given(seeds)
def test_parts_of_a_set_merge_to_the_whole_in_any_order(seed):
    rng = np.random.default_rng(seed)
    table, strata = random_table(rng), random_strata(rng)
    parts = [
        PerImage(
            table.image_index[rows],
            {name: column[rows] for name, column in table.values.items()},
            {name: column[rows] for name, column in table.weights.items()},
        )
        for rows in np.array_split(rng.permutation(25), rng.integers(1, 6))
    ]
    merged = merge(parts)
    np.testing.assert_array_equal(merged.image_index, table.image_index)
    for name in table.values:
        np.testing.assert_array_equal(merged.values[name], table.values[name])
        np.testing.assert_array_equal(merged.weights[name], table.weights[name])
    whole, joined = figures(table, strata), figures(merged, strata)
    for stratum, made in whole.items():
        for metric, figure in made.items():
            np.testing.assert_equal(astuple(joined[stratum][metric]), astuple(figure))


def test_no_parts_merge_to_a_table_of_no_images():
    merged = merge([])
    assert (len(merged.image_index), merged.values, merged.weights) == (0, {}, {})


def test_a_selection_keeps_the_metrics_that_are_named_in_that_order():
    table = random_table(np.random.default_rng(4))
    chosen = table.select(["patchy", "plain"])
    assert list(chosen.values) == list(chosen.weights) == ["patchy", "plain"]
    np.testing.assert_array_equal(chosen.values["plain"], table.values["plain"])


def test_kept_draws_are_those_of_a_count_that_is_too_large_to_keep(monkeypatch):
    summands, weights = np.random.default_rng(0).uniform(size=(2, 50, 3))
    kept = averages.resampled(summands, weights)
    monkeypatch.setattr(averages, "_KEPT_COUNTS", 0)
    assert np.array_equal(averages.resampled(summands, weights), kept)


def test_another_number_of_images_has_draws_of_its_own():
    for images in (30, 31, 30):
        drawn = averages.resampled(np.ones((images, 1)), np.ones((images, 1)))
        assert np.array_equal(drawn, np.ones((averages.DRAWS, 1)))
        counts = np.concatenate([np.asarray(part) for part in averages._draws(images)])
        assert counts.shape == (averages.DRAWS, images)
        assert (counts.sum(axis=1) == images).all()
