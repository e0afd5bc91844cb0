"""What the nearest views say of an image: a kernel density on SO(3), and from it claims and hypotheses.

    p(R) = u + (1 - u) sum_j w_j exp(k (cos a(R, R_j) - 1)) / (e^-k (I0(k) - I1(k))),    k = 1 / h^2

relative to the uniform density, with a the angle: the isotropic matrix Fisher distribution at each view's R_j.
Weights fall with the distance d_j of the embeddings, w_j ~ exp(-d_j^2 / 2 s^2), s = f m^(1 - c) d_30^c, where d_30 is
the distance of the image's 30th view, and m the median of those.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.special import ive

from symsol_annot.rotations.grid import grid_index, grid_size
from symsol_annot.rotations.so3 import Rotations, angle_between, rotation_to_quat_wxyz

HYPOTHESES = 30
APART_RAD = float(np.radians(3.0))  # of hypotheses
_REFERENCE = 29  # whose distance stands for how far off the views of an image are
_LEAST_WEIGHT = 1e-6  # of a view's share that counts
_REACH = 4.25  # bandwidths beyond which a kernel is 0; 0.04% of it is there

Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Bandwidths:
    """What is fitted on train images, each left out of the views.

    Attributes:
        angle_rad: h, of the kernel.
        uniform: u, the share of the uniform density.
        factor: f, of the width in the embedding.
        own_share: c: 0, one width for all images; 1, each image's in proportion to the distance of its 30th view.
        median_distance: m.
    """

    angle_rad: float
    uniform: float
    factor: float
    own_share: float
    median_distance: float


@dataclass(frozen=True)
class ClaimRule:
    """Which density is claimed: ln p > offset + slope ln(peak), with the peak the largest p at a view's rotation."""

    offset: float
    slope: float


def reference_distance(distance: Floats) -> Floats:
    """Return the distance (n,) of the 30th of views (n, k), or of the last of fewer."""
    return np.maximum(distance[:, min(_REFERENCE, distance.shape[1] - 1)], 1e-6)


def weights_of(distance: Floats, bandwidths: Bandwidths) -> Floats:
    """Return the weights (n, k) of views at distances (n, k) of the embeddings; those of an image add up to 1."""
    own = bandwidths.own_share
    width = bandwidths.factor * bandwidths.median_distance ** (1.0 - own) * reference_distance(distance) ** own
    log_weight = (distance[:, :1] ** 2 - distance**2) / (2.0 * width[:, None] ** 2)
    weights: Floats = np.exp(log_weight)
    return weights / weights.sum(axis=1, keepdims=True)


def kernel(cos_minus_1: Floats, bandwidth_rad: float) -> Floats:
    """Return the kernel's density, relative to the uniform one, at angles (...) given by their cosine less 1."""
    k = 1.0 / bandwidth_rad**2
    return np.exp(k * cos_minus_1) / (ive(0, k) - ive(1, k))


class Cells:
    """The equivolumetric grid of a level, and its quaternions."""

    def __init__(self, level: int) -> None:
        self.index = grid_index(level)
        self.quat_wxyz = rotation_to_quat_wxyz(self.index.rotations)
        side = (8.0 * np.pi**2 / grid_size(level)) ** (1.0 / 3.0)  # of a cube of a cell's volume, in rad
        self.blur_rad = side / np.sqrt(12.0)  # the deviation of a uniform distribution on it, along a side

    def __len__(self) -> int:
        return len(self.index)


class ViewDensity:
    """The density of one image."""

    def __init__(self, rotation: Rotations, weights: Floats, bandwidths: Bandwidths) -> None:
        """Take the rotations (k, 3, 3) of its nearest views and their weights (k,)."""
        counts = weights > _LEAST_WEIGHT * weights.max()
        self._all_rotations, self._bandwidths = rotation, bandwidths
        self._rotation, self._weights = rotation[counts], weights[counts]
        self._quat_wxyz = rotation_to_quat_wxyz(self._rotation)

    def log_density(self, R: Rotations) -> Floats:
        """Return ln p (n,) at rotations (n, 3, 3)."""
        return self._log_density(rotation_to_quat_wxyz(R), self._bandwidths.angle_rad)

    def near(self, cells: Cells) -> tuple[npt.NDArray[np.int64], Floats]:
        """Return the indices (m,) of the grid rotations within reach of a view's, and ln p (m,) there.

        At all others p is the uniform share.
        """
        return self._near(cells, self._bandwidths.angle_rad)

    def on_cells(self, cells: Cells) -> Floats:
        """Return ln p (N,) of the grid's cells: of the density convolved with a cell's extent."""
        log_p = np.full(len(cells), np.log(self._bandwidths.uniform))
        near, values = self._near(cells, float(np.hypot(self._bandwidths.angle_rad, cells.blur_rad)))
        log_p[near] = values
        return log_p

    def log_threshold(self, rule: ClaimRule) -> float:
        """Return the ln p above which a rotation is claimed."""
        return rule.offset + rule.slope * self.log_peak

    @cached_property
    def log_peak(self) -> float:
        """The largest ln p at a view's rotation."""
        return float(self._log_density(self._quat_wxyz, self._bandwidths.angle_rad).max())

    def hypotheses(self) -> Rotations:
        """Return the rotations (up to 30, 3, 3) of the nearest views that are 3 degrees from nearer ones."""
        taken: list[int] = []
        for j, R in enumerate(self._all_rotations):
            if len(taken) == HYPOTHESES:
                break
            if (angle_between(self._all_rotations[taken], R) > APART_RAD).all():
                taken.append(j)
        return self._all_rotations[taken]

    def _near(self, cells: Cells, bandwidth_rad: float) -> tuple[npt.NDArray[np.int64], Floats]:
        near = cells.index.within(self._rotation, min(_REACH * bandwidth_rad, np.pi))
        return near, self._log_density(cells.quat_wxyz[near], bandwidth_rad)

    def _log_density(self, quat_wxyz: Floats, bandwidth_rad: float) -> Floats:
        cos_minus_1 = 2.0 * (quat_wxyz @ self._quat_wxyz.T) ** 2 - 2.0
        u = self._bandwidths.uniform
        p: Floats = u + (1.0 - u) * (kernel(np.minimum(cos_minus_1, 0.0), bandwidth_rad) @ self._weights)
        return np.log(p)
