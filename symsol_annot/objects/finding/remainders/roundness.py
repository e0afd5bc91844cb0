"""How far a surface is from a body of revolution, or from a ball: what many facets stand for."""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.distance.distances import SurfaceDistance, point_to_triangle
from symsol_annot.objects.finding.found import CIRCLE, CIRCLE_WITH_HALF_TURNS, Group, Roundness
from symsol_annot.objects.finding.surface import Points, Surface
from symsol_annot.rotations.groups import ALL_ROTATIONS
from symsol_annot.rotations.so3 import Rotations, frame_about, rotations_about

MOST_OFF_ROUND = 0.02  # of the radius: what is farther off is not called round
NEARLY_BALL = 1e-3  # radii off a ball, an eighth of a pixel, that nobody sees
_GENERIC_TURNS = np.array([0.1234, 0.7071, 1.1, 1.9, 2.357, 3.3, 4.04, 5.5])  # rad, not parts of a full turn
_EQUAL = 0.02  # relative difference of two principal moments that an axis of revolution makes equal
_POINTS, _FEW = 240, 16


def roundness(surface: Surface, group: Group) -> Roundness | None:
    """Return the continuous group that a surface nearly has, and how far it is off; None where it is far from any.

    Args:
        surface: its group's fixed point at the origin, in the unit sphere.
        group: of it as it is.
    """
    thickness = off_ball(surface)
    if thickness <= MOST_OFF_ROUND:
        return Roundness(Group(ALL_ROTATIONS, None, np.eye(3)), thickness)
    axis, order = _axis(surface, group)
    if axis is None:
        return None
    distance, points = SurfaceDistance(surface.corners), sample_points(surface, _POINTS)
    turns = rotations_about(axis, np.concatenate([_GENERIC_TURNS, np.pi / max(order, 2) * np.array([1.0, 0.5])]))
    deviation = _deviation(distance, points, turns)
    if deviation > MOST_OFF_ROUND:
        return None
    frame = group.frame if order > 2 else frame_about(axis)
    half_turn = rotations_about(frame[:, 0], np.pi)[None]
    has_half_turns = group.kind == "dihedral" or _deviation(distance, points, half_turn) <= max(2 * deviation, 1e-6)
    return Roundness(Group(CIRCLE_WITH_HALF_TURNS if has_half_turns else CIRCLE, None, frame), deviation)


def sample_points(surface: Surface, count: int) -> Points:
    """Return points of a surface, always the same: vertices and others, mixed."""
    rng = np.random.default_rng(0)
    vertices = surface.vertices[rng.permutation(len(surface.vertices))[: count // 2]]
    chosen = rng.choice(len(surface.areas), size=count // 2, p=surface.areas / surface.areas.sum())
    others = np.einsum("pi,pij->pj", rng.dirichlet(np.ones(3), size=count // 2), surface.corners[chosen])
    points = np.concatenate([vertices, others])
    return points[rng.permutation(len(points))]


def _deviation(distance: SurfaceDistance, points: Points, turns: Rotations) -> float:
    """Return the largest distance of turned points from the surface; that of a few where it is too large already."""
    farthest = 0.0
    for chosen in (points[:_FEW], points):
        turned = (chosen @ np.swapaxes(turns, -1, -2)).reshape(-1, 3)
        farthest = float(distance(turned, MOST_OFF_ROUND, 1e-6).max())
        if farthest > MOST_OFF_ROUND:
            break
    return farthest


def _axis(surface: Surface, group: Group) -> tuple[Points | None, int]:
    """Return the axis (3,) that a surface can be round about, and by how many turns it maps onto itself there."""
    order = group.order or 0
    if group.kind in {"cyclic", "dihedral"} and order > 2:
        return group.frame[:, 2], order
    if group.kind not in {"cyclic", "dihedral"}:
        return None, 0
    centres = surface.corners.mean(axis=1)
    centres = centres - surface.areas @ centres / surface.areas.sum()
    moments, axes = np.linalg.eigh(np.einsum("t,ti,tj->ij", surface.areas, centres, centres))
    gaps: npt.NDArray[np.float64] = np.diff(moments) / moments[-1]
    if gaps.min() > _EQUAL:
        return None, 0
    return axes[:, 2 if gaps[0] < gaps[1] else 0], order


def off_ball(surface: Surface) -> float:
    """Return the difference of the largest and the least distance of a surface from the origin."""
    origin = np.zeros((len(surface.triangles), 3))
    return float(np.linalg.norm(surface.vertices, axis=1).max() - point_to_triangle(origin, surface.corners).min())
