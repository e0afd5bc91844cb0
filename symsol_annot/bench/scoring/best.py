"""Which of several methods may be the best: a confidence set, so that many rows do not make one a winner by chance."""

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.scoring.averages import MIN_IMAGES, Values, ratio, resampled
from symsol_annot.bench.scoring.metric import HIGHER

CONFIDENCE = 95  # percent
_SAME = 1e-12  # a difference whose standard error is smaller does not vary from draw to draw


def may_be_best(columns: Sequence[tuple[Values, Values]], better: str) -> npt.NDArray[np.bool_] | None:
    """Tell which methods are in a set that holds the truly best one with 95% confidence (Hsu, 1984).

    A method is left out where another one is better by more than chance explains. Of each other method, the paired
    difference is divided by its standard error over the bootstrap's draws of images. The largest of these is held
    against the 95th percentile of what the largest would be, draw by draw, if all differences were 0. So the bound
    grows with the number of methods, and takes into account that they are scored on the same images.

    Args:
        columns: of each of k methods the values (N,) of the same N images, and their weights (N,), 0 where undefined.
        better: "higher" or "lower" values.

    Returns:
        (k,); None where fewer than 20 images say anything of each.
    """
    weights = np.stack([weight for _, weight in columns], axis=1)
    if (np.count_nonzero(weights > 0, axis=0) < MIN_IMAGES).any():
        return None
    values = np.stack([value for value, _ in columns], axis=1)
    summands = weights * np.where(weights > 0, values, 0.0)
    sign = 1.0 if better == HIGHER else -1.0
    means = sign * ratio(summands.sum(axis=0), weights.sum(axis=0))
    drawn = sign * resampled(summands, weights)
    return np.array([not _is_beaten(method, means, drawn) for method in range(len(columns))])


def _is_beaten(method: int, means: Values, drawn: Values) -> bool:
    """Tell whether a method is worse than another by more than chance, given means (k,) and their draws (d, k)."""
    ahead = means - means[method]
    drawn_ahead = drawn - drawn[:, [method]]
    errors = np.nanstd(drawn_ahead, axis=0)
    varies = errors > _SAME
    if (ahead[~varies] > _SAME).any():
        return True
    if not varies.any():
        return False
    by_chance = (drawn_ahead[:, varies] - ahead[varies]) / errors[varies]
    bound = np.nanpercentile(by_chance.max(axis=1), CONFIDENCE)
    return bool((ahead[varies] / errors[varies]).max() > bound)
