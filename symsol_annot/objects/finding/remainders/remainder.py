"""Larger groups of what is left of a surface when some of its faces are taken away.

Where those faces are out of sight, an image has the larger group's symmetries. A mug of one shell has no symmetry, and
a screw with a hex socket six rotations; where handle or socket hide, both have those of a circle. Taken away are parts
and connected components, patches off a surface of revolution that is most of the whole, and what keeps flat faces from
having a finite group.
"""

import numpy as np
from scipy.spatial import cKDTree

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.finding.find import find_group
from symsol_annot.objects.finding.found import (
    CIRCLE,
    CIRCLE_WITH_HALF_TURNS,
    CertifiedGroup,
    Group,
    LargerGroup,
    Roundness,
)
from symsol_annot.objects.finding.remainders.balls import ball_of, without_bumps
from symsol_annot.objects.finding.remainders.patched import off_flat_faces
from symsol_annot.objects.finding.remainders.revolution import Revolution, revolutions
from symsol_annot.objects.finding.remainders.roundness import roundness
from symsol_annot.objects.finding.surface import Flags, Points, Surface
from symsol_annot.rotations.so3 import Rotations, frame_about, rotations_about

NOT_LOOKED_FOR = ("finite groups of what is left of a connected surface that is mostly curved",)
_MOST_SETS = 10  # of components that are taken away, one by one
_CAMERAS = 400
_ONE_TURN = 1e-4  # rad: vertices that are less apart stand above each other
_MOST_FACETS = 3600
_UNEVEN = 0.02  # steps that a facet may be off
_LEAST_LEFT = 0.5  # of the area: what is less does not dominate


def larger_groups(
    surface: Surface, shape: CertifiedGroup, nearly: Roundness | None, tolerance: float, ball_within: float
) -> tuple[LargerGroup, ...]:
    """Return the larger groups of what is left without some faces, those that leave most first.

    Args:
        surface: with its parts.
        shape: its group, whatever the parts.
        nearly: what it nearly is as it is; groups in it are not larger.
        tolerance: of a symmetry, in radii.
        ball_within: how far from a ball what is left may be to count as one, in radii.
    """
    found = [_of_rest(surface, taken, what, shape, tolerance, ball_within) for taken, what in _sets(surface)]
    found.append(without_bumps(surface, ball_within))
    is_known = nearly is not None or any(one is not None and one.group.is_continuous for one in found)
    if not is_known:
        found.append(_off_revolution(surface, shape, tolerance))
    if not any(one is not None for one in found):
        found.append(off_flat_faces(surface, shape, tolerance))
    new = [one for one in found if one is not None and not (nearly is not None and nearly.group.contains(one.group))]
    larger = sorted(new, key=lambda one: -one.area_left)
    distinct: list[LargerGroup] = []
    for one in larger:
        if not any(_holds(other, one) for other in distinct):
            distinct.append(one)
    return tuple(distinct)


def _sets(surface: Surface) -> list[tuple[Flags, str]]:
    """Return sets of triangles to take away, (T,) flags each, and what they are."""
    sets: list[tuple[Flags, str]] = []
    for part, name in enumerate(surface.part_names[1:], start=1):
        sets.append((surface.part_of == part, f"the part {name!r}"))
    if len(surface.part_names) > 2:
        sets.append((surface.part_of > 0, "all parts but the first"))
    labels, sizes = surface.components, np.bincount(surface.components)
    if len(sizes) > 1:
        areas = np.bincount(labels, surface.areas)
        order = np.argsort(areas)[::-1]
        for component in order[1 : 1 + _MOST_SETS]:
            is_taken = labels == component
            sets.append((is_taken, f"a component of {np.count_nonzero(is_taken)} faces"))
        if len(sizes) > 2:
            is_taken = labels != order[0]
            sets.append((is_taken, f"all components but the largest, {np.count_nonzero(is_taken)} faces"))
    return sets


def _of_rest(
    surface: Surface, taken: Flags, what: str, shape: CertifiedGroup, tolerance: float, ball_within: float
) -> LargerGroup | None:
    area_left = float(surface.areas[~taken].sum() / surface.areas.sum())
    if area_left < _LEAST_LEFT:
        return None
    rest = surface.chosen(~taken)
    ball = ball_of(rest, ball_within)
    if ball is not None:
        return LargerGroup(ball.group, ball.group, ball.centre, surface.source[taken], what, area_left, ball.deviation)
    try:
        found = find_group(rest, tolerance)
    except ObjectError:
        return None
    radius = float(np.linalg.norm(rest.vertices - found.centre, axis=1).max())
    group, residual = found.group, found.residual
    nearly = roundness(rest.placed(found.centre, radius), group)
    if nearly is not None and (group.size or 0) < (nearly.group.size or 10**9):
        group, residual = nearly.group, nearly.deviation
    if not _is_larger(group, found.centre, shape, radius):
        return None
    return LargerGroup(group, found.group, found.centre, surface.source[taken], what, area_left, residual)


def _is_larger(group: Group, centre: Points, shape: CertifiedGroup, radius: float) -> bool:
    """Tell whether a group has a rotation that the shape's has not."""
    if group.size == 1:
        return False
    if not shape.group.contains(group):
        return True
    offset = centre - shape.centre
    moved = max(float(np.linalg.norm(R @ offset - offset)) for R in group.rotations[1:8])
    return moved > 0.01 * radius  # about another axis


def _off_revolution(surface: Surface, shape: CertifiedGroup, tolerance: float) -> LargerGroup | None:
    """Return the circle about an axis that most of a surface is round about, without what is not."""
    best: LargerGroup | None = None
    for axis in revolutions(surface, tolerance):
        one = _without_patches(surface, axis, shape)
        if one is not None and (best is None or one.area_left > best.area_left):
            best = one
    return best


def _without_patches(surface: Surface, axis: Revolution, shape: CertifiedGroup) -> LargerGroup | None:
    taken = ~axis.is_round
    area_left = float(surface.areas[~taken].sum() / surface.areas.sum())
    if not taken.any() or area_left < _LEAST_LEFT:
        return None
    rest = surface.chosen(~taken)
    along = (rest.vertices - axis.point) @ axis.direction
    centre = axis.point + axis.direction * (along.max() + along.min()) / 2
    frame = frame_about(axis.direction)
    radius = float(np.linalg.norm(rest.vertices - centre, axis=1).max())
    kind = CIRCLE_WITH_HALF_TURNS if _has_half_turn(rest, centre, radius, frame) else CIRCLE
    group = Group(kind, None, frame)
    if not _is_larger(group, centre, shape, radius) or _shows_its_border(surface, taken, centre, 4 * radius, frame):
        return None
    what = f"{np.count_nonzero(taken)} faces in {_patches(surface, taken)}"
    as_it_is = _of_facets(surface, taken, centre, group)
    return LargerGroup(group, as_it_is, centre, surface.source[taken], what, area_left, axis.deviation)


def _of_facets(surface: Surface, taken: Flags, centre: Points, circle: Group) -> Group:
    """Return the finite group of what is round about an axis but for its facets; the circle where they are uneven.

    Args:
        surface: the whole.
        taken: (T,) the triangles that are taken away, whose corners are no facets'.
        centre: (3,) on the axis.
        circle: with or without half turns.
    """
    kept = np.setdiff1d(surface.triangles[~taken], surface.triangles[taken])
    points = (surface.vertices[kept] - centre) @ circle.frame
    off_axis = np.hypot(points[:, 0], points[:, 1])
    turns = np.sort(np.arctan2(points[:, 1], points[:, 0])[off_axis > 0.1 * off_axis.max()])
    steps = np.diff(turns)
    steps = steps[steps > _ONE_TURN]
    if not len(steps):
        return circle
    order = round(2 * np.pi / float(np.median(steps)))
    places = (turns - turns[0]) * order / (2 * np.pi)
    if not 3 <= order <= _MOST_FACETS or np.abs(places - places.round()).max() > _UNEVEN:
        return circle
    if circle.kind == CIRCLE:
        return Group("cyclic", order, circle.frame)
    tree = cKDTree(points)
    best, least = circle, np.inf
    for phase in turns[0] + np.arange(2) * np.pi / (2 * order):  # half turns about a corner, or about a side
        frame = rotations_about((0, 0, 1), phase)
        flipped = points @ (frame @ np.diag([1.0, -1.0, -1.0]) @ frame.T).T
        off = float(np.median(tree.query(flipped)[0]))
        if off < least:
            best, least = Group("dihedral", order, circle.frame @ frame), off
    return best


def _shows_its_border(surface: Surface, taken: Flags, centre: Points, distance: float, frame: Rotations) -> bool:
    """Tell whether faces can be turned away from a camera, but never without the border of the hole that they leave.

    So it is with the sides of a nut: a view that hides all six shows the hexagon. Faces that cannot be turned away all
    at once, as those of a handle or of a socket, may be hidden by others, border and all.
    """
    index = np.arange(_CAMERAS) + 0.5
    z, turn = 1 - 2 * index / _CAMERAS, np.pi * (1 + np.sqrt(5)) * index
    directions = np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
    level = np.linspace(0, 2 * np.pi, 72, endpoint=False)
    across = np.column_stack([np.cos(level), np.sin(level), np.zeros(len(level))]) @ frame.T
    cameras = centre + distance * np.concatenate([directions, across, frame[:, 2:].T, -frame[:, 2:].T])
    around = np.zeros(len(taken), dtype=bool)
    across_edges = surface.neighbours[taken]
    around[across_edges[across_edges >= 0]] = True
    hides_all = ~_faces_any(surface, taken, cameras)
    shows_border = _faces_any(surface, around & ~taken, cameras)
    return bool(hides_all.any() and shows_border[hides_all].all())


def _faces_any(surface: Surface, chosen: Flags, cameras: Points) -> Flags:
    """Tell of each camera (n, 3) whether it is on the outer side of any of the triangles."""
    normals, levels = (
        surface.normals[chosen],
        np.einsum("ti,ti->t", surface.normals[chosen], surface.corners[chosen, 0]),
    )
    return np.asarray((cameras @ normals.T > levels + 1e-9).any(axis=1))


def _has_half_turn(rest: Surface, centre: Points, radius: float, frame: Rotations) -> bool:
    """Tell whether a half turn across the axis maps most of what is left onto itself: it has holes."""
    placed = rest.placed(centre, radius)
    turn = 2 * np.outer(frame[:, 0], frame[:, 0]) - np.eye(3)
    points = placed.corners.mean(axis=1) @ turn.T
    off = SurfaceDistance(placed.corners)(points, 0.01)
    return float(placed.areas[off <= 0.01].sum() / placed.areas.sum()) > 0.9


def _patches(surface: Surface, taken: Flags) -> str:
    count = int(surface.chosen(taken).components.max()) + 1
    return "1 patch" if count == 1 else f"{count} patches"


def _holds(other: LargerGroup, one: LargerGroup) -> bool:
    """Tell whether another group, of more that is left, says it all."""
    same_faces = len(other.taken_away) <= len(one.taken_away)
    return same_faces and other.group.contains(one.group)
