"""The meshes of the published objects: SYMSOL's solids, and two with a marking cut out of their surface."""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from symsol_annot_assets.meshes import FACETS, UP, MeshBuilder, Points, radial, triangulate

CYLINDER_LENGTH_OVER_WIDTH = 1.15
CYLINDER_RADIUS = 1.0 / np.hypot(1.0, CYLINDER_LENGTH_OVER_WIDTH)
CYLINDER_TOP = CYLINDER_LENGTH_OVER_WIDTH * CYLINDER_RADIUS
CONE_BASE_Z = -0.6  # the base circle lies on the unit sphere at this height, the apex at z = 1
DISC_RADIUS = 0.2 * CYLINDER_RADIUS  # along the surface: the disc is a fifth of the cylinder wide
DISC_CENTRE_Z = 0.55
DISC_CORNERS = 96
MARKED_FACE = -np.ones(3) / np.sqrt(3.0)  # the face opposite the corner (1, 1, 1)


def regular_solid(vertices: Points, marked_face_normal: Points | None = None) -> MeshBuilder:
    """Return the convex hull of `vertices` (n, 3), flat shaded; its faces are the supporting planes of 3 or more."""
    mesh = MeshBuilder()
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    found: set[frozenset[int]] = set()
    for triple in combinations(range(len(vertices)), 3):
        a, b, c = vertices[list(triple)]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal) * np.sign(normal @ a or 1.0)
        on_plane = frozenset(np.flatnonzero(np.abs(vertices @ normal - normal @ a) < 1e-9).tolist())
        if on_plane in found or np.any(vertices @ normal > normal @ a + 1e-9):
            continue
        found.add(on_plane)
        corners = _counter_clockwise(vertices[sorted(on_plane)], normal)
        marked = marked_face_normal is not None and bool(normal @ marked_face_normal > 1 - 1e-9)
        for second in range(1, len(corners) - 1):
            mesh.add(corners[[0, second, second + 1]], [normal] * 3, "marking" if marked else "body")
    return mesh


def _counter_clockwise(points: Points, normal: Points) -> Points:
    centre = points.mean(axis=0)
    x = points[0] - centre
    angles = np.arctan2((points - centre) @ np.cross(normal, x), (points - centre) @ x)
    return points[np.argsort(angles)]


def cone() -> MeshBuilder:
    """Return the cone: apex (0, 0, 1), base circle on the unit sphere."""
    mesh = MeshBuilder()
    base_radius, height = np.sqrt(1.0 - CONE_BASE_Z**2), 1.0 - CONE_BASE_Z
    rim = [base_radius * radial(k) + CONE_BASE_Z * UP for k in range(FACETS)]

    def normal(step: float) -> Points:
        return (height * radial(step) + base_radius * UP) / np.hypot(height, base_radius)

    for k in range(FACETS):
        following = (k + 1) % FACETS
        mesh.add([rim[k], rim[following], UP], [normal(k), normal(following), normal(k + 0.5)])
        mesh.add([CONE_BASE_Z * UP, rim[following], rim[k]], [-UP] * 3)
    return mesh


def cylinder(discs: Sequence[int] = (), material: str = "marking") -> MeshBuilder:
    """Return the cylinder about z, a prism of 360 facets, with discs cut out of its side.

    Args:
        discs: the angle of each disc's middle from the x axis, in whole degrees.
        material: of the discs.
    """
    mesh = MeshBuilder()
    for k in range(-FACETS // 2, FACETS // 2):
        for face, polygons in _facet_regions(k, discs, material).items():
            for polygon in polygons:
                for triangle in triangulate(polygon):
                    corners, normals = zip(*(_on_facet(k, part, z) for part, z in triangle), strict=True)
                    mesh.add(corners, normals, face)
        for z in (-CYLINDER_TOP, CYLINDER_TOP):
            rim = [CYLINDER_RADIUS * radial(step) + z * UP for step in (k, k + 1)]
            cap = np.sign(z) * UP
            mesh.add([z * UP, *(rim if z > 0 else rim[::-1])], [cap] * 3)
    return mesh


def _on_facet(k: int, part: float, z: float) -> tuple[Points, Points]:
    """Return the point and the normal at a part (0 to 1) of the way across facet k, at height z."""
    edges = [CYLINDER_RADIUS * radial(k), CYLINDER_RADIUS * radial(k + 1)]
    return (1.0 - part) * edges[0] + part * edges[1] + z * UP, radial(k + part)


def _rectangle(left: float, right: float) -> Points:
    return np.array([[left, -CYLINDER_TOP], [right, -CYLINDER_TOP], [right, CYLINDER_TOP], [left, CYLINDER_TOP]])


def _facet_regions(facet: int, discs: Sequence[int], material: str) -> dict[str, list[Points]]:
    """Cut a facet along the disc that it meets: polygons in (part of the way across, z), counter-clockwise.

    A disc is a circle of DISC_RADIUS around DISC_CENTRE_Z on the unrolled prism. Neighbouring facets share the points
    where the circle crosses their edge, so the cut leaves no crack.
    """
    facet_width = 2.0 * CYLINDER_RADIUS * np.sin(np.pi / FACETS)
    radius = DISC_RADIUS / facet_width  # in facets
    met = [k for disc in discs if (k := _facets_from(disc, facet)) + 1 > -radius and k < radius]
    if not met:
        return {"body": [_rectangle(0.0, 1.0)]}
    (k,) = met
    on_circle = radius * np.cos(2.0 * np.pi * np.arange(DISC_CORNERS // 2 + 1) / DISC_CORNERS)
    inside = on_circle[(on_circle > k + 1e-6) & (on_circle < k + 1 - 1e-6)]
    steps = np.unique([max(k, -radius), min(k + 1, radius), *inside])
    half = facet_width * np.sqrt(np.maximum(radius**2 - steps**2, 0.0))
    upper = np.stack([steps - k, DISC_CENTRE_Z + half], axis=1)
    lower = np.stack([steps - k, DISC_CENTRE_Z - half], axis=1)
    corners = _rectangle(0.0, 1.0)
    if k < -radius:  # the disc's left end lies in this facet
        body = [np.concatenate([corners[:2], lower[::-1], upper[1:], corners[2:]])]
        return {"body": body, material: [np.concatenate([lower, upper[:0:-1]])]}
    if k + 1 > radius:  # its right end
        body = [np.concatenate([corners[:1], corners[1:], upper[:-1], lower[::-1]])]
        return {"body": body, material: [np.concatenate([lower, upper[-2::-1]])]}
    body = [np.concatenate([upper, corners[2:]]), np.concatenate([corners[:2], lower[::-1]])]
    return {"body": body, material: [np.concatenate([lower, upper[::-1]])]}


def _facets_from(disc: int, facet: int) -> int:
    """Return a facet's number counted from a disc's middle, from -FACETS / 2 on."""
    return (facet - disc + FACETS // 2) % FACETS - FACETS // 2


def tetrahedron_corners() -> Points:
    """Return alternating corners (4, 3) of a cube."""
    return np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)


def cube_corners() -> Points:
    """Return the corners (8, 3) of a cube."""
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def icosahedron_corners() -> Points:
    """Return the corners (12, 3) of three golden rectangles."""
    phi = (1.0 + np.sqrt(5.0)) / 2.0
    rectangle = np.array([[0, y, z * phi] for y in (-1, 1) for z in (-1, 1)])
    return np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])
