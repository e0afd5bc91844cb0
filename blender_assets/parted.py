"""The meshes of the objects with parts: a mug, a nut, a screw, a cylinder with two dots, a die and a box."""

from itertools import pairwise

import numpy as np
from symsol_annot_assets.meshes import (
    UP,
    MeshBuilder,
    Points,
    add_between,
    add_hexagonal_side,
    add_turned,
    hexagon,
)
from symsol_annot_assets.published import cube_corners, cylinder

MUG_RADIUS, MUG_WALL, MUG_FLOOR, MUG_HALF = 0.60, 0.10, 0.12, 0.62  # of the cup; half its height
TUBE, BEND, STRAIGHT = 0.07, 0.30, 0.08  # of the handle: its own radius, that of its bend, how far it runs out first
TUBE_FACETS, BEND_STEPS = 24, 32
NUT_HALF, BORE = 0.40, 0.48  # half its height, and the bore's radius
HEAD_RADIUS, SHANK_RADIUS, COUNTERBORE = 0.50, 0.28, 0.36
HEAD_BOTTOM, SHANK_END, FLOOR = 0.34, -0.95, 0.48  # heights; the floor is the counterbore's
INSERT_RADIUS, SOCKET = 0.42, 0.27  # the insert reaches into the head; the socket's circumradius
INSERT_BOTTOM, INSERT_TOP = 0.42, 0.80  # it begins below the floor, and ends below the head's top
DOTS_DEG = (0, 90)  # where the two dots are around the cylinder's axis
PIP, PIP_CORNERS = 0.11, 24  # a pip's radius on the die, whose edge is 2 / sqrt(3)
BOX_HALF = np.array([0.5, 0.5, np.sqrt(0.5)])  # half of each edge

_PIPS = {  # the nine cells of a face in rows; opposite faces have seven pips
    1: "... .o. ...",
    2: "o.. ... ..o",
    3: "o.. .o. ..o",
    4: "o.o ... o.o",
    5: "o.o .o. o.o",
    6: "o.o o.o o.o",
}


def mug() -> MeshBuilder:
    """Return the mug: a cup, round about z, and a handle, a closed surface that reaches into the cup's wall."""
    mesh = MeshBuilder()
    inner, floor = MUG_RADIUS - MUG_WALL, MUG_FLOOR - MUG_HALF
    outside = [(0.0, -MUG_HALF), (MUG_RADIUS, -MUG_HALF), (MUG_RADIUS, MUG_HALF)]
    add_turned(mesh, [*outside, (inner, MUG_HALF), (inner, floor), (0.0, floor)])
    start = MUG_RADIUS - MUG_WALL / 2.0
    turns = np.pi * np.arange(BEND_STEPS + 1) / BEND_STEPS
    bend = [(start + STRAIGHT + BEND * np.sin(a), -BEND * np.cos(a), np.sin(a), -np.cos(a)) for a in turns]
    _add_tube(mesh, [(start, -BEND, 0.0, -1.0), *bend, (start, BEND, 0.0, 1.0)], "handle")
    return mesh


def _add_tube(mesh: MeshBuilder, path: list[tuple[float, float, float, float]], material: str) -> None:
    """Add a tube along a path in the plane y = 0: x and z of its middle, then x and z of the way outwards."""
    angles = 2.0 * np.pi * np.arange(TUBE_FACETS) / TUBE_FACETS
    out = np.array([[out_x, 0.0, out_z] for _, _, out_x, out_z in path])
    normals = np.cos(angles)[:, None] * out[:, None] + np.sin(angles)[:, None] * np.array([0.0, 1.0, 0.0])
    rings = np.array([[x, 0.0, z] for x, z, _, _ in path])[:, None] + TUBE * normals
    for i in range(len(path) - 1):
        for k in range(TUBE_FACETS):
            n = (k + 1) % TUBE_FACETS
            for corners in (((i, k), (i + 1, n), (i + 1, k)), ((i, k), (i, n), (i + 1, n))):
                mesh.add([rings[corner] for corner in corners], [normals[corner] for corner in corners], material)
    for ring in (rings[0], rings[-1]):
        mesh.add_flat(ring, np.array([-1.0, 0.0, 0.0]), material)


def nut() -> MeshBuilder:
    """Return the nut: a hexagonal prism about z that touches the unit sphere, with a round bore."""
    mesh, heights = MeshBuilder(), (-NUT_HALF, NUT_HALF)
    circumradius = float(np.sqrt(1.0 - NUT_HALF**2))
    add_hexagonal_side(mesh, circumradius, heights, 1, "body")
    for z in heights:
        add_between(mesh, hexagon(circumradius) + z * UP, BORE, np.sign(z) * UP)
    add_turned(mesh, [(BORE, NUT_HALF), (BORE, -NUT_HALF)])
    return mesh


def screw() -> MeshBuilder:
    """Return the screw: head and shank, round about z, and in its counterbore a ring with a hexagonal hole."""
    mesh, top = MeshBuilder(), float(np.sqrt(1.0 - HEAD_RADIUS**2))
    shank = [(0.0, SHANK_END), (SHANK_RADIUS, SHANK_END), (SHANK_RADIUS, HEAD_BOTTOM)]
    head = [(HEAD_RADIUS, HEAD_BOTTOM), (HEAD_RADIUS, top), (COUNTERBORE, top), (COUNTERBORE, FLOOR), (0.0, FLOOR)]
    add_turned(mesh, [*shank, *head])
    heights = (INSERT_BOTTOM, INSERT_TOP)
    add_turned(mesh, [(INSERT_RADIUS, z) for z in heights], "socket")
    add_hexagonal_side(mesh, SOCKET, heights, -1, "socket")
    for z, normal in zip(heights, (-UP, UP), strict=True):
        add_between(mesh, hexagon(SOCKET) + z * UP, INSERT_RADIUS, normal, "socket")
    return mesh


def dots() -> MeshBuilder:
    """Return the cylinder with two equal dots, a quarter turn apart."""
    return cylinder(DOTS_DEG, "spots")


def die() -> MeshBuilder:
    """Return the die: a cube with the pips of 1 to 6, of which opposite faces have seven."""
    mesh, half = MeshBuilder(), 1.0 / np.sqrt(3.0)
    for axis, (pips, opposite) in enumerate(((1, 6), (2, 5), (3, 4))):
        for sign, number in ((1, pips), (-1, opposite)):
            across, along, normal = np.roll(np.eye(3), axis + 1, axis=0) * np.array([[sign], [1], [sign]])
            for place, cell in enumerate(_PIPS[number].replace(" ", "")):
                middle = half * ((place % 3 - 1) * 2 / 3 * across + (1 - place // 3) * 2 / 3 * along + normal)
                _add_cell(mesh, middle, np.array([across, along, normal]), half / 3, has_pip=cell == "o")
    return mesh


def _add_cell(mesh: MeshBuilder, middle: Points, axes: Points, half: float, *, has_pip: bool) -> None:
    """Add a square around a middle, with or without a pip; axes (3, 3) lie across, along and out of it."""
    square = middle + half * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]) @ axes
    if not has_pip:
        mesh.add_flat(square, axes[2])
        return
    turns = 2.0 * np.pi * np.arange(PIP_CORNERS) / PIP_CORNERS
    circle = middle + PIP * np.column_stack([np.cos(turns), np.sin(turns), np.zeros_like(turns)]) @ axes
    mesh.add_flat(circle, axes[2], "pips")
    quarter = PIP_CORNERS // 4
    for number, corner in enumerate(square):  # the corner lies over the middle of its quarter of the circle
        arc = [circle[(number * quarter + k) % PIP_CORNERS] for k in range(quarter + 1)]
        for first, second in pairwise(arc):
            mesh.add_flat(np.array([corner, first, second]), axes[2])
        mesh.add_flat(np.array([corner, arc[-1], square[(number + 1) % 4]]), axes[2])


BOX_FACES = {
    "bottom": (0, 0, -1),
    "top": (0, 0, 1),
    "front": (1, 0, 0),
    "back": (-1, 0, 0),
    "left": (0, -1, 0),
    "right": (0, 1, 0),
}


def box() -> MeshBuilder:
    """Return the box, which is square about z and longer along it: each face is a part."""
    mesh, corners = MeshBuilder(), np.sign(cube_corners()) * BOX_HALF
    for name, direction in BOX_FACES.items():
        normal = np.array(direction, dtype=float)
        face = corners[corners @ normal > 0]
        around = np.cross(normal, face[0] - (face[0] @ normal) * normal)
        beside = face - face.mean(axis=0)
        order = np.argsort(np.arctan2(beside @ around, beside @ np.cross(around, normal)))
        mesh.add_flat(face[order], normal, name)
    return mesh
