"""A set of rotations that fills a part of SO(3), as a mask over the cells of the equivolumetric grid of level 5.

Where nothing that breaks a sphere's symmetry shows, that depends on the direction from the sphere to the camera alone,
v = -(third row of R_m2c): such a volume is a region of the sphere of directions, times all turns about the line of
sight. The grid writes R = Rz(azimuth) Ry(polar) Rz(tilt), so that v has the coordinates (polar, tilt), the azimuth does
not matter, and the mask is the same along each of the grid's rings.
"""

import hashlib
from collections.abc import Callable
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.regions import Bands
from symsol_annot.errors import RotationError
from symsol_annot.rotations.so3 import Angles, Rotations, rotations_about

if TYPE_CHECKING:
    from symsol_annot.annotation.cells import Cells

VOLUME_LEVEL = 5  # of the equivolumetric grid whose cells a volume consists of
N_SIDE = 2**VOLUME_LEVEL
DIRECTIONS, TILTS = 12 * N_SIDE**2, 6 * N_SIDE
CELLS = TILTS * DIRECTIONS
BANDS_ERROR_RAD = 1e-7  # of `Volume.distance` where the volume is a region of directions
CELLS_ERROR_RAD = float(np.radians(1.1))  # where it is not: `Volume.distance` is too large by no more
_PIECE_RAD = float(np.radians(1.6))  # no direction is farther from the one of `viewing_directions` that stands for it


class Volume:
    """Some cells of the equivolumetric grid of level 5, as a set of rotations.

    A volume that is the same along every ring of the grid is a region of directions v: a ring stands for the band
    around it that has as large a share of the sphere as the ring's cells have of SO(3). Whether a rotation is inside is
    then decided by its v alone. Any other volume is the union of its cells, as `cells.Cells` has them.

    Attributes:
        mask: (2359296,) bool, read-only, which cells of level 5 are in it, in the order of the grid's indices.
    """

    def __init__(self, mask: npt.NDArray[np.bool_]) -> None:
        """Make a volume of a mask.

        Raises:
            RotationError: the mask is of another level, of another type, or empty.
        """
        found = np.asarray(mask)
        if found.shape != (CELLS,) or found.dtype != bool:
            raise RotationError(
                f"volume: expected a mask of the {CELLS} cells of the grid of level {VOLUME_LEVEL}, bool, found shape "
                f"{found.shape} of {found.dtype}"
            )
        if not found.any():
            raise RotationError("volume: no cell is in it; a set without volume has None in its place")
        self.mask = found.copy()
        self.mask.setflags(write=False)

    @classmethod
    def of_cells(cls, cells: npt.NDArray[np.int64]) -> "Volume":
        """Return the volume of cells (c,), by their indices.

        Raises:
            RotationError: an index is outside of the grid, or there is none.
        """
        mask = np.zeros(CELLS, dtype=bool)
        if len(cells) and not 0 <= np.min(cells) <= np.max(cells) < CELLS:
            raise RotationError(
                f"volume: cells have indices 0 to {CELLS - 1}, found {np.min(cells)} to {np.max(cells)}"
            )
        mask[cells] = True
        return cls(mask)

    @classmethod
    def of_directions(cls, is_inside: Callable[[npt.NDArray[np.float64]], npt.NDArray[np.bool_]]) -> "Volume":
        """Return the volume of a region of directions.

        Args:
            is_inside: tells of (n, 3) unit vectors v in model coordinates, from the object to the camera, whether all
                R_m2c that see the object from there are in the volume, (n,). It is asked about the 24,384 directions of
                `viewing_directions`, and so known to half a step of theirs.

        Raises:
            RotationError: no direction is inside.
        """
        asked = viewing_directions()
        bands = np.asarray(is_inside(asked.reshape(-1, 3)), dtype=bool).reshape(asked.shape[:2])
        return cls(np.repeat(bands, _ring_sizes(), axis=1).reshape(-1))

    @cached_property
    def cells(self) -> npt.NDArray[np.int64]:
        """(c,) the ascending indices of its cells."""
        return np.flatnonzero(self.mask).astype(np.int64)

    @cached_property
    def measure(self) -> float:
        """Its share of SO(3), in (0, 1]."""
        return int(self.mask.sum()) / CELLS

    @cached_property
    def digest(self) -> str:
        """The SHA-256 of its mask, as bits, which names it by its content."""
        return hashlib.sha256(np.packbits(self.mask).tobytes()).hexdigest()

    @property
    def rings(self) -> npt.NDArray[np.bool_]:
        """(127, 192) of a region of directions, which tilts of each ring are inside.

        Raises:
            RotationError: it is no region of directions.
        """
        if self._bands is None:
            raise RotationError("volume: it is no region of directions, so that its rings are not inside as a whole")
        return self._bands.inside

    @property
    def is_of_directions(self) -> bool:
        """Whether it is a region of directions, times all turns about the line of sight."""
        return self._bands is not None

    def __eq__(self, other: object) -> bool:
        return np.array_equal(self.mask, other.mask) if isinstance(other, Volume) else NotImplemented

    def __hash__(self) -> int:
        return hash(self.digest)

    def __repr__(self) -> str:
        return f"<Volume: {self.measure:.2%} of SO(3)>"

    def __reduce__(self) -> tuple[Any, ...]:
        return _of_bits, (np.packbits(self.mask).tobytes(),)

    def contains(self, R_m2c: Rotations) -> npt.NDArray[np.bool_]:
        """Tell which rotations (n, 3, 3) are inside, (n,)."""
        if self._bands is not None:
            return self._bands.contains(*_polar_and_tilt(R_m2c))
        return self._union.contains(R_m2c)

    def distance(self, R_m2c: Rotations) -> Angles:
        """Return the angles (n,) in rad from rotations (n, 3, 3) to the volume, which are 0 inside it.

        The geodesic distance (5.6) to a region of directions is the angle from v to it on the sphere, and exact to
        `BANDS_ERROR_RAD`. To any other volume it is the angle to the nearest centre of an eighth of one of its cells,
        and too large by at most `CELLS_ERROR_RAD`.
        """
        angles = np.zeros(len(R_m2c))
        outside = np.flatnonzero(~self.contains(R_m2c))
        if len(outside) and self._bands is not None:
            angles[outside] = self._bands.distance(*_polar_and_tilt(R_m2c[outside]))
        elif len(outside):
            angles[outside] = self._union.distance(R_m2c[outside])
        return angles

    def within(self, R_m2c: Rotations, angle_rad: float) -> npt.NDArray[np.bool_]:
        """Tell which rotations (n, 3, 3) are at most an angle from the volume, (n,): as `distance` says, but faster."""
        if self._bands is None:
            return np.asarray(self.distance(R_m2c) <= angle_rad)
        polar, tilt = _polar_and_tilt(R_m2c)
        of_piece = self._distance_of_pieces[self._bands.piece_of(polar, tilt)]
        found = of_piece <= angle_rad
        unsure = np.flatnonzero(np.abs(of_piece - angle_rad) <= _PIECE_RAD)
        found[unsure] = self.distance(R_m2c[unsure]) <= angle_rad
        return found

    def sample(self, n: int, rng: np.random.Generator) -> Rotations:
        """Draw (n, 3, 3) rotations uniformly from the volume."""
        cells = self.cells[rng.integers(len(self.cells), size=n)]
        if self._bands is None:
            return self._union.uniform(cells, rng)
        tilt, direction = np.divmod(cells, DIRECTIONS)
        ring = np.repeat(np.arange(4 * N_SIDE - 1), _ring_sizes())[direction]
        polar, tilt_rad = self._bands.uniform(ring, tilt, rng)
        about_z = rotations_about((0, 0, 1), 2.0 * np.pi * rng.random(n))
        return about_z @ rotations_about((0, 1, 0), polar) @ rotations_about((0, 0, 1), tilt_rad)

    @cached_property
    def _bands(self) -> Bands | None:
        """The region of directions that it is; None where it is none."""
        by_tilt = self.mask.reshape(TILTS, DIRECTIONS)
        starts = np.cumsum(_ring_sizes()) - _ring_sizes()
        inside = np.logical_or.reduceat(by_tilt, starts, axis=1)
        if not np.array_equal(inside, np.logical_and.reduceat(by_tilt, starts, axis=1)):
            return None
        return Bands(inside.T, ring_edges())

    @cached_property
    def _distance_of_pieces(self) -> Angles:
        """(127, 192) the angles in rad from the directions of `viewing_directions` to a region of directions."""
        v = viewing_directions().reshape(-1, 3)
        third_row_alone = np.zeros((len(v), 3, 3))
        third_row_alone[:, 2] = -v
        return self.distance(third_row_alone).reshape(TILTS, -1).T

    @cached_property
    def _union(self) -> "Cells":
        """The union of cells that it is."""
        from symsol_annot.annotation.cells import Cells  # noqa: PLC0415 - it takes scipy, which is slow to load

        return Cells(self.mask, VOLUME_LEVEL)


def viewing_directions() -> npt.NDArray[np.float64]:
    """Return the unit vectors v, in model coordinates, from the object to the camera at each tilt and ring of level 5.

    Returns:
        (192, 127, 3): tilt by ring.
    """
    ring = np.arange(1, 4 * N_SIDE)
    belt = 4.0 / 3.0 - 2.0 * ring / (3.0 * N_SIDE)
    to_pole = np.minimum(ring, 4 * N_SIDE - ring)
    cap = np.sign(2 * N_SIDE - ring) * (1.0 - to_pole**2 / (3.0 * N_SIDE**2))
    height = np.where(to_pole < N_SIDE, cap, belt)
    tilt_rad = (2.0 * np.pi * np.arange(TILTS) / TILTS)[:, None]
    across = np.sqrt(1.0 - height**2)
    return np.stack([across * np.cos(tilt_rad), -across * np.sin(tilt_rad), -height + 0.0 * tilt_rad], axis=-1)


def ring_edges() -> Angles:
    """Return the (128,) ascending polar angles in rad between the bands that rings of level 5 stand for, 0 to pi."""
    return np.arccos(1.0 - 2.0 * np.concatenate([[0], np.cumsum(_ring_sizes())]) / DIRECTIONS)


def _ring_sizes() -> npt.NDArray[np.int64]:
    """Return how many directions each of the 127 rings of level 5 has."""
    ring = np.arange(1, 4 * N_SIDE)
    return 4 * np.minimum(np.minimum(ring, 4 * N_SIDE - ring), N_SIDE)


def _polar_and_tilt(R_m2c: Rotations) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the polar angle (n,) and the tilt (n,) in rad of rotations (n, 3, 3): the coordinates of -v.

    The columns are copied: of strided ones, numpy takes another arctan2, which differs in the last bit, where its
    output happens to lie right behind them in memory (with AVX-512).
    """
    x, y, z = (np.ascontiguousarray(column) for column in (-R_m2c[..., 2, 0], R_m2c[..., 2, 1], R_m2c[..., 2, 2]))
    return np.arctan2(np.hypot(x, y), z), np.arctan2(y, x)


def _of_bits(bits: bytes) -> Volume:
    return Volume(np.unpackbits(np.frombuffer(bits, dtype=np.uint8), count=CELLS).astype(bool))
