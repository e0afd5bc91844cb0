"""The metrics, one pure function per equation, about single images. docs/metrics.md defines them without a gap.

Counts may be those of one image, or of several along leading axes that broadcast against each other.

Averages over images, and their intervals, are `averages.py`.
"""

import math

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.nearest import nearest_angles_both_ways
from symsol_annot.rotations.so3 import Angles, Rotations

Counts = npt.NDArray[np.int64]
Ratios = npt.NDArray[np.float64]

_AS_PROBABLE = 1e-5  # cells that differ by less are as probable as one another: files have logarithms in 32 bits

# Hypotheses (section 5.2)


def recall_and_precision_errors(symmetry_set: Rotations, hypotheses: Rotations) -> tuple[Angles, Angles]:
    """Return how far each member is from the nearest hypothesis (eq. 5.5), and each hypothesis from the set (eq. 5.8).

    Args:
        symmetry_set: (..., k, 3, 3) R_m2c, of one image or of several with as many members each.
        hypotheses: (..., M, 3, 3) R_m2c.

    Returns:
        (..., k) and (..., M) angles in rad.
    """
    return nearest_angles_both_ways(symmetry_set, hypotheses)


def mean_error(errors_rad: Angles, weights: npt.NDArray[np.float64] | None = None) -> float:
    """Return the mean of angular errors, an image's share of eq. 5.7, or of eq. 5.9 with hypothesis weights."""
    if weights is None:
        return float(errors_rad.mean())
    relative = weights / weights.max()
    return float((relative * errors_rad).sum() / relative.sum())


def share_within(
    errors_rad: Angles, thresholds_rad: npt.NDArray[np.float64], weights: npt.NDArray[np.float64] | None = None
) -> Ratios:
    """Return which share of the errors is at most each threshold: coverage of members, accuracy of hypotheses."""
    if weights is None:
        return np.searchsorted(np.sort(errors_rad), thresholds_rad, side="right") / len(errors_rad)
    relative = weights / weights.max()
    return np.where(errors_rad <= thresholds_rad[:, None], relative, 0.0).sum(axis=1) / relative.sum()


def harmonic_mean(coverage: Ratios, accuracy: Ratios) -> Ratios:
    """Return the F-measure of hypotheses: the harmonic mean of coverage and accuracy, 0 where both are 0."""
    total = coverage + accuracy
    return np.divide(2.0 * coverage * accuracy, total, out=np.zeros_like(total), where=total > 0)


# Classifiers (section 7.2)


def recall(true_positives: Counts, set_size: Counts | int) -> Ratios:
    """Return TP / |S| (eq. 7.5), in [0, 1]."""
    return true_positives / set_size


def precision(true_positives: Counts, false_positives: Counts) -> Ratios:
    """Return TP / (TP + FP) (eq. 7.6), 1 where nothing is predicted positive."""
    predicted = true_positives + false_positives
    return np.divide(true_positives, predicted, out=np.ones(predicted.shape), where=predicted > 0)


def f_measure(true_positives: Counts, false_positives: Counts, set_size: Counts | int) -> Ratios:
    """Return 2 TP / (2 TP + FP + FN), which is eq. 7.8 wherever that is defined, and 0 where TP is 0."""
    return 2.0 * true_positives / (true_positives + false_positives + set_size)


def classifier_accuracy(
    true_positives: Counts, false_positives: Counts, set_size: Counts | int, negatives: Counts | int
) -> Ratios:
    """Return (TP + TN) / (|S| + |G|) (eq. 7.7), of |G| what is outside the set's volume."""
    return (true_positives + negatives - false_positives) / (set_size + negatives)


def share_of(count: Counts, of: Counts) -> Ratios:
    """Return count / of, NaN where that is 0 / 0."""
    return np.divide(count, of, out=np.full(count.shape, np.nan), where=of > 0)


# Densities (the literature of SYMSOL)


def log_likelihood(log_probability: npt.NDArray[np.float64], grid_size: int) -> float:
    """Return the mean of ln(p N / pi^2) over rotations whose cells have the log-probabilities ln p (k,).

    N / pi^2 is one over a cell's volume, with the volume of SO(3) pi^2: the uniform density has ln(1 / pi^2) = -2.2895.
    """
    return float(log_probability.mean() + math.log(grid_size / math.pi**2))


def share_in_regions(of_members: Ratios, listed: Ratios, size: int, masses: Ratios) -> Ratios:
    """Return how much of a set the smallest regions of a density hold (m,): its mean over members.

    The smallest region of a mass q takes cells in descending order of their probability until they hold q. Of cells
    that are as probable as one another it takes any, so that each counts with the chance that it is taken. A density
    that is right holds q of the set; a uniform one does for every set.

    Args:
        of_members: (k,) the probability of each member's cell, -1 for one that is not listed.
        listed: (n,) probabilities of the cells that are listed; the others share evenly what is left of 1.
        size: how many cells there are.
        masses: (m,) q, from 0 to 1.
    """
    others = size - len(listed)
    left = max(0.0, 1.0 - float(listed.sum())) if others else 0.0
    of_other = left / others if others else 0.0
    p = np.where(of_members < 0.0, of_other, of_members)
    least, most = p * (1.0 - _AS_PROBABLE), p * (1.0 + _AS_PROBABLE)
    ascending = np.sort(listed[listed >= least.min()])  # no other cell is in a region with a member
    below = np.concatenate([[0.0], np.cumsum(ascending)])
    first, last = np.searchsorted(ascending, least, side="left"), np.searchsorted(ascending, most, side="right")
    denser = below[-1] - below[last] + np.where(of_other > most, left, 0.0)
    alike = below[last] - below[first] + np.where((of_other >= least) & (of_other <= most), left, 0.0)
    chance = (masses[:, None] - denser) / np.maximum(alike, np.finfo(float).tiny)
    shares: Ratios = np.clip(chance, 0.0, 1.0).mean(axis=1)
    return shares


def spread(listed_probability: npt.NDArray[np.float64], listed_angles_rad: Angles, all_angles_rad: Angles) -> float:
    """Return the expected angle in rad to the nearest member: the sum over the grid of p x angle.

    Args:
        listed_probability: (L,) of the cells that are listed; the others share what is left of 1 evenly.
        listed_angles_rad: (L,) from the listed cells to the symmetry set.
        all_angles_rad: (N,) from all cells to it.
    """
    unlisted = len(all_angles_rad) - len(listed_probability)
    expected = float(listed_probability @ listed_angles_rad)
    if unlisted:
        left = 1.0 - float(listed_probability.sum())
        expected += left * float(all_angles_rad.sum() - listed_angles_rad.sum()) / unlisted
    return expected
