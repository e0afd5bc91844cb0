"""How much of a set there is: members are counted, and a volume is counted by the grid's rotations inside it.

A grid rotation stands for the same share of SO(3) as any other, so that to count those inside is to weigh by Haar
measure, in the unit in which a classifier's negatives are counted. Of a set without volume nothing changes.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.rotations.grid import equivolumetric_grid, grid_index, grid_size
from symsol_annot.rotations.so3 import Angles
from symsol_annot.sets.shard.labels import Labels

Indices = npt.NDArray[np.int64]
_KEPT = 16  # volumes


@dataclass(frozen=True, eq=False)
class Counted:
    """What the sets of N images consist of, on a grid.

    Attributes:
        grid_size: |G|, how many rotations the grid has.
        is_counted: (N, G) bool, which candidates are members that count: all of them but, in a set with a volume, those
            whose nearest grid rotation is inside it and counts already.
        inside_count: (N,) how many rotations of the grid are inside the volume.
    """

    grid_size: int
    is_counted: npt.NDArray[np.bool_]
    inside_count: Indices

    @property
    def set_sizes(self) -> Indices:
        """(N,) |S|."""
        sizes: Indices = self.is_counted.sum(axis=1) + self.inside_count
        return sizes

    @property
    def negatives(self) -> Indices:
        """(N,) how many rotations of the grid are outside the volume, the negatives of eq. 7.6."""
        return self.grid_size - self.inside_count


def counted(labels: Labels, level: int) -> Counted:
    """Return what sets consist of on the grid of a level."""
    is_counted, inside_count = labels.symmetry_mask, np.zeros(len(labels), dtype=np.int64)
    for number, volume in enumerate(labels.volumes):
        inside, rows = grid_inside(volume, level), np.flatnonzero(labels.volume == number)
        inside_count[rows] = len(inside)
        row, g = np.nonzero(labels.symmetry_mask[rows])
        nearest = grid_index(level).nearest(labels.rotation[rows[row]] @ labels.symmetry_group[g])
        is_counted = is_counted.copy()
        is_counted[rows[row], g] = ~np.isin(nearest, inside)
    return Counted(grid_size(level), is_counted, inside_count)


@lru_cache(maxsize=_KEPT)
def grid_inside(volume: Volume, level: int) -> Indices:
    """Return the ascending indices (k,) of the rotations of a grid that are inside a volume."""
    return np.flatnonzero(volume.contains(equivolumetric_grid(level))).astype(np.int64)


@lru_cache(maxsize=_KEPT)
def grid_distances(volume: Volume, level: int) -> Angles:
    """Return the angles (72 x 8^level,) in rad from the rotations of a grid to a volume."""
    grid = equivolumetric_grid(level)
    if not volume.is_of_directions:
        return volume.distance(grid)
    directions = 12 * 4**level
    heights = np.round(grid[:directions, 2, 2], 9)
    first = np.flatnonzero(np.diff(heights, prepend=2.0))  # of each ring, along which directions differ by the azimuth
    alike = grid.reshape(-1, directions, 3, 3)[:, first]
    by_ring = volume.distance(alike.reshape(-1, 3, 3)).reshape(len(alike), -1)
    return np.repeat(by_ring, np.diff(first, append=directions), axis=1).reshape(-1)
