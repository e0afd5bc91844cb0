"""Fitting the bandwidths and the rule of claims, on train images that are left out of the views one at a time."""

from dataclasses import replace

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.models.methods.mixture.claims import f_measure
from symsol_annot.bench.models.retrieval.view_density import (
    Bandwidths,
    Cells,
    ClaimRule,
    Floats,
    ViewDensity,
    kernel,
    reference_distance,
    weights_of,
)
from symsol_annot.bench.models.retrieval.view_index import NearViews
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.shard.labels import Labels

_ANGLES_RAD = np.radians(0.5 * 1.2 ** np.arange(24))  # 0.5 to 33 degrees
_UNIFORM = (1e-4, 3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1, 0.3)
_FACTORS = 0.15 * 1.4 ** np.arange(11)  # 0.15 to 4.3
_OWN_SHARES = (0.0, 0.5, 1.0)
_SLOPES = (0.0, 0.25, 0.5, 0.75, 1.0)
_OFFSETS = np.arange(-8.0, 13.0, 0.25)


def fit_bandwidths(views: NearViews, R_gt: Rotations) -> tuple[Bandwidths, float]:
    """Return the bandwidths of the highest mean ln p at the rotations R_gt (n, 3, 3), and that mean.

    No symmetry set is looked at.
    """
    median = float(np.median(reference_distance(views.distance)))
    first = Bandwidths(1.0, 1.0, 1.0, 0.0, median)
    choices = [replace(first, factor=float(f), own_share=c) for f in _FACTORS for c in _OWN_SHARES]
    weights = [weights_of(views.distance, choice) for choice in choices]
    cos_minus_1 = np.minimum((np.einsum("nkij,nij->nk", views.rotation, R_gt) - 3.0) / 2.0, 0.0)
    best, highest = first, -np.inf
    for angle_rad in _ANGLES_RAD:
        at_R_gt = kernel(cos_minus_1, float(angle_rad))
        for choice, of_views in zip(choices, weights, strict=True):
            p = (of_views * at_R_gt).sum(axis=1)
            for u in _UNIFORM:
                mean = float(np.log(u + (1.0 - u) * p).mean())
                if mean > highest:
                    best, highest = replace(choice, angle_rad=float(angle_rad), uniform=u), mean
    return best, highest


def fit_claims(
    views: NearViews, bandwidths: Bandwidths, labels: Labels, rows: npt.NDArray[np.int64], cells: Cells
) -> tuple[ClaimRule, float]:
    """Return the rule of claims with the highest mean F-measure, and that mean.

    Args:
        views: near to n images, each left out of its own.
        bandwidths: of their densities.
        labels: of the split that the images are in.
        rows: (n,) which of them they are.
        cells: of the grid that claims are made on.
    """
    slopes, offsets = (part.ravel() for part in np.meshgrid(_SLOPES, _OFFSETS, indexing="ij"))
    weights, total = weights_of(views.distance, bandwidths), np.zeros(len(slopes))
    for i, row in enumerate(rows.tolist()):
        density = ViewDensity(views.rotation[i], weights[i], bandwidths)
        log_t: Floats = np.maximum(offsets + slopes * density.log_peak, np.log(2.0 * bandwidths.uniform))
        _, on_grid = density.near(cells)
        total += f_measure(density.log_density(labels.members(row)), on_grid, log_t)
    best = int(total.argmax())
    return ClaimRule(float(offsets[best]), float(slopes[best])), float(total[best] / len(rows))
