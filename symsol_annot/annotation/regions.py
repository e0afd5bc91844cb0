"""Regions of the sphere that consist of pieces of bands: which points are inside, and how far others are from them."""

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import Angles

Reals = npt.NDArray[np.float64]

_PAIRS_AT_ONCE = 2**20
_PIECE = 4.0  # more than a polar angle can be


class Bands:
    """A region of the sphere in polar angle and longitude: of some bands, some of as many equal pieces.

    Piece number t of T lies around the longitude 2 pi t / T.

    Attributes:
        inside: (B, T) bool, which pieces of each band are in it.
    """

    def __init__(self, inside: npt.NDArray[np.bool_], edges: Reals) -> None:
        """Make a region.

        Args:
            inside: (B, T) which pieces of each band are in it.
            edges: (B + 1,) ascending polar angles in rad, 0 to pi, between which the bands lie.
        """
        self.inside, self._edges = inside, edges

    def contains(self, polar: Angles, longitude: Angles) -> npt.NDArray[np.bool_]:
        """Tell which points (n,), given in rad, are inside, (n,)."""
        return np.asarray(self.inside[self.piece_of(polar, longitude)])

    def piece_of(self, polar: Angles, longitude: Angles) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
        """Return the band (n,) and the piece of it (n,) in which points (n,), given in rad, lie."""
        bands, pieces = self.inside.shape
        band = np.clip(np.searchsorted(self._edges, polar, side="right") - 1, 0, bands - 1)
        return band, np.rint(longitude * pieces / (2.0 * np.pi)).astype(np.int64) % pieces

    def uniform(
        self, band: npt.NDArray[np.int64], piece: npt.NDArray[np.int64], rng: np.random.Generator
    ) -> tuple[Angles, Angles]:
        """Draw a point uniformly from each of the pieces (n,): polar angles and longitudes (n,) in rad."""
        top, bottom = np.cos(self._edges[band]), np.cos(self._edges[band + 1])
        polar = np.arccos(top + (bottom - top) * rng.random(len(band)))
        return polar, 2.0 * np.pi * (piece + rng.random(len(piece)) - 0.5) / self.inside.shape[1]

    def distance(self, polar: Angles, longitude: Angles) -> Angles:
        """Return the angles (n,) in rad from points (n,) outside the region to its edge, to 1e-7.

        The edge consists of arcs of parallels and of meridians. The point of an arc that is nearest to a given one is
        one of its ends, or the foot of the perpendicular: on a parallel's arc at the same longitude, on a meridian's in
        the plane through the axis.
        """
        across = np.sin(polar)
        points = np.stack([across * np.cos(longitude), across * np.sin(longitude), np.cos(polar)], axis=-1)
        to_ends = np.full(len(points), np.pi)
        if self._ends is not None:
            to_ends = 2.0 * np.arcsin(np.minimum(self._ends.query(points)[0] / 2.0, 1.0))
        step = max(1, _PAIRS_AT_ONCE // (1 + len(self._meridians)))
        parts = [points[start : start + step] for start in range(0, len(points), step)]
        to_meridians = np.concatenate([np.zeros(0), *(self._to_meridians(part) for part in parts)])
        return np.minimum(np.minimum(to_ends, to_meridians), self._to_parallels(polar, longitude))

    def _to_parallels(self, polar: Angles, longitude: Angles) -> Angles:
        """Return the angles (n,) to the nearest arc of a parallel at the same longitude; infinite where none is."""
        edges = self._edges_by_piece
        piece = self.piece_of(polar, longitude)[1]
        place = np.searchsorted(edges, _PIECE * piece + polar)
        around = np.concatenate([[-np.inf], edges, [np.inf]])[place[:, None] + [0, 1]] - (_PIECE * piece)[:, None]
        is_there = (around >= 0.0) & (around < _PIECE)
        return np.where(is_there, np.abs(around - polar[:, None]), np.inf).min(axis=1)

    def _to_meridians(self, points: Reals) -> Angles:
        """Return the angles from unit vectors (n, 3) to the nearest arc of a meridian that has the foot; else pi."""
        at, first, last = self._meridians.T
        outwards = np.stack([np.cos(at), np.sin(at), np.zeros(len(at))])
        aside = np.stack([-np.sin(at), np.cos(at), np.zeros(len(at))])
        axis = np.array([[0.0], [0.0], [1.0]])
        after_first = points @ (outwards * np.cos(first) - axis * np.sin(first)) >= 0.0
        before_last = points @ (axis * np.sin(last) - outwards * np.cos(last)) >= 0.0
        sines = np.where(after_first & before_last, np.abs(points @ aside), np.inf).min(axis=1, initial=np.inf)
        return np.where(np.isinf(sines), np.pi, np.arcsin(np.minimum(sines, 1.0)))

    @cached_property
    def _edges_by_piece(self) -> Reals:
        """(e,) ascending: `_PIECE` times a piece's number, and the polar angle of an edge across that piece."""
        band, piece = np.nonzero(self.inside[:-1] != self.inside[1:])
        return np.sort(_PIECE * piece + self._edges[band + 1])

    @cached_property
    def _ends(self) -> Any:
        """A tree of the ends of the edge's arcs, and the poles that are inside; None where there are none."""
        from scipy.spatial import cKDTree  # noqa: PLC0415 - it is slow to load

        at, first, last = self._meridians.T
        polar, longitude = np.concatenate([first, last]), np.concatenate([at, at])
        poles = [[0.0, 0.0, 1.0 - 2.0 * (band < 0)] for band in (0, -1) if self.inside[band].any()]
        ends = np.stack([np.sin(polar) * np.cos(longitude), np.sin(polar) * np.sin(longitude), np.cos(polar)], axis=-1)
        found = np.concatenate([ends, np.reshape(poles, (-1, 3))])
        return cKDTree(found) if len(found) else None

    @cached_property
    def _meridians(self) -> Reals:
        """(a, 3) longitude, first and last polar angle of each arc of the edge along a meridian."""
        pieces = self.inside.shape[1]
        found = []
        for piece in range(pieces):
            differs = self.inside[:, piece - 1] != self.inside[:, piece]
            bounds = np.flatnonzero(np.diff(np.concatenate([[False], differs, [False]]).astype(np.int8)))
            longitude = 2.0 * np.pi * (piece - 0.5) / pieces
            found += [(longitude, self._edges[a], self._edges[b]) for a, b in bounds.reshape(-1, 2)]
        return np.array(found).reshape(-1, 3)
