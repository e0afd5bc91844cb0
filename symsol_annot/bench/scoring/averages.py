"""From one figure per image to one figure per stratum: weighted means and their bootstrap intervals."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt

Values = npt.NDArray[np.float64]
Counts = npt.NDArray[np.unsignedinteger[Any]]

DRAWS = 2000
MIN_IMAGES = 20  # under which an interval would say nothing
INTERVAL = (2.5, 97.5)  # percentiles
_SEED = 20240723
_DRAWS_AT_ONCE = 125
_COUNTS_AT_ONCE = 2**23  # which bounds the memory that draws of many images take
_MANY = 2**16  # images: an image that is drawn each time fits 16 bits below it
_KEPT_COUNTS = 2**24  # of 2000 draws of 8,388 images: 32 MB, for the next table of as many


@dataclass(frozen=True, eq=False)
class PerImage:
    """Figures of N images.

    A stratum's figure is sum(weight x value) / sum(weight). A pooled metric weighs an image by its |S|, any other by
    1; a weight of 0 means that the figure is undefined for that image.

    Attributes:
        image_index: (N,) which images, ascending.
        values: name of the metric to (N,) values; NaN where undefined.
        weights: name of the metric to (N,) weights.
    """

    image_index: npt.NDArray[np.int64]
    values: Mapping[str, Values]
    weights: Mapping[str, Values]

    def select(self, names: Sequence[str]) -> "PerImage":
        """Return the figures of these metrics only, in this order."""
        return PerImage(self.image_index, {n: self.values[n] for n in names}, {n: self.weights[n] for n in names})


@dataclass(frozen=True)
class Figure:
    """A metric over a stratum.

    Attributes:
        value: the weighted mean; NaN where no image defines it.
        low, high: the 95% bootstrap interval; NaN where fewer than 20 images define the figure.
        images: over how many images.
        undefined: for how many images of the stratum the metric is not defined.
    """

    value: float
    low: float
    high: float
    images: int
    undefined: int


def merge(parts: Sequence[PerImage]) -> PerImage:
    """Join the figures of disjoint parts of a set, in the order of the images."""
    if not parts:
        return PerImage(np.zeros(0, dtype=np.int64), {}, {})
    image_index = np.concatenate([part.image_index for part in parts])
    order = np.argsort(image_index)
    names = list(parts[0].values)
    return PerImage(
        image_index[order],
        {name: np.concatenate([part.values[name] for part in parts])[order] for name in names},
        {name: np.concatenate([part.weights[name] for part in parts])[order] for name in names},
    )


def figures(
    table: PerImage, strata: Mapping[str, npt.NDArray[np.bool_]], *, intervals: bool = True
) -> dict[str, dict[str, Figure]]:
    """Return stratum to metric to figure.

    Args:
        table: of N images.
        strata: name to (N,) images.
        intervals: whether figures get them; without, `low` and `high` are NaN, and nothing is drawn.
    """
    summands, weights = _sums(table, strata)
    values = ratio(summands.sum(axis=0), weights.sum(axis=0))
    drawn = resampled(summands, weights) if intervals else np.full((1, len(values)), np.nan)
    return _tabulate(values, drawn, weights > 0, list(table.values), strata)


def difference(
    first: PerImage, second: PerImage, strata: Mapping[str, npt.NDArray[np.bool_]]
) -> dict[str, dict[str, Figure]]:
    """Return stratum to metric to the figure of second minus first, with the same draws on both sides.

    Args:
        first: of N images.
        second: of those images; it has the metrics of the first.
        strata: name to (N,) images.
    """
    a, a_weights = _sums(first, strata)
    b, b_weights = _sums(second.select(list(first.values)), strata)
    values = ratio(b.sum(axis=0), b_weights.sum(axis=0)) - ratio(a.sum(axis=0), a_weights.sum(axis=0))
    drawn = resampled(b, b_weights) - resampled(a, a_weights)
    return _tabulate(values, drawn, (a_weights > 0) & (b_weights > 0), list(first.values), strata)


def _tabulate(
    values: Values,
    drawn: Values,
    defined: npt.NDArray[np.bool_],
    names: Sequence[str],
    strata: Mapping[str, npt.NDArray[np.bool_]],
) -> dict[str, dict[str, Figure]]:
    """Return stratum to metric to figure from columns in that order: values (c,), draws (d, c), defined (N, c)."""
    low, high = _percentiles(drawn)
    images = np.count_nonzero(defined, axis=0)
    low[images < MIN_IMAGES] = high[images < MIN_IMAGES] = np.nan
    sizes = [int(np.count_nonzero(rows)) for rows in strata.values()]
    made = [
        Figure(float(values[c]), float(low[c]), float(high[c]), int(images[c]), sizes[c // len(names)] - int(images[c]))
        for c in range(len(values))
    ]
    return {
        stratum: dict(zip(names, made[i * len(names) : (i + 1) * len(names)], strict=True))
        for i, stratum in enumerate(strata)
    }


def _sums(table: PerImage, strata: Mapping[str, npt.NDArray[np.bool_]]) -> tuple[Values, Values]:
    """Return weight x value and weight, (N, strata x metrics) each."""
    values = np.stack(list(table.values.values()), axis=1)
    weights = np.stack([table.weights[name] for name in table.values], axis=1)
    inside = [rows[:, None] * weights for rows in strata.values()]
    finite = np.where(weights > 0, values, 0.0)
    return np.concatenate([w * finite for w in inside], axis=1), np.concatenate(inside, axis=1)


def resampled(summands: Values, weights: Values) -> Values:
    """Return the ratio of sums in each draw.

    Args:
        summands: (N, columns) weight x value of the images, 0 where undefined.
        weights: (N, columns).

    Returns:
        (DRAWS, columns); the draws are the same for all tables of N images.
    """
    both = np.concatenate([summands, weights], axis=1)
    sums = np.concatenate([counts.astype(np.float64) @ both for counts in _draws(len(both))])
    return ratio(sums[:, : summands.shape[1]], sums[:, summands.shape[1] :])


def _draws(images: int) -> Iterable[Counts]:
    """Return how often each image is drawn, some draws at a time: (draws, images). Depends on nothing but the count."""
    return _kept_draws(images) if DRAWS * images <= _KEPT_COUNTS else _new_draws(images)


@lru_cache(maxsize=1)
def _kept_draws(images: int) -> tuple[Counts, ...]:
    """Return all draws, and keep them: a leaderboard has many tables of one number of images."""
    return tuple(_new_draws(images))


def _new_draws(images: int) -> Iterator[Counts]:
    rng = np.random.Generator(np.random.PCG64(_SEED))
    at_once = max(1, min(_DRAWS_AT_ONCE, _COUNTS_AT_ONCE // images))
    for start in range(0, DRAWS, at_once):
        draws = min(at_once, DRAWS - start)
        drawn = rng.integers(images, size=(draws, images))
        drawn += images * np.arange(draws)[:, None]
        counts = np.bincount(drawn.reshape(-1), minlength=draws * images)
        yield counts.reshape(draws, images).astype(np.uint16 if images < _MANY else np.uint32)


def ratio(summands: Values, weights: Values) -> Values:
    """Return summands / weights, of one shape; NaN where nothing weighs."""
    return np.divide(summands, weights, out=np.full(summands.shape, np.nan), where=weights > 0)


def _percentiles(drawn: Values) -> tuple[Values, Values]:
    """Return the interval of each column over the draws that define it; NaN where none does."""
    defined = ~np.isnan(drawn).all(axis=0)
    low, high = np.full((2, drawn.shape[1]), np.nan)
    if defined.any():
        low[defined], high[defined] = np.nanpercentile(drawn[:, defined], INTERVAL, axis=0)
    return low, high
