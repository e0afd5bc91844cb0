"""The surface whose symmetries are looked for: triangles with parts, welded, without doubles and slivers of no area."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from symsol_annot.errors import ObjectError
from symsol_annot.objects.mesh import Mesh

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_WELD = 1e-8  # vertices nearer than this part of the size are one: exporters write each triangle's corners anew
_NO_AREA = 1e-12  # of a triangle's longest edge, squared: it has no direction


@dataclass(frozen=True, eq=False)
class Surface:
    """Triangles in space, each of a part.

    Attributes:
        vertices: (V, 3) f8, in the mesh's own unit and frame, all of them used.
        triangles: (T, 3) indices of vertices.
        part_of: (T,) the index in `part_names` of the part that each triangle belongs to.
        part_names: of the parts.
        source: (T,) the index of each triangle in the mesh that it came from.
    """

    vertices: Points
    triangles: Indices
    part_of: Indices
    part_names: tuple[str, ...]
    source: Indices

    @cached_property
    def corners(self) -> Points:
        """The (T, 3, 3) corners of the triangles."""
        return self.vertices[self.triangles]

    @cached_property
    def areas(self) -> npt.NDArray[np.float64]:
        """The (T,) areas of the triangles."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.asarray(np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2.0)

    @cached_property
    def normals(self) -> Points:
        """The (T, 3) unit normals of the triangles."""
        a, b, c = np.moveaxis(self.corners, 1, 0)
        return np.asarray(np.cross(b - a, c - a) / (2.0 * self.areas[:, None]))

    def placed(self, centre: Points, scale: float) -> "Surface":
        """Return the surface with `centre` (3,) moved to the origin and lengths divided by `scale`."""
        vertices = (self.vertices - centre) / scale
        return Surface(vertices, self.triangles, self.part_of, self.part_names, self.source)

    def chosen(self, is_chosen: Flags) -> "Surface":
        """Return the triangles that (T,) flags choose, as a surface of one part; `source` keeps its meaning."""
        used, triangles = np.unique(self.triangles[is_chosen], return_inverse=True)
        part_of = np.zeros(np.count_nonzero(is_chosen), dtype=np.intp)
        return Surface(self.vertices[used], triangles.reshape(-1, 3), part_of, ("surface",), self.source[is_chosen])

    def without_parts(self) -> "Surface":
        """Return the same triangles, all of one part."""
        return self.chosen(np.ones(len(self.triangles), dtype=bool))

    @cached_property
    def neighbours(self) -> Indices:
        """The (T, 3) triangle across each edge, from corner k to k + 1; -1 where there is none, or more than one."""
        count = len(self.triangles)
        first = np.sort(np.stack([self.triangles, np.roll(self.triangles, -1, axis=1)], axis=-1), axis=-1)
        keys = first[..., 0].ravel() * len(self.vertices) + first[..., 1].ravel()
        order = np.argsort(keys, kind="stable")
        _, starts, times = np.unique(keys[order], return_index=True, return_counts=True)
        across = np.full(3 * count, -1, dtype=np.intp)
        one, other = order[starts[times == 2]], order[starts[times == 2] + 1]
        across[one], across[other] = other // 3, one // 3
        return across.reshape(count, 3)

    @cached_property
    def components(self) -> Indices:
        """The (T,) number of the connected component, by shared vertices, that each triangle belongs to."""
        start, middle, end = self.triangles.T
        rows, columns = np.concatenate([start, middle]), np.concatenate([middle, end])
        graph = coo_matrix((np.ones(len(rows)), (rows, columns)), 2 * (len(self.vertices),))
        return np.asarray(connected_components(graph, directed=False)[1][start], dtype=np.intp)

    @property
    def area_centroid(self) -> Points:
        """The (3,) centroid of the area."""
        return np.asarray(self.areas @ self.corners.mean(axis=1) / self.areas.sum())


def surface_of_mesh(mesh: Mesh) -> Surface:
    """Return the surface of an object's mesh, with the parts `body` and `marking`."""
    names = ("body", "marking") if mesh.is_marking.any() else ("body",)
    return make_surface(mesh.vertices, mesh.triangles, mesh.is_marking.astype(np.intp), names)


def make_surface(vertices: Points, triangles: Indices, part_of: Indices, part_names: Sequence[str]) -> Surface:
    """Return a surface: corners in one place welded, triangles without area or there twice left out.

    Args:
        vertices: (V, 3) f8.
        triangles: (T, 3) indices of vertices.
        part_of: (T,) indices of `part_names`.
        part_names: of the parts.

    Raises:
        ObjectError: there is no triangle with an area, or a part without any.
    """
    if not len(triangles):
        raise ObjectError("the mesh has no triangles: a point cloud or a curve has no surface to compare")
    used, corners = np.unique(triangles, return_inverse=True)
    points = np.asarray(vertices, dtype=np.float64)[used]
    size = float(np.ptp(points, axis=0).max())
    if not np.isfinite(points).all() or size <= 0:
        raise ObjectError("the mesh has vertices that are no numbers, or all in one place")
    first, place = _welded(points, _WELD * size)
    welded = place[corners.reshape(-1, 3)]
    a, b, c = (points[first][welded[:, k]] for k in range(3))
    longest = np.max([np.square(b - a).sum(1), np.square(c - b).sum(1), np.square(a - c).sum(1)], axis=0)
    has_area = np.square(np.cross(b - a, c - a)).sum(axis=1) > _NO_AREA**2 * longest**2
    rows = np.column_stack([np.sort(welded, axis=1), part_of])
    is_first = np.zeros(len(rows), dtype=bool)
    is_first[np.unique(rows, axis=0, return_index=True)[1]] = True
    kept = np.flatnonzero(has_area & is_first)
    if not len(kept):
        raise ObjectError("the mesh has no triangle with an area")
    missing = [name for part, name in enumerate(part_names) if not (part_of[kept] == part).any()]
    if missing:
        raise ObjectError(f"the part {missing[0]!r} has no triangle with an area; leave it out, or give it faces")
    still_used, dense = np.unique(welded[kept], return_inverse=True)
    return Surface(points[first][still_used], dense.reshape(-1, 3), part_of[kept], tuple(part_names), kept)


def _welded(points: Points, distance: float) -> tuple[Indices, Indices]:
    """Return the index of the first of each set of points in one place, and the set (n,) of each point."""
    cells = np.round((points - points.min(axis=0)) / distance).astype(np.int64)
    _, first, place = np.unique(cells, axis=0, return_index=True, return_inverse=True)
    return first, place.reshape(-1)
