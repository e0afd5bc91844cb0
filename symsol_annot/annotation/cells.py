"""Unions of cells of the equivolumetric grid: which rotations are inside, and how far others are from them.

A cell of `grid.cell_of` is a pixel of directions times an interval of tilt. Near a pole it is long, since azimuth and
tilt turn about nearly one axis there: a pixel at the pole is 90 degrees of azimuth wide. Here the interval of tilt
follows the frame that is carried along from the pixel's centre, so that every cell is compact; its volume is the same.
"""

from functools import cached_property, partial

import healpix
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from symsol_annot.rotations.grid import cell_of, uniform_in_cells
from symsol_annot.rotations.so3 import Angles, Rotations, rotation_to_quat_wxyz, rotations_about

_AROUND = 13  # a pixel, its 8 neighbours, and the 4 beyond its sides
_POLAR_RINGS = 3  # in which every cell counts as at the edge: the neighbours beyond the pole have other tilts
_about_z, _about_y = partial(rotations_about, (0, 0, 1)), partial(rotations_about, (0, 1, 0))


class Cells:
    """A union of cells of one level."""

    def __init__(self, mask: npt.NDArray[np.bool_], level: int) -> None:
        """Make a union.

        Args:
            mask: (72 x 8^level,) which cells are in it.
            level: of the grid.
        """
        self._mask, self._level, self._n_side = mask, level, 2**level

    def contains(self, R: Rotations) -> npt.NDArray[np.bool_]:
        """Tell which rotations (n, 3, 3) are inside, (n,)."""
        return np.asarray(self._mask[cell_of(R @ _about_z(self._carried(R)), self._level)])

    def uniform(self, cells: npt.NDArray[np.int64], rng: np.random.Generator) -> Rotations:
        """Draw a rotation uniformly from each of the cells (n,): (n, 3, 3)."""
        R = uniform_in_cells(cells, self._level, rng)
        return R @ _about_z(-self._carried(R))

    def distance(self, R: Rotations) -> Angles:
        """Return the angles (n,) in rad from rotations (n, 3, 3) outside to the nearest centre of a cell's eighth."""
        chord = self._edge.query(rotation_to_quat_wxyz(R))[0]
        angles: Angles = 4.0 * np.arcsin(np.minimum(chord / 2.0, 1.0))
        return angles

    def _carried(self, R: Rotations) -> Angles:
        """Return the turns (n,) in rad about z by which the frame that is carried from a pixel's centre differs."""
        pixel = healpix.vec2pix(self._n_side, *np.moveaxis(R[..., 2], -1, 0))
        azimuth = np.arctan2(*(np.ascontiguousarray(R[..., row, 2]) for row in (1, 0)))  # as in volume._polar_and_tilt
        return _wrapped(azimuth - healpix.pix2ang(self._n_side, pixel)[1]) * R[..., 2, 2]

    @cached_property
    def _edge(self) -> cKDTree:
        """A tree of the unit quaternions, with both signs, of the eighths of the cells that are at the edge."""
        directions, tilts = 12 * self._n_side**2, 6 * self._n_side
        by_tilt = self._mask.reshape(tilts, directions)
        vectors = np.stack(healpix.pix2vec(self._n_side, np.arange(directions)), axis=1)
        around = cKDTree(vectors).query(vectors, k=_AROUND)[1]
        has_all = by_tilt[:, around].all(axis=2)
        interior = has_all & np.roll(has_all, 1, axis=0) & np.roll(has_all, -1, axis=0)
        polar_pixels = 2 * _POLAR_RINGS * (_POLAR_RINGS + 1)
        interior[:, :polar_pixels] = interior[:, -polar_pixels:] = False
        tilt, pixel = (np.repeat(index, 4) for index in np.nonzero(by_tilt & ~interior))
        quarter = 4 * healpix.ring2nest(self._n_side, pixel) + np.tile(np.arange(4), len(pixel) // 4)
        polar, azimuth = healpix.pix2ang(2 * self._n_side, quarter, nest=True)
        carried = _wrapped(azimuth - healpix.pix2ang(self._n_side, pixel)[1]) * np.cos(polar)
        to_direction = _about_z(azimuth) @ _about_y(polar)
        turned = [to_direction @ _about_z(2.0 * np.pi * (tilt + shift) / tilts - carried) for shift in (-0.25, 0.25)]
        quat_wxyz = rotation_to_quat_wxyz(np.concatenate(turned))
        return cKDTree(np.concatenate([quat_wxyz, -quat_wxyz]))


def _wrapped(angles: Angles) -> Angles:
    """Return angles in rad in [-pi, pi)."""
    return (angles + np.pi) % (2.0 * np.pi) - np.pi
