"""Points of the camera's lattice inside polygons and near their edges; the points lie at half-integers."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

Floats = npt.NDArray[np.float64]
Ints = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]

_SIDE = 1 << 16  # more than rows and columns, also those beside the image
_LEVEL = 1e-9  # rise along v below which a segment is taken to run along a row


@dataclass(frozen=True, eq=False)
class Segments:
    """Segments of several polygons.

    Attributes:
        owner: (k,) the polygon's number.
        start: (k, 2) u, v.
        end: (k, 2) u, v.
    """

    owner: Ints
    start: Floats
    end: Floats


@dataclass(frozen=True, eq=False)
class LatticePoints:
    """Lattice points beside several polygons: (k,) each, sorted and without duplicates.

    Attributes:
        owner: the polygon's number.
        row: its v, less a half.
        column: its u, less a half.
    """

    owner: Ints
    row: Ints
    column: Ints

    @classmethod
    def joined(cls, *parts: tuple[Ints, Ints, Ints]) -> "LatticePoints":
        """Return the points (owner, row, column) of several lists, each once."""
        owner, row, column = (np.concatenate(values) for values in zip(*parts, strict=True))
        key = _line(owner, row) * _SIDE + column
        _, first = np.unique(key, return_index=True)
        return cls(owner[first], row[first], column[first])

    @classmethod
    def none(cls) -> "LatticePoints":
        """Return no points."""
        return cls(*np.zeros((3, 0), dtype=np.int64))

    @property
    def uv(self) -> Floats:
        """Their u, v: (k, 2)."""
        return np.stack([self.column, self.row], axis=1) + 0.5

    def __getitem__(self, chosen: Flags) -> "LatticePoints":
        return LatticePoints(self.owner[chosen], self.row[chosen], self.column[chosen])

    def of_owners(self, chosen: Flags) -> "LatticePoints":
        """Return the points of the chosen (n,) of n polygons, which are numbered anew."""
        kept = self[chosen[self.owner]]
        return LatticePoints((np.cumsum(chosen) - 1)[kept.owner], kept.row, kept.column)

    def __or__(self, other: "LatticePoints") -> "LatticePoints":
        return LatticePoints.joined((self.owner, self.row, self.column), (other.owner, other.row, other.column))


def count_inside(outlines: Segments, polygons: int) -> Ints:
    """Return how many lattice points each of n polygons holds: (n,).

    An outline is closed, of one loop or several, and runs upwards on the right of what it holds. A row's points left
    of each crossing are added where the outline goes up, and taken away where it goes down.
    """
    segment, _, column, sign = _crossings(outlines)
    return np.bincount(outlines.owner[segment], sign * (column + 1), polygons).round().astype(np.int64)


def is_inside(points: LatticePoints, outlines: Segments) -> Flags:
    """Tell which points (k,) are inside their polygon's outline, by the rule that `count_inside` counts by: (k,)."""
    segment, row, column, sign = _crossings(outlines)
    line, theirs = _line(outlines.owner[segment], row), _line(points.owner, points.row)
    order = np.argsort(line, kind="stable")
    first, last = np.searchsorted(line[order], theirs), np.searchsorted(line[order], theirs, side="right")
    which, place = _expand(first, last - 1)
    met = order[place]
    signs = np.where(points.column[which] <= column[met], sign[met], 0.0)
    return np.asarray(np.bincount(which, signs, len(theirs)) > 0)


def points_near(segments: Segments, reach: Floats | float) -> LatticePoints:
    """Return the lattice points within `reach`, (k,) or one for all, of each of k segments, along u and along v."""
    start, end, reach = segments.start, segments.end, np.broadcast_to(reach, len(segments.start))
    low, high = np.minimum(start, end) - reach[:, None], np.maximum(start, end) + reach[:, None]
    segment, row = _expand(np.ceil(low[:, 1] - 0.5), np.floor(high[:, 1] - 0.5))
    (du, dv), reach = (end - start)[segment].T, reach[segment]
    is_level = np.abs(dv) < _LEVEL
    slope = du / np.where(is_level, 1.0, dv)
    middle = start[segment, 0] + (row + 0.5 - start[segment, 1]) * slope
    half = np.where(is_level, np.inf, reach * (1.0 + np.abs(slope)))
    left, right = np.maximum(low[segment, 0], middle - half), np.minimum(high[segment, 0], middle + half)
    which, column = _expand(np.ceil(left - 0.5), np.floor(right - 0.5))
    return LatticePoints.joined((segments.owner[segment[which]], row[which], column))


def _crossings(outlines: Segments) -> tuple[Ints, Ints, Ints, Floats]:
    """Return where segments cross the rows of points: segment, row, the last column on the left, 1 going up or -1."""
    start, end = outlines.start, outlines.end
    low, high = np.minimum(start[:, 1], end[:, 1]), np.maximum(start[:, 1], end[:, 1])
    segment, row = _expand(np.ceil(low - 0.5), np.ceil(high - 0.5) - 1.0)
    here, there = start[segment], end[segment]
    share = (row + 0.5 - here[:, 1]) / (there[:, 1] - here[:, 1])
    column = np.floor(here[:, 0] + share * (there[:, 0] - here[:, 0]) - 0.5).astype(np.int64)
    return segment, row, column, np.where(there[:, 1] < here[:, 1], 1.0, -1.0)


def _line(owner: Ints, row: Ints) -> Ints:
    """Return one number for a row of a polygon."""
    return owner * _SIDE + row


def _expand(first: npt.NDArray[Any], last: npt.NDArray[Any]) -> tuple[Ints, Ints]:
    """Return all whole numbers of each of k ranges, ends included, and before them the range's number."""
    first = first.astype(np.int64)
    lengths = np.maximum(last.astype(np.int64) - first + 1, 0)
    which = np.repeat(np.arange(len(lengths)), lengths)
    return which, first[which] + np.arange(len(which)) - (np.cumsum(lengths) - lengths)[which]
