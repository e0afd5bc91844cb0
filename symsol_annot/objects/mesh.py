"""Triangle meshes of objects."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

_CONVEX = 2e-7  # radii that a vertex may lie outside a plane: what float32 makes of coordinates
_PRODUCTS = 2**20  # of planes with vertices, held at once
BODY_ID, MARKING_ID = 1, 2  # of the parts; 0 is the background's


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh in model coordinates; the bounding sphere has radius 1 around the origin.

    Attributes:
        vertices: (V, 3) f8.
        triangles: (T, 3) indices of vertices, counter-clockwise seen from outside.
        corner_normals: (T, 3, 3) f8 unit normals, one per corner of a triangle.
        part_ids: (T,) u8, the part that each triangle belongs to: 1 the body, then the others; 0 is the background's.
        breaking: the ids of the parts that break the body's symmetry; together they are the marking.
    """

    vertices: npt.NDArray[np.float64]
    triangles: npt.NDArray[np.intp]
    corner_normals: npt.NDArray[np.float64]
    part_ids: npt.NDArray[np.uint8]
    breaking: tuple[int, ...] = (MARKING_ID,)

    @property
    def is_marking(self) -> npt.NDArray[np.bool_]:
        """(T,) bool, which triangles belong to a part that breaks the body's symmetry."""
        return np.isin(self.part_ids, self.breaking)

    @property
    def parts(self) -> int:
        """How many parts there are, whose ids are 1 up to that."""
        return int(self.part_ids.max())

    @property
    def marking_vertices(self) -> npt.NDArray[np.float64]:
        """The (M, 3) vertices that the marking's triangles use."""
        return self.vertices[np.unique(self.triangles[self.is_marking])]

    def triangles_of(self, part: int) -> npt.NDArray[np.float64]:
        """Return the corners (T, 3, 3) of the triangles of the part of an id."""
        return self.vertices[self.triangles[self.part_ids == part]]


@lru_cache(maxsize=8)
def is_convex(mesh: Mesh) -> bool:
    """Tell whether a closed mesh bounds a convex body: no vertex lies outside the plane of any face."""
    normals, offsets = face_planes(mesh)
    step = max(_PRODUCTS // len(mesh.vertices), 1)
    return all(
        bool((normals[start : start + step] @ mesh.vertices.T <= offsets[start : start + step, None] + _CONVEX).all())
        for start in range(0, len(normals), step)
    )


def face_planes(mesh: Mesh) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return the planes of a mesh's faces, each about once: outward normals (p, 3) and offsets (p,) from the origin."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = (normals * a).sum(axis=1)
    _, first = np.unique(np.column_stack([normals, offsets]).round(6), axis=0, return_index=True)
    return normals[first], offsets[first]
