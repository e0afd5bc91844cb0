"""Flat convex regions of a surface, such as the caps of a lathe, whatever triangles they are cut into.

The distance to a convex set is a convex function. So a turned triangle is within d of such a region, and of the
surface, if its corners are. Caps that are cut into a fan of slivers need no other bound.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from symsol_annot.objects.finding.surface import Surface

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

_LEAST = 4  # triangles of a region; fewer are bounded as fast one by one
_SAME_PLANE = 1e-9  # of normals, and of levels in radii
_SAME_AREA = 1e-9
_FACING = 0.99  # cosine of the normals of a region and of one that it may be turned onto
_AT_ONCE = 2**20  # corners times edges


@dataclass(frozen=True, eq=False)
class _Region:
    triangles: Indices  # of the surface
    normal: Points  # (3,)
    level: float
    outline: Points  # (m, 3) corners, counter-clockwise seen from outside


class FlatRegions:
    """The flat convex regions of a surface of one part.

    Args:
        surface: about as large as the unit sphere.
    """

    def __init__(self, surface: Surface) -> None:
        self._corners = surface.corners
        self._regions = list(_regions(surface))

    def bounds(self, R: npt.NDArray[np.float64], within: float) -> npt.NDArray[np.float64]:
        """Return how far each triangle (T,), turned by R, is at most from a flat region; inf where no region bounds it.

        Args:
            R: (3, 3) the turn.
            within: bounds beyond it are not looked for.
        """
        found = np.full(len(self._corners), np.inf)
        for region in self._regions:
            normal = R @ region.normal
            for other in self._regions:
                if normal @ other.normal < _FACING or abs(region.level - other.level) > 2 * within:
                    continue
                corners = self._corners[region.triangles] @ R.T
                off = _distances(corners.reshape(-1, 3), other).reshape(-1, 3).max(axis=1)
                found[region.triangles] = np.minimum(found[region.triangles], off)
        found[found > within] = np.inf
        return found


def _regions(surface: Surface) -> Iterator[_Region]:
    levels = np.einsum("ti,ti->t", surface.normals, surface.corners[:, 0])
    planes = np.column_stack([surface.normals, levels])
    across = surface.neighbours
    is_same = (across >= 0) & (np.abs(planes[across] - planes[:, None]).max(axis=-1) <= _SAME_PLANE)
    first, edge = np.nonzero(is_same)
    graph = coo_matrix((np.ones(len(first)), (first, across[first, edge])), 2 * (len(planes),))
    labels = connected_components(graph, directed=False)[1]
    for region in np.flatnonzero(np.bincount(labels) >= _LEAST):
        triangles = np.flatnonzero(labels == region)
        outline = _outline(surface, triangles, is_same)
        if outline is not None and _is_convex(surface, triangles, outline):
            yield _Region(triangles, surface.normals[triangles[0]], float(levels[triangles[0]]), outline)


def _outline(surface: Surface, triangles: Indices, is_inner: npt.NDArray[np.bool_]) -> Points | None:
    """Return the corners (m, 3) around triangles; None where their edges are no single loop."""
    ends = np.stack([surface.triangles[triangles], np.roll(surface.triangles[triangles], -1, axis=1)], axis=-1)
    border = ends[~is_inner[triangles]]
    following = dict(border.tolist())
    if not following or len(following) < len(border):
        return None
    start = int(border[0, 0])
    loop = [start]
    while (corner := following.get(loop[-1])) is not None and corner != start and len(loop) <= len(border):
        loop.append(corner)
    return surface.vertices[loop] if len(loop) == len(border) and corner == start else None


def _is_convex(surface: Surface, triangles: Indices, outline: Points) -> bool:
    """Tell whether triangles fill an outline that turns left at each corner."""
    normal = surface.normals[triangles[0]]
    edges = np.roll(outline, -1, axis=0) - outline
    turns = np.cross(edges, np.roll(edges, -1, axis=0)) @ normal
    from_first = outline - outline[0]
    area = float(np.cross(from_first[:-1], from_first[1:]).sum(axis=0) @ normal) / 2.0
    filled = float(surface.areas[triangles].sum())
    return bool(turns.min() >= -_SAME_PLANE) and abs(area - filled) <= _SAME_AREA * filled


def _distances(points: Points, region: _Region) -> npt.NDArray[np.float64]:
    """Return the distance (n,) of points (n, 3) to a region."""
    edges = np.roll(region.outline, -1, axis=0) - region.outline
    lengths = np.einsum("mi,mi->m", edges, edges)
    inward = np.cross(region.normal, edges) / np.sqrt(lengths)[:, None]
    levels = np.einsum("mi,mi->m", inward, region.outline)
    found = np.empty(len(points))
    for rows in np.array_split(np.arange(len(points)), max(1, len(points) * len(edges) // _AT_ONCE)):
        some = points[rows]
        height = np.abs(some @ region.normal - region.level)
        is_inside = (some @ inward.T >= levels).all(axis=1)
        along = np.clip((some @ edges.T - np.einsum("mi,mi->m", region.outline, edges)) / lengths, 0.0, 1.0)
        nearest = region.outline + along[..., None] * edges
        to_edge = np.linalg.norm(some[:, None] - nearest, axis=-1).min(axis=1)
        found[rows] = np.where(is_inside, height, to_edge)
    return found
