"""The distance from points to a surface, exact, by a tree of its triangles cut into small pieces."""

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Distances = npt.NDArray[np.float64]

_PIECES = 12_000  # a surface is cut into about as many, and as many more as it has triangles
_NEAREST = (3, 24)  # pieces that are measured first
_PAIRS = 2**18  # of points and pieces, measured at once


class SurfaceDistance:
    """Measures distances to a set of triangles.

    Args:
        corners: (T, 3, 3) of the triangles.

    Attributes:
        corners: as given.
        pieces: (P, 3, 3) the triangles, cut until none is long.
        parent: (P,) the triangle that each piece was cut from.
        reach: the largest distance from a piece's centroid to its corners.
    """

    def __init__(self, corners: Points) -> None:
        self.corners = corners
        self.pieces, self.parent = _cut(corners)
        self.centres = self.pieces.mean(axis=1)
        self.reach = float(np.linalg.norm(self.pieces - self.centres[:, None], axis=-1).max())
        self.tree = cKDTree(self.centres)

    def __call__(self, points: Points, limit: float, slack: float | None = None) -> Distances:
        """Return distances (n,) as `nearest` does."""
        return self.nearest(points, limit, slack)[0]

    def nearest(self, points: Points, limit: float, slack: float | None = None) -> tuple[Distances, Indices]:
        """Return how far points (n, 3) are from the surface, and the triangle (n,) that is so far.

        Args:
            points: the points.
            limit: distances up to it, and those beyond it, are told apart exactly. One beyond it may be given as
                larger than it is, by up to `reach`.
            slack: how much larger one within the limit may be given; the limit, if None.
        """
        distance, triangle = np.full(len(points), np.inf), np.zeros(len(points), dtype=np.intp)
        open_ = np.arange(len(points))
        for count in _NEAREST:  # of thin triangles, the one that a point is on may have no centre near it
            to_centre, near = self.tree.query(points[open_], k=[*range(1, min(count, len(self.centres)) + 1)])
            self._measure(points, distance, triangle, np.repeat(open_, near.shape[1]), near.ravel())
            is_far = distance[open_] > (limit if slack is None else slack)
            open_ = open_[is_far & (to_centre[:, 0] - self.reach <= limit)]
        for chosen in np.array_split(open_, max(1, len(open_) // 1024)):
            lists = self.tree.query_ball_point(points[chosen], limit + self.reach, return_sorted=False)
            rows = np.repeat(chosen, [len(found) for found in lists])
            pieces = np.concatenate([np.asarray(found, dtype=np.intp) for found in (*lists, [])])
            for first in range(0, len(rows), _PAIRS):
                some = slice(first, first + _PAIRS)
                self._measure(points, distance, triangle, rows[some], pieces[some])
        return distance, triangle

    def _measure(self, points: Points, distance: Distances, triangle: Indices, rows: Indices, pieces: Indices) -> None:
        """Measure points to the triangles of pieces, pair by pair, and keep what is nearer than what was known."""
        parent = self.parent[pieces]
        measured = point_to_triangle(points[rows], self.corners[parent])
        order = np.lexsort((measured, rows))
        is_best = np.ones(len(order), dtype=bool)
        is_best[1:] = rows[order][1:] != rows[order][:-1]
        best = order[is_best]
        is_nearer = measured[best] < distance[rows[best]]
        distance[rows[best][is_nearer]] = measured[best][is_nearer]
        triangle[rows[best][is_nearer]] = parent[best][is_nearer]


def point_to_triangle(points: Points, corners: Points) -> Distances:
    """Return the distance (n,) of each point (n, 3) to its own triangle (n, 3, 3)."""
    edges = np.roll(corners, -1, axis=1) - corners
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    from_corner = points[:, None] - corners
    lengths = np.maximum(np.einsum("nci,nci->nc", edges, edges), 1e-300)
    along = np.clip(np.einsum("nci,nci->nc", from_corner, edges) / lengths, 0.0, 1.0)
    to_edge = from_corner - along[..., None] * edges
    squared = np.einsum("nci,nci->nc", to_edge, to_edge).min(axis=1)
    height = np.einsum("ni,ni->n", from_corner[:, 0], normals)
    side = np.einsum("nci,nci->nc", from_corner, np.cross(normals[:, None], edges))
    distance: Distances = np.where((side >= 0).all(axis=1), np.abs(height), np.sqrt(squared))
    return distance


def _cut(corners: Points) -> tuple[Points, Indices]:
    """Halve the longest edge of triangles (T, 3, 3) until none is long: the pieces, and where each is from."""
    pieces, parent = corners, np.arange(len(corners), dtype=np.intp)
    most = _PIECES + 2 * len(corners)
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=-1)
    longest = sides.max(axis=1)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    limit = float(longest.max()) / 256
    while (1.0 + 4.0 * area / limit**2 + 1.5 * longest / limit).sum() > most:
        limit *= 1.25
    while True:
        sides = np.square(np.roll(pieces, -1, axis=1) - pieces).sum(axis=-1)
        is_long = sides.max(axis=1) > limit**2
        if not is_long.any():
            return pieces, parent
        turn = (sides[is_long].argmax(axis=1)[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(pieces[is_long], turn[..., None], axis=1), 1, 0)
        middle = (a + b) / 2
        halves = np.concatenate([np.stack([a, middle, c], axis=1), np.stack([middle, b, c], axis=1)])
        pieces = np.concatenate([pieces[~is_long], halves])
        parent = np.concatenate([parent[~is_long], parent[is_long], parent[is_long]])
