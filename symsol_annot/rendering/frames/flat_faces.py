"""Flat faces of many triangles, triangulated anew: what a rasteriser draws of them is the same, in half the time.

A fan around a cap's centre has hundreds of slivers that meet in one point, and a rasteriser looks at every small block
of points once for each triangle that touches it. Cutting off every second corner, again and again, leaves few slivers.
"""

from collections import defaultdict

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.renderer import BODY

Triangles = npt.NDArray[np.intp]

_LEAST_TRIANGLES = 16
_FLAT = 1e-9  # what a vertex may lie off a face's plane, in bounding-sphere radii
_CONVEX = 1e-9  # twice the least area of three corners in a row


def with_few_slivers(mesh: Mesh) -> Mesh:
    """Return a mesh with the same surface and the same corners of every flat face, of which the body's are cut anew.

    A face is cut where its boundary is one strictly convex polygon; vertices inside it are used no more. Other parts
    stay as they are: a marking's triangles are what `annotation.visibility` reasons about.
    """
    kept = np.ones(len(mesh.triangles), bool)
    triangles, normals = [], []
    for members in _flat_faces(mesh):
        polygon = _boundary(mesh.triangles[members]) if len(members) >= _LEAST_TRIANGLES else None
        normal = mesh.corner_normals[members[0], 0]
        if polygon is not None and _is_convex(mesh.vertices[polygon], normal):
            cut = cut_polygon(polygon)
            kept[members] = False
            triangles.append(cut)
            normals.append(np.broadcast_to(normal, (len(cut), 3, 3)))
    return Mesh(
        mesh.vertices,
        np.concatenate([mesh.triangles[kept], *triangles]),
        np.concatenate([mesh.corner_normals[kept], *normals]),
        np.concatenate([mesh.part_ids[kept], *(np.full(len(cut), BODY, np.uint8) for cut in triangles)]),
        mesh.breaking,
    )


def cut_polygon(polygon: list[int]) -> Triangles:
    """Return triangles (k - 2, 3) of a convex polygon of k corners: every second corner cut off, until none is left."""
    triangles = []
    while len(polygon) > 2:
        ears = range(0, len(polygon) - 1, 2) if len(polygon) > 3 else range(1)
        triangles += [(polygon[i], polygon[i + 1], polygon[(i + 2) % len(polygon)]) for i in ears]
        polygon = polygon[::2] if len(polygon) > 3 else []
    return np.array(triangles, dtype=np.intp)


def _flat_faces(mesh: Mesh) -> list[list[int]]:
    """Return the body's triangles in connected groups of one plane and one normal, in the order of their first ones."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = (normals * a).sum(axis=1)
    is_flat = (np.abs(mesh.corner_normals - normals[:, None]).max(axis=(1, 2)) <= _FLAT) & (mesh.part_ids == BODY)
    beyond: dict[tuple[int, int], int] = {}
    for number in np.flatnonzero(is_flat).tolist():
        beyond |= dict.fromkeys(_sides(mesh.triangles[number].tolist()), number)
    faces, seen = [], np.zeros(len(mesh.triangles), bool)
    for first in np.flatnonzero(is_flat).tolist():
        face, reached = [], [] if seen[first] else [first]
        while reached:
            number = reached.pop()
            if seen[number]:
                continue
            seen[number] = True
            face.append(number)
            others = (beyond.get((end, start)) for start, end in _sides(mesh.triangles[number].tolist()))
            reached += [
                other
                for other in others
                if other is not None
                and np.abs(normals[other] - normals[first]).max() <= _FLAT
                and abs(offsets[other] - offsets[first]) <= _FLAT
            ]
        if face:
            faces.append(sorted(face))
    return faces


def _sides(corners: list[int]) -> list[tuple[int, int]]:
    a, b, c = corners
    return [(a, b), (b, c), (c, a)]


def _boundary(triangles: Triangles) -> list[int] | None:
    """Return the corners of a face in turn, from the lowest number on; None where its boundary is not one polygon."""
    sides = {side for corners in triangles.tolist() for side in _sides(corners)}
    following = defaultdict(list)
    for start, end in sides:
        if (end, start) not in sides:
            following[start].append(end)
    if not following or any(len(ends) != 1 for ends in following.values()):
        return None
    polygon = [min(following)]
    while (end := following[polygon[-1]][0]) != polygon[0]:
        polygon.append(end)
    return polygon if len(polygon) == len(following) else None


def _is_convex(corners: npt.NDArray[np.float64], normal: npt.NDArray[np.float64]) -> bool:
    """Tell whether a polygon (k, 3), counter-clockwise seen against its normal, is strictly convex."""
    sides = np.roll(corners, -1, axis=0) - corners
    turns = np.cross(sides, np.roll(sides, -1, axis=0)) @ normal
    angles = np.arctan2(turns, (sides * np.roll(sides, -1, axis=0)).sum(axis=1))
    return bool((turns > _CONVEX).all() and abs(angles.sum() - 2.0 * np.pi) < 1e-6)
