"""The equivolumetric grid on SO(3): HEALPix directions times tilts (Yershova et al., 2010; section 7.2.2).

At level l, HEALPix with n_side 2^l gives 12 x 4^l directions (polar, azimuth) in ring order, each with 6 x 2^l
tilts; a rotation is Rz(azimuth) Ry(polar) Rz(tilt). Index = tilt x directions + direction. That is the order of
Implicit-PDF and of projects on e3nn (Image2Sphere), whose grids are the same rotations in other axes: see
`implicit_pdf_to_grid_frame`.
"""

from collections.abc import Iterator
from functools import lru_cache, partial
from typing import Any, TypeVar

import healpix
import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from symsol_annot.errors import RotationError, SettingsError
from symsol_annot.rotations.so3 import Angles, Rotations, rotation_to_quat_wxyz, rotations_about, rotations_sha256

MAX_LEVEL = 6
STANDARD_LEVEL = 4  # 294,912 rotations, 3.75 degrees from tilt to tilt

_ROUNDING_RAD = 1e-9
_FINEST_HEALPIX = 29  # its level whose pixels are 4e-9 rad wide

# Which of their axes is our x, y and z: Rx Rz Rx and Ry Rx Ry become Rz Ry Rz.
_FROM_IMPLICIT_PDF, _FROM_E3NN = (1, 2, 0), (2, 0, 1)
_TO_IMPLICIT_PDF, _TO_E3NN = (2, 0, 1), (1, 2, 0)

Real = TypeVar("Real", bound=np.floating[Any])


def grid_size(level: int) -> int:
    """Return how many rotations the grid of a level has: 72 x 8^level.

    Raises:
        SettingsError: there is no such level.
    """
    if level not in range(MAX_LEVEL + 1):
        raise SettingsError(f"the grid has levels 0 to {MAX_LEVEL}; there is no level {level!r}")
    return 72 * 8**level


def equivolumetric_grid(level: int = STANDARD_LEVEL) -> Rotations:
    """Return the (72 x 8^level, 3, 3) rotations of a level in the order of their indices.

    Raises:
        SettingsError: there is no such level.
    """
    return np.concatenate(list(_slices(level)))


def cell_of(R: Rotations, level: int = STANDARD_LEVEL) -> npt.NDArray[np.int64]:
    """Return the index (n,) of the grid's cell that each rotation (n, 3, 3) lies in.

    The cell of a grid rotation is HEALPix's pixel around its direction times the tilts up to half a step from its own.
    All cells of a level have the same volume, and together they are SO(3). Where cells are long, near the poles, a
    rotation can be nearer to the grid rotation of another cell.

    Raises:
        SettingsError: there is no such level.
    """
    grid_size(level)
    n_side = 2**level
    direction = healpix.vec2pix(n_side, *np.moveaxis(R[..., 2], -1, 0))
    y, x = np.ascontiguousarray(R[..., 2, 1]), -R[..., 2, 0]  # of strided ones arctan2 may differ in the last bit
    tilt = np.arctan2(y, x) * (6 * n_side) / (2.0 * np.pi)
    index: npt.NDArray[np.int64] = np.rint(tilt).astype(np.int64) % (6 * n_side) * (12 * n_side**2) + direction
    return index


def uniform_in_cells(cells: npt.NDArray[np.int64], level: int, rng: np.random.Generator) -> Rotations:
    """Draw a rotation uniformly from each of the cells (n,) of a level, which may repeat: (n, 3, 3).

    Raises:
        SettingsError: there is no such level.
    """
    grid_size(level)
    n_side, deeper = 2**level, _FINEST_HEALPIX - level
    tilt, direction = np.divmod(cells, 12 * n_side**2)
    finest = healpix.ring2nest(n_side, direction) * 4**deeper + rng.integers(4**deeper, size=len(cells))
    polar, azimuth = healpix.pix2ang(2**_FINEST_HEALPIX, finest, nest=True)
    tilt_rad = 2.0 * np.pi * (tilt + rng.random(len(cells)) - 0.5) / (6 * n_side)
    about_z, about_y = partial(rotations_about, (0, 0, 1)), partial(rotations_about, (0, 1, 0))
    return about_z(azimuth) @ about_y(polar) @ about_z(tilt_rad)


@lru_cache(maxsize=8)
def grid_sha256(level: int = STANDARD_LEVEL) -> str:
    """Return the SHA-256 of a level's rotations, as `so3.rotations_sha256`."""
    return rotations_sha256(_slices(level))


def _slices(level: int) -> Iterator[Rotations]:
    """Yield the rotations tilt by tilt."""
    grid_size(level)
    n_side = 2**level
    polar, azimuth = healpix.pix2ang(n_side, np.arange(12 * n_side**2))
    to_direction = rotations_about((0, 0, 1), azimuth) @ rotations_about((0, 1, 0), polar)
    for tilt in rotations_about((0, 0, 1), 2.0 * np.pi * np.arange(6 * n_side) / (6 * n_side)):
        yield to_direction @ tilt


def implicit_pdf_to_grid_frame(R: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Turn rotations from Implicit-PDF's axes into ours, in which its grid is this grid, index by index.

    Args:
        R: (..., 3, 3) rotations of any floating type.

    Returns:
        (..., 3, 3) the same numbers at other places, so of the same type and as exact as they were.

    Raises:
        RotationError: the trailing shape is not (3, 3).
    """
    return _with_axes(R, _FROM_IMPLICIT_PDF)


def grid_frame_to_implicit_pdf(R: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Undo `implicit_pdf_to_grid_frame`."""
    return _with_axes(R, _TO_IMPLICIT_PDF)


def e3nn_to_grid_frame(R: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Turn rotations from e3nn's axes into ours, in which its grid is this grid, index by index.

    Shapes, types and errors are those of `implicit_pdf_to_grid_frame`.
    """
    return _with_axes(R, _FROM_E3NN)


def grid_frame_to_e3nn(R: npt.NDArray[Real]) -> npt.NDArray[Real]:
    """Undo `e3nn_to_grid_frame`."""
    return _with_axes(R, _TO_E3NN)


def ring_to_nested(level: int = STANDARD_LEVEL) -> npt.NDArray[np.int64]:
    """Return, for each grid index, its index where HEALPix's nested order is used (SpyroPose): (72 x 8^level,)."""
    directions = 12 * 4**level
    tilt, direction = np.divmod(np.arange(grid_size(level)), directions)
    nested: npt.NDArray[np.int64] = tilt * directions + healpix.ring2nest(2**level, direction)
    return nested


def _with_axes(R: npt.NDArray[Real], axes: tuple[int, int, int]) -> npt.NDArray[Real]:
    """Return P R P^T for the permutation P of axes, without arithmetic."""
    given = np.asarray(R)
    if given.shape[-2:] != (3, 3):
        raise RotationError(f"rotations: expected an array of shape (..., 3, 3), found {given.shape}")
    order = list(axes)
    return given[..., order, :][..., order]


class GridIndex:
    """Finds grid rotations near given ones.

    Unit quaternions q and -q are one rotation, so both are in the tree; the chord to the nearer is 2 sin(angle / 4).

    Attributes:
        level: of the grid.
        rotations: (72 x 8^level, 3, 3), the grid.
    """

    def __init__(self, level: int = STANDARD_LEVEL) -> None:
        self.level = level
        self.rotations = equivolumetric_grid(level)
        quat_wxyz = rotation_to_quat_wxyz(self.rotations)
        self._tree = cKDTree(np.concatenate([quat_wxyz, -quat_wxyz]))

    def __len__(self) -> int:
        return len(self.rotations)

    def nearest(self, R: Rotations) -> npt.NDArray[np.int64]:
        """Return the indices (n,) of the grid rotations nearest to R (n, 3, 3)."""
        index: npt.NDArray[np.int64] = self._tree.query(rotation_to_quat_wxyz(R))[1] % len(self)
        return index

    def within(self, R: Rotations, angle_rad: Angles | float) -> npt.NDArray[np.int64]:
        """Return the sorted indices of all grid rotations at most `angle_rad` (+ 1e-9) from any of R (n, 3, 3).

        Args:
            R: the rotations.
            angle_rad: one for all, or (n,), each up to pi.
        """
        chord = 2.0 * np.sin((angle_rad + _ROUNDING_RAD) / 4.0)
        lists = self._tree.query_ball_point(rotation_to_quat_wxyz(R), chord)
        found = np.concatenate([np.zeros(0), *lists]).astype(np.int64)
        return np.unique(found % len(self))


def grid_index(level: int = STANDARD_LEVEL) -> GridIndex:
    """Return the index of a level's grid; those up to the standard level are made once, and shared.

    Raises:
        SettingsError: there is no such level.
    """
    return _kept_index(level) if level <= STANDARD_LEVEL else GridIndex(level)


@lru_cache(maxsize=STANDARD_LEVEL + 1)
def _kept_index(level: int) -> GridIndex:
    return GridIndex(level)
