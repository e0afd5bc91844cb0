"""Whether methods that are ordered by one rotation per image come in the same order when the whole set is scored.

Papers report the log-likelihood at R_gt, the rotation that an image was drawn at. Here the order by it is held
against their orders by what looks at all rotations that fit the image, by Kendall's tau.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.leaderboard.entries import Leaderboard, Result
from symsol_annot.bench.scoring.averages import INTERVAL, ratio, resampled
from symsol_annot.bench.scoring.metric import HIGHER
from symsol_annot.bench.scoring.reports.scores_file import per_image_table
from symsol_annot.bench.scoring.scorers.table import metric_of

LEAST_METHODS = 3  # of which there is an order to speak of
BY_ONE = ("density", "log_likelihood_at_gt")
BY_SET = (  # track and metric
    ("density", "log_likelihood"),
    ("density", "spread_rad"),
    ("classifier", "f_measure"),
    ("hypotheses", "f_measure_at_5_deg"),
)
_IMAGES = 3  # of an inversion

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Inversion:
    """Two methods whose order by one rotation is not that by the set.

    Attributes:
        first: the better one by one rotation.
        second: the better one by the set.
        images: indices of those in which the two orders are farthest apart, the farthest first.
    """

    first: str
    second: str
    images: tuple[int, ...]


@dataclass(frozen=True)
class Agreement:
    """How far two orders of methods agree about an object.

    Attributes:
        object: its name.
        track, metric: by which the whole set is scored.
        methods: how many are ordered.
        tau: Kendall's, from -1 to 1.
        low, high: its 95% interval over images.
        inversions: pairs whose order changes, and does in each direction by more than chance.
    """

    object: str
    track: str
    metric: str
    methods: int
    tau: float
    low: float
    high: float
    inversions: tuple[Inversion, ...]


def agreements(board: Leaderboard, folder: str) -> Iterator[Agreement]:
    """Yield the agreements of a set, object by object; none where fewer than three methods can be ordered."""
    for name in board.sets[folder].fingerprints:
        for track, metric in BY_SET:
            chosen = _methods(board.results[folder], name, {BY_ONE[0], track})
            if len(chosen) >= LEAST_METHODS:
                yield _agreement(chosen, name, track, metric)


def _methods(results: Sequence[Result], name: str, tracks: set[str]) -> list[Result]:
    """Return a result of each method that has all tracks about an object, of several seeds the first."""
    found: dict[str, Result] = {}
    for result in results:
        if tracks <= set(result.scores.get(name, {})):
            found.setdefault(result.account.method or result.name, result)
    return list(found.values())


def _agreement(chosen: Sequence[Result], name: str, track: str, metric: str) -> Agreement:
    by_one, by_set = ([_column(result, name, *which) for result in chosen] for which in (BY_ONE, (track, metric)))
    columns = [*by_one, *by_set]
    summands = np.stack([weights * np.where(weights > 0, values, 0.0) for values, weights in columns], axis=1)
    weights = np.stack([weights for _, weights in columns], axis=1)
    means, drawn = ratio(summands.sum(axis=0), weights.sum(axis=0))[None], resampled(summands, weights)
    count = len(chosen)
    low, high = np.percentile(_taus(drawn, count), INTERVAL)
    found = []
    for i, j in combinations(range(count), 2):
        ahead = drawn[:, [i, count + i]] - drawn[:, [j, count + j]]
        least, most = np.percentile(ahead, INTERVAL, axis=0)
        for first, second, one, whole in ((i, j, least[0], -most[1]), (j, i, -most[0], least[1])):
            if one > 0 and whole > 0:
                images = _farthest(by_one, by_set, first, second)
                found.append(Inversion(chosen[first].account.title, chosen[second].account.title, images))
    tau = float(_taus(means, count)[0])
    return Agreement(name, track, metric, count, tau, float(low), float(high), tuple(found))


def _column(result: Result, name: str, track: str, metric: str) -> tuple[Floats, Floats]:
    """Return the values (N,) of a metric, so that higher is better, and their weights (N,)."""
    table = per_image_table(dict(result.scores[name]), track)
    sign = 1.0 if metric_of(track, metric).better == HIGHER else -1.0
    return sign * table.values[metric], table.weights[metric]


def _taus(values: Floats, count: int) -> Floats:
    """Return Kendall's tau (d,) between the first `count` columns of values (d, 2 count) and the others."""
    i, j = np.triu_indices(count, 1)
    one, whole = values[:, :count], values[:, count:]
    signs = np.sign(one[:, i] - one[:, j]) * np.sign(whole[:, i] - whole[:, j])
    return np.asarray(signs.mean(axis=1), dtype=np.float64)


def _farthest(
    by_one: Sequence[tuple[Floats, Floats]], by_set: Sequence[tuple[Floats, Floats]], first: int, second: int
) -> tuple[int, ...]:
    """Return the images that speak most for the first method by one rotation and for the second by the set."""
    for_first = by_one[first][0] - by_one[second][0]
    for_second = by_set[second][0] - by_set[first][0]
    both = np.minimum(_in_deviations(for_first), _in_deviations(for_second))
    return tuple(np.argsort(-both, kind="stable")[:_IMAGES].tolist())


def _in_deviations(values: Floats) -> Floats:
    """Return values over their root mean square, the undefined ones as 0."""
    known = np.nan_to_num(values)
    scale = float(np.sqrt(np.mean(known**2)))
    return known / scale if scale else known
