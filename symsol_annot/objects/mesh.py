"""Triangle meshes of objects."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh in model coordinates; the bounding sphere has radius 1 around the origin.

    Attributes:
        vertices: (V, 3) f8.
        triangles: (T, 3) indices of vertices, counter-clockwise seen from outside.
        corner_normals: (T, 3, 3) f8 unit normals, one per corner of a triangle.
        is_marking: (T,) bool, which triangles carry the marking.
    """

    vertices: npt.NDArray[np.float64]
    triangles: npt.NDArray[np.intp]
    corner_normals: npt.NDArray[np.float64]
    is_marking: npt.NDArray[np.bool_]

    @property
    def part_ids(self) -> npt.NDArray[np.uint8]:
        """(T,) the part that each triangle belongs to: 1 the body, 2 the marking; 0 is the background's id."""
        return np.asarray(1 + self.is_marking, dtype=np.uint8)

    @property
    def parts(self) -> int:
        """How many parts there are, whose ids are 1 up to that."""
        return int(self.part_ids.max())

    @property
    def marking_vertices(self) -> npt.NDArray[np.float64]:
        """The (M, 3) vertices that the marking's triangles use."""
        return self.vertices[np.unique(self.triangles[self.is_marking])]
