"""A mesh in an object's frame: the fixed point of its group at the origin, the group's axes as object.toml has them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from symsol_annot.objects.finding.found import CertifiedGroup
from symsol_annot.objects.group_toml import MAX_GROUP_ORDER
from symsol_annot.objects.part_symmetries import carried_onto
from symsol_annot.rotations.groups import CIRCLE_STEPS
from symsol_annot.rotations.so3 import Rotations, rotations_about

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_DIGITS = 12
_EXACT = 1e-7  # of the radius: what is no farther off is as exact as an object has to be
_NEAR = 3.0  # tolerances that a vertex may be from the one that it is carried to
_SOME, _SAME, _MOST = 200, 1e-4, 0.8  # vertices that are turned; how near to others, and how many of them, they come
_MOST_QUERIES = 20_000_000


@dataclass(frozen=True, eq=False)
class Placed:
    """Vertices in an object's frame.

    Attributes:
        vertices: (V, 3) f8; the farthest that is used touches the unit sphere.
        scale: how many of the file's units are one.
        moved: by how much a vertex was moved at most to make the group exact, in radii; 0 where none was.
    """

    vertices: Points
    scale: float
    moved: float


def placed(vertices: Points, is_of_body: Flags, shape: CertifiedGroup, tolerance: float) -> Placed:
    """Return vertices moved, turned and scaled; those of the body evened where the group would not be exact.

    Args:
        vertices: (V, 3) in the file's unit and frame, all used.
        is_of_body: (V,) which of them belong to the surface that has the group.
        shape: the group of that surface, its frame and its fixed point.
        tolerance: that the group was found with.
    """
    moved = (vertices - shape.centre) @ shape.group.frame
    scale = float(np.linalg.norm(moved, axis=1).max())
    unit, by = moved / scale, 0.0
    if shape.residual > _EXACT and len(shape.group.rotations) > 1 and not shape.group.is_continuous:
        standard = shape.group.frame.T @ shape.group.rotations @ shape.group.frame
        even = _evened(unit[is_of_body], standard, _NEAR * tolerance)
        if even is not None:
            by = float(np.linalg.norm(even - unit[is_of_body], axis=1).max())
            unit[is_of_body] = even
            farthest = float(np.linalg.norm(unit, axis=1).max())
            unit, scale = unit / farthest, scale * farthest
    return Placed(np.round(unit, _DIGITS) + 0.0, scale, by)


def _evened(vertices: Points, group: Rotations, distance: float) -> Points | None:
    """Return vertices (n, 3) that a group carries onto each other exactly; None where it carries one to no other."""
    if len(vertices) * len(group) > _MOST_QUERIES:
        return None
    tree = cKDTree(vertices)
    total = np.zeros_like(vertices)
    for R in group:
        off, there = tree.query(vertices @ R.T, distance_upper_bound=distance)
        if not np.isfinite(off).all() or len(np.unique(there)) < len(vertices):
            return None
        total += vertices[there] @ R
    return np.asarray(total / len(group))


def steps_of_circle(vertices: Points) -> int:
    """Return how many steps stand for a circle about z, of a body of facets with vertices (n, 3) in its frame.

    At least 360, and a multiple of the most facets of which a turn by one carries most vertices to vertices.
    """
    reach = np.hypot(vertices[:, 0], vertices[:, 1])
    off_axis = vertices[reach > 0.1 * reach.max()]
    some = off_axis[np.unique(np.linspace(0, len(off_axis) - 1, _SOME).astype(int))]
    tree = cKDTree(vertices)
    for facets in range(MAX_GROUP_ORDER // 4, 2, -1):
        R = rotations_about(np.array([0.0, 0.0, 1.0]), 2.0 * np.pi / facets)
        off, _ = tree.query(some @ R.T, distance_upper_bound=_SAME * reach.max())
        if np.mean(np.isfinite(off)) >= _MOST:
            return facets * -(-CIRCLE_STEPS // facets)
    return CIRCLE_STEPS


def alike_joined(corners: Points, part_of: Indices, body: int, group: Rotations) -> Indices:
    """Return parts (T,) of which those that a group (G, 3, 3) carries onto each other are one, the first of them.

    Args:
        corners: (T, 3, 3) of the triangles, in the group's frame.
        part_of: (T,) the part of each.
        body: the part that stays as it is.
        group: rotations of the body.
    """
    joined = part_of.copy()
    first: list[int] = []
    for part in np.unique(part_of).tolist():
        if part == body:
            continue
        own = corners[part_of == part]
        same = next((one for one in first if carried_onto(corners[part_of == one], own, group).any()), None)
        if same is None:
            first.append(part)
        else:
            joined[part_of == part] = same
    return joined
