"""The built-in objects' groups, and the geometry of their triangles."""

import pytest
from oracle import half_spaces

GROUPS = {"tet": "T", "tetX": "T", "cube": "O", "icosa": "I", "cone": "C360", "cyl": "D360", "cylO": "D360"}
PARTED_GROUPS = {"mug": "C360", "nut": "D6", "screw": "C360", "dots": "D360", "die": "O", "box": "D4"}
BALLS = ("sphereX",)  # whose group is SO(3)
UNMARKED_TWIN = {"tetX": "tet", "cylO": "cyl"}
every_object = pytest.mark.parametrize("name", GROUPS)
every_marked_object = pytest.mark.parametrize("name", UNMARKED_TWIN)


def triangles_of(mesh):
    return mesh.vertices[mesh.triangles]


def height_above(name, points):
    """How far outside of the body's nearest half-space points lie (0 on its surface), and which one it is."""
    normals, offsets = half_spaces(name)
    heights = points @ normals.T - offsets
    return heights.max(axis=-1), heights.argmax(axis=-1)


def boundary_edges(triangles, chosen):
    """The edges (start, end) of the chosen triangles that no other chosen one shares."""
    edges = {(t[i], t[(i + 1) % 3]) for t in triangles[chosen].tolist() for i in range(3)}
    return [(start, end) for start, end in edges if (end, start) not in edges]
