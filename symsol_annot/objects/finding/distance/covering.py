"""A bound, triangle by triangle, of how far a surface lies from itself when it is turned.

A turned triangle is within d of the surface
- if its corners are within d of one and the same triangle of it: the distance to a convex set is a convex function;
- if its corners are within d of one flat convex region of it, for the same reason;
- or if triangles of the surface that face the same way cover it, seen along its normal, at heights of at most d.
  Covered is what clipping them with the triangle leaves of its area. At edges where the surface has a kink, a margin of
  the triangle is left out, as a residual moves those sideways; every point in the margin is near one outside of it.
"""

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from symsol_annot.objects.finding.distance.distances import SurfaceDistance, point_to_triangle
from symsol_annot.objects.finding.distance.flat_regions import FlatRegions
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.rotations.so3 import Rotations

Points = npt.NDArray[np.float64]
Bounds = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_KINK = np.cos(np.radians(20.0))
_FACING = 0.3  # cosine between normals of triangles that can cover each other
_EXACT, _INEXACT = 1 / 64, 1 / 3  # margins, as parts of the tolerance
_TRIES = ((_EXACT, 8), (_EXACT, 48), (_INEXACT, 48))  # margins, and how many neighbours of a piece are looked at
_MARGIN_LEFT = 0.999_999  # of a triangle's area that must be covered; what lacks of it is in the bound
_ALL_PAIRS, _PAIRS_AT_ONCE = 4_000_000, 2**21  # of triangles: more are looked up in a tree
_FEW = 10_000  # triangles: where there are more, any bound within the tolerance will do
_TIGHT = 1 / 64  # of the tolerance: a bound within it needs no better one


class Covering:
    """Bounds for one part of a surface.

    Args:
        surface: the whole one.
        is_of_part: (T,) the triangles of the part.
        distance: to the part.
        tolerance: how far apart surfaces may be.
    """

    def __init__(
        self, surface: Surface, is_of_part: npt.NDArray[np.bool_], distance: SurfaceDistance, tolerance: float
    ) -> None:
        self._distance, self._tolerance = distance, tolerance
        self._corners, self._normals = surface.corners[is_of_part], surface.normals[is_of_part]
        self._is_kink = _kinks(surface, is_of_part)
        self._stretch = _stretch(surface.triangles[is_of_part], self._corners, self._is_kink)
        self._least_angle = _angles(self._corners).min(axis=1)
        self._flat = FlatRegions(surface.chosen(is_of_part))

    def bounds(self, R: Rotations) -> Bounds:
        """Return for each triangle of the part how far from the part it is at most when turned; inf if not known."""
        corners = self._corners @ R.T
        limit = self._tolerance
        _, nearest = self._distance.nearest(corners.mean(axis=1), limit)
        to_one = [point_to_triangle(corners[:, k], self._distance.corners[nearest]) for k in range(3)]
        bounds = np.max(to_one, axis=0)
        bounds[bounds > limit] = np.inf
        bounds = np.minimum(bounds, self._flat.bounds(R, limit))
        for margin, neighbours in _TRIES:
            is_better = (margin, neighbours) == _TRIES[0] and len(bounds) <= _FEW
            left = np.flatnonzero(bounds > _TIGHT * limit if is_better else ~np.isfinite(bounds))
            if len(left):
                turned = corners[left], self._normals[left] @ R.T
                bounds[left] = np.minimum(bounds[left], self._covered(left, *turned, margin * limit, neighbours))
        return bounds

    def _covered(self, chosen: Indices, corners: Points, normals: Points, margin: float, neighbours: int) -> Bounds:
        """Return the bounds (n,) of turned triangles (n, 3, 3) by what covers them; inf where it does not."""
        row, other = self._pairs(chosen, corners, normals, neighbours)
        origin, along = corners[:, 0], corners[:, 1] - corners[:, 0]
        along = along / np.linalg.norm(along, axis=1, keepdims=True)
        axes = np.stack([along, np.cross(normals, along), normals], axis=1)  # (n, 3, 3) rows
        own = np.einsum("nij,nkj->nki", axes, corners - origin[:, None])[..., :2]
        inward, offset = _half_planes(own, margin * self._is_kink[chosen])
        area = _clipped_area(own, inward, offset)
        polygons = np.einsum("nij,nkj->nki", axes[row], self._distance.corners[other] - origin[row][:, None])
        side = np.einsum("nki,nei->nek", polygons[..., :2], inward[row]) - offset[row][..., None]
        reaches_in = (side.max(axis=2) > 0).all(axis=1)
        row, polygons = row[reaches_in], polygons[reaches_in]
        counts = np.full(len(row), 3, dtype=np.intp)
        for edge in range(3):
            polygons, counts = clip(polygons, counts, inward[row, edge], offset[row, edge])
        height = np.where(np.arange(polygons.shape[1]) < counts[:, None], np.abs(polygons[..., 2]), 0.0).max(axis=1)
        covers = (counts >= 3) & (height <= self._tolerance)
        covered = np.bincount(row, _areas(polygons, counts) * covers, minlength=len(chosen))
        highest = np.zeros(len(chosen))
        np.maximum.at(highest, row[covers], height[covers])
        lacking = np.maximum(area - covered, 0.0)
        gap = np.sqrt(2.0 * lacking / self._least_angle[chosen])
        bound = highest + margin * self._stretch[chosen] + np.where(lacking > 1e-13 * area, gap, 0.0)
        is_whole = (covered >= _MARGIN_LEFT * area) & (covered <= area * (2.0 - _MARGIN_LEFT)) & (area > 0)
        return np.where(is_whole & (bound <= self._tolerance), bound, np.inf)

    def _pairs(self, chosen: Indices, corners: Points, normals: Points, neighbours: int) -> tuple[Indices, Indices]:
        """Return pairs of a turned triangle, by its place in `chosen`, and one that is near and faces alike.

        Of many triangles, only those are looked at that have a piece among the nearest of one of the triangle's pieces.
        """
        if len(chosen) * len(self._corners) <= _ALL_PAIRS:
            return self._all_pairs(corners, normals)
        place = np.full(len(self._corners), -1, dtype=np.intp)
        place[chosen] = np.arange(len(chosen))
        distance = self._distance
        pieces = np.flatnonzero(place[distance.parent] >= 0)
        rows = place[distance.parent[pieces]]
        weights = _weights(distance.centres[pieces], self._corners[chosen[rows]])
        centres = np.einsum("nk,nkj->nj", weights, corners[rows])
        near = distance.tree.query(centres, k=min(neighbours, len(distance.centres)))[1]
        keys = np.unique((rows[:, None] * len(self._corners) + distance.parent[near]).ravel())
        first, second = np.divmod(keys, len(self._corners))
        is_near = self._is_near(corners[:, 0], normals, first, second)
        return first[is_near], second[is_near]

    def _all_pairs(self, corners: Points, normals: Points) -> tuple[Indices, Indices]:
        """Return the same pairs, from all there are."""
        other = self._distance.corners
        centres, sizes = _spheres(other)
        pairs = []
        for rows in np.array_split(np.arange(len(corners)), max(1, len(corners) * len(other) // _PAIRS_AT_ONCE)):
            level = np.einsum("ni,ni->n", corners[rows, 0], normals[rows])[:, None]
            heights = [normals[rows] @ other[:, k].T - level for k in range(3)]
            is_near = np.minimum(np.minimum(heights[0], heights[1]), heights[2]) <= self._tolerance
            is_near &= np.maximum(np.maximum(heights[0], heights[1]), heights[2]) >= -self._tolerance
            is_near &= normals[rows] @ self._normals.T > _FACING
            centre, size = _spheres(corners[rows])
            first, second = np.nonzero(is_near)
            apart = np.square(centre[first] - centres[second]).sum(axis=1)
            meets = apart <= (size[first] + sizes[second] + self._tolerance) ** 2
            pairs.append((rows[first[meets]], second[meets]))
        return np.concatenate([first for first, _ in pairs]), np.concatenate([second for _, second in pairs])

    def _is_near(self, origin: Points, normals: Points, first: Indices, second: Indices) -> npt.NDArray[np.bool_]:
        """Tell whether triangles of the part face as turned ones do, and reach into their planes, or nearly."""
        normal = normals[first]
        level = np.einsum("ni,ni->n", origin[first], normal)
        heights = np.stack([np.einsum("ni,ni->n", self._distance.corners[second, k], normal) for k in range(3)]) - level
        is_near = (heights.min(axis=0) <= self._tolerance) & (heights.max(axis=0) >= -self._tolerance)
        return np.asarray(is_near & (np.einsum("ni,ni->n", normal, self._normals[second]) > _FACING))


def clip(
    polygons: Points, counts: Indices, inward: npt.NDArray[np.float64], offset: npt.NDArray[np.float64]
) -> tuple[Points, Indices]:
    """Cut convex polygons (n, m, 3), of `counts` corners each, with the half-planes inward . (u, v) >= offset.

    Sutherland and Hodgman, "Reentrant polygon clipping", 1974, for many polygons at once.

    Args:
        polygons: corners (u, v, height); those from `counts` on are of no meaning.
        counts: (n,).
        inward: (n, 2) unit normals.
        offset: (n,).
    """
    size = polygons.shape[1]
    places = np.arange(size)
    side = np.einsum("nki,ni->nk", polygons[..., :2], inward) - offset[:, None]
    following = np.where(places + 1 < counts[:, None], places + 1, 0)
    next_side = np.take_along_axis(side, following, axis=1)
    next_corner = np.take_along_axis(polygons, following[..., None], axis=1)
    is_there = places < counts[:, None]
    keeps, crosses = is_there & (side >= 0), is_there & ((side >= 0) != (next_side >= 0))
    part = side / np.where(crosses, side - next_side, 1.0)
    crossing = polygons + np.clip(part, 0.0, 1.0)[..., None] * (next_corner - polygons)
    corners = np.stack([polygons, crossing], axis=2).reshape(len(polygons), 2 * size, 3)
    is_kept = np.stack([keeps, crosses], axis=2).reshape(len(polygons), 2 * size)
    order = np.argsort(~is_kept, axis=1, kind="stable")[:, : size + 1]
    return np.take_along_axis(corners, order[..., None], axis=1), np.minimum(is_kept.sum(axis=1), size + 1)


def _spheres(corners: Points) -> tuple[Points, npt.NDArray[np.float64]]:
    """Return the centroids (n, 3) of triangles and how far their corners are from them (n,)."""
    centres = corners.mean(axis=1)
    return centres, np.linalg.norm(corners - centres[:, None], axis=-1).max(axis=1)


def _areas(polygons: Points, counts: Indices) -> npt.NDArray[np.float64]:
    """Return the areas (n,) of polygons (n, m, 2 or 3) in their plane."""
    places = np.arange(polygons.shape[1])
    following = np.where(places + 1 < counts[:, None], places + 1, 0)
    start, end = polygons[..., :2], np.take_along_axis(polygons[..., :2], following[..., None], axis=1)
    twice = (start[..., 0] * end[..., 1] - start[..., 1] * end[..., 0]) * (places < counts[:, None])
    return np.asarray(np.abs(twice.sum(axis=1)) / 2.0)


def _half_planes(own: Points, margins: npt.NDArray[np.float64]) -> tuple[Points, npt.NDArray[np.float64]]:
    """Return inward normals (n, 3, 2) and offsets (n, 3) of the edges of counter-clockwise triangles (n, 3, 2)."""
    edges = np.roll(own, -1, axis=1) - own
    inward = np.stack([-edges[..., 1], edges[..., 0]], axis=-1)
    inward /= np.linalg.norm(inward, axis=-1, keepdims=True)
    return inward, np.einsum("nki,nki->nk", inward, own) + margins


def _clipped_area(own: Points, inward: Points, offset: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    polygons = np.concatenate([own, np.zeros((*own.shape[:2], 1))], axis=-1)
    counts = np.full(len(own), 3, dtype=np.intp)
    for edge in range(3):
        polygons, counts = clip(polygons, counts, inward[:, edge], offset[:, edge])
    return np.where(counts >= 3, _areas(polygons, counts), 0.0)


def _weights(points: Points, corners: Points) -> npt.NDArray[np.float64]:
    """Return the barycentric weights (n, 3) of points (n, 3) in triangles (n, 3, 3)."""
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0], points - corners[:, 0]
    uu, uv, vv = (np.einsum("ni,ni->n", a, b) for a, b in ((u, u), (u, v), (v, v)))
    wu, wv = (np.einsum("ni,ni->n", w, edge) for edge in (u, v))
    determinant = uu * vv - uv * uv
    second, third = (vv * wu - uv * wv) / determinant, (uu * wv - uv * wu) / determinant
    return np.stack([1.0 - second - third, second, third], axis=1)


def _angles(corners: Points) -> npt.NDArray[np.float64]:
    """Return the angles (n, 3) of triangles, in rad."""
    after, before = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    sine = np.linalg.norm(np.cross(after, before), axis=-1)
    return np.arctan2(sine, np.einsum("nki,nki->nk", after, before))


def _kinks(surface: Surface, is_of_part: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Return the edges (n, 3) of a part's triangles where the part ends or has a kink."""
    across = surface.neighbours[is_of_part]
    cosine = np.einsum("ni,nki->nk", surface.normals[is_of_part], surface.normals[across])
    return np.asarray((across < 0) | ~is_of_part[across] | (cosine < _KINK))


def _stretch(triangles: Indices, corners: Points, is_kink: npt.NDArray[np.bool_]) -> npt.NDArray[np.float64]:
    """Return for each triangle (n,) how many margins a point in the margin is from one outside of it, at most.

    Between two kinks that meet at an angle of a, that is 1 / sin(a / 2). The angle is of all triangles between them.
    """
    count = len(triangles)
    start = np.arange(3 * count).reshape(count, 3)  # a triangle's corner k, whose edges are k and k - 1
    keys = triangles * (triangles.max() + 1)
    joined = ~is_kink
    ends = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1), axis=-1)
    edge_keys = ends[..., 0] * (keys.max() + 1) + ends[..., 1]
    rows, columns = [], []
    order = np.argsort(edge_keys.ravel(), kind="stable")
    order = order[joined.ravel()[order]]
    one, other = order[:-1], order[1:]
    is_shared = edge_keys.ravel()[one] == edge_keys.ravel()[other]
    one, other = one[is_shared], other[is_shared]
    following = np.roll(start, -1, axis=1).ravel()
    flat = triangles.ravel()
    for first in (one, following[one]):
        same = np.where(flat[other] == flat[first], other, following[other])
        rows.append(first)
        columns.append(same)
    graph = coo_matrix((np.ones(2 * len(one)), (np.concatenate(rows), np.concatenate(columns))), 2 * (3 * count,))
    sector = connected_components(graph, directed=False)[1]
    total = np.bincount(sector, _angles(corners).ravel())[sector].reshape(count, 3)
    stretch = 1.0 / np.sin(np.minimum(total, np.pi) / 2.0)
    touches_kink = np.zeros(sector.max() + 1, dtype=bool)
    touches_kink[sector.reshape(count, 3)[is_kink]] = True
    touches_kink[sector.reshape(count, 3)[np.roll(is_kink, 1, axis=1)]] = True
    return np.asarray(np.where(touches_kink[sector].reshape(count, 3), stretch, 1.0).max(axis=1))
