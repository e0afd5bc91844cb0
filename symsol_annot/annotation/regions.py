"""Regions of the sphere that consist of pieces of bands: which points are inside, and how far others are from them."""

from functools import cached_property

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import Angles

Reals = npt.NDArray[np.float64]

_PAIRS_AT_ONCE = 2**20


class Bands:
    """A region of the sphere in polar angle and longitude: of some bands, some of as many equal pieces.

    Piece number t of T lies around the longitude 2 pi t / T.
    """

    def __init__(self, inside: npt.NDArray[np.bool_], edges: Reals) -> None:
        """Make a region.

        Args:
            inside: (B, T) which pieces of each band are in it.
            edges: (B + 1,) ascending polar angles in rad, 0 to pi, between which the bands lie.
        """
        self._inside, self._edges = inside, edges

    def contains(self, polar: Angles, longitude: Angles) -> npt.NDArray[np.bool_]:
        """Tell which points (n,), given in rad, are inside, (n,)."""
        bands, pieces = self._inside.shape
        band = np.clip(np.searchsorted(self._edges, polar, side="right") - 1, 0, bands - 1)
        piece = np.rint(longitude * pieces / (2.0 * np.pi)).astype(np.int64) % pieces
        return np.asarray(self._inside[band, piece])

    def uniform(
        self, band: npt.NDArray[np.int64], piece: npt.NDArray[np.int64], rng: np.random.Generator
    ) -> tuple[Angles, Angles]:
        """Draw a point uniformly from each of the pieces (n,): polar angles and longitudes (n,) in rad."""
        top, bottom = np.cos(self._edges[band]), np.cos(self._edges[band + 1])
        polar = np.arccos(top + (bottom - top) * rng.random(len(band)))
        return polar, 2.0 * np.pi * (piece + rng.random(len(piece)) - 0.5) / self._inside.shape[1]

    def distance(self, polar: Angles, longitude: Angles) -> Angles:
        """Return the angles (n,) in rad from points (n,) outside the region to its edge.

        The edge consists of arcs of parallels and of meridians. The point of a parallel's arc that is nearest to a
        given one is at the longitude nearest to it; that of a meridian's arc is the foot of the perpendicular or an
        end, and every end is on a parallel's arc or at a pole.
        """
        step = max(1, _PAIRS_AT_ONCE // (1 + len(self._parallels) + len(self._meridians)))
        parts = [slice(start, start + step) for start in range(0, len(polar), step)]
        haversines = [self._least_haversine(polar[part][:, None], longitude[part][:, None]) for part in parts]
        return 2.0 * np.arcsin(np.sqrt(np.clip(np.concatenate([np.zeros(0), *haversines]), 0.0, 1.0)))

    def _least_haversine(self, polar: Reals, longitude: Reals) -> Reals:
        """Return sin^2(angle / 2) of the angles (n,) from points (n, 1) to the edge."""
        at, first, length = self._parallels.T
        beyond = (longitude - first) % (2.0 * np.pi)
        gap = np.where(beyond <= length, 0.0, np.minimum(beyond - length, 2.0 * np.pi - beyond))
        least = _haversine(polar - at, np.sin(polar) * np.sin(at), gap).min(axis=1, initial=1.0)
        at, first, last = self._meridians.T
        turn = longitude - at
        foot = np.arctan2(np.sin(polar) * np.cos(turn), np.cos(polar))
        of_foot = _haversine(polar - foot, np.sin(polar) * np.sin(foot), turn)
        on_arc = np.where((foot >= first) & (foot <= last), of_foot, 1.0)
        return np.minimum(least, on_arc.min(axis=1, initial=1.0))

    @cached_property
    def _parallels(self) -> Reals:
        """(a, 3) polar angle, first longitude and length of each arc of the edge along a parallel."""
        pieces = self._inside.shape[1]
        found = []
        for band in range(1, len(self._inside)):
            differs = self._inside[band - 1] != self._inside[band]
            found += [
                (self._edges[band], 2.0 * np.pi * (first - 0.5) / pieces, 2.0 * np.pi * count / pieces)
                for first, count in _runs_around(differs)
            ]
        ends = ((0, 0.0), (-1, np.pi))
        found += [(pole, 0.0, 2.0 * np.pi) for band, pole in ends if self._inside[band].any()]
        return np.array(found).reshape(-1, 3)

    @cached_property
    def _meridians(self) -> Reals:
        """(a, 3) longitude, first and last polar angle of each arc of the edge along a meridian."""
        pieces = self._inside.shape[1]
        found = []
        for piece in range(pieces):
            differs = self._inside[:, piece - 1] != self._inside[:, piece]
            bounds = np.flatnonzero(np.diff(np.concatenate([[False], differs, [False]]).astype(np.int8)))
            longitude = 2.0 * np.pi * (piece - 0.5) / pieces
            found += [(longitude, self._edges[a], self._edges[b]) for a, b in bounds.reshape(-1, 2)]
        return np.array(found).reshape(-1, 3)


def _haversine(difference: Reals, product_of_sines: Reals, turn: Reals) -> Reals:
    """Return sin^2(angle / 2) between points whose polar angles differ by one angle, and longitudes by another."""
    found: Reals = np.sin(difference / 2.0) ** 2 + product_of_sines * np.sin(turn / 2.0) ** 2
    return found


def _runs_around(flags: npt.NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the first place and the length of each run of flags that are set around a circle (n,)."""
    if flags.all():
        return [(0, len(flags))]
    start = int(np.argmin(flags))  # one that is not set, so that no run goes over the end
    around = np.roll(flags, -start)
    bounds = np.flatnonzero(np.diff(np.concatenate([around, [False]]).astype(np.int8))) + 1
    return [((int(a) + start) % len(flags), int(b - a)) for a, b in bounds.reshape(-1, 2)]
