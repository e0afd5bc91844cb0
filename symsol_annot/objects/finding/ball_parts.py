"""Which rotations keep the parts of a ball in place: of all rotations, those that map every part onto itself."""

import numpy as np

from symsol_annot.objects.finding.find import find_group
from symsol_annot.objects.finding.found import CIRCLE, Group, PartSymmetry, trivial_group
from symsol_annot.objects.finding.kinds import fitted_group
from symsol_annot.objects.finding.surface import Flags, Points, Surface
from symsol_annot.objects.part_symmetries import moments_of, order_about
from symsol_annot.rotations.groups import ALL_ROTATIONS, CIRCLE_STEPS
from symsol_annot.rotations.so3 import frame_about

_OFF_MIDDLE = 1e-3  # radii from the ball's middle, under which a part's centroid gives no direction


def parts_of_ball(placed: Surface, tolerance: float) -> tuple[tuple[PartSymmetry, ...], Group]:
    """Return the parts' stabilisers in SO(3), and the group that keeps all parts in place.

    Args:
        placed: the ball in the unit sphere about the origin, with parts; the largest is what the others leave of it.
        tolerance: how far a rotation may carry a point of a part from it.
    """
    count = len(placed.part_names)
    areas = np.bincount(placed.part_of, placed.areas, minlength=count)
    rest = int(areas.argmax())
    groups = {part: _kept_by(placed, placed.part_of == part, tolerance) for part in range(count) if part != rest}
    whole = _common(list(groups.values()))
    groups[rest] = whole
    sizes = np.bincount(placed.part_of, minlength=count)
    parts = tuple(
        PartSymmetry(name, int(sizes[part]), groups[part], 0.0) for part, name in enumerate(placed.part_names)
    )
    return parts, whole


def _kept_by(placed: Surface, chosen: Flags, tolerance: float) -> Group:
    """Return the rotations about the origin that map some triangles onto themselves.

    Their centroid stays in place, so that they are turns about its line, unless it is the origin itself.
    """
    triangles: Points = placed.corners[chosen]
    _, centroid, _ = moments_of(triangles)
    distance = float(np.linalg.norm(centroid))
    if distance < _OFF_MIDDLE:
        return find_group(placed.chosen(chosen), tolerance).group
    axis = centroid / distance
    order = order_about(axis, triangles)
    return (
        Group(CIRCLE, None, frame_about(axis)) if order == CIRCLE_STEPS else Group("cyclic", order, frame_about(axis))
    )


def _common(groups: list[Group]) -> Group:
    """Return the rotations that are in all groups, of circles those by whole degrees."""
    if not groups:
        return Group(ALL_ROTATIONS, None, np.eye(3))
    smallest = min(groups, key=lambda group: (group.is_continuous, len(group.rotations)))
    if all(group.contains(smallest) for group in groups):
        return smallest
    kept = [R for R in smallest.rotations if all(_is_in(R, group) for group in groups)]
    return fitted_group(np.array(kept)) if len(kept) > 1 else trivial_group()


def _is_in(R: Points, group: Group) -> bool:
    if group.is_continuous:
        return bool(np.linalg.norm(R @ group.frame[:, 2] - group.frame[:, 2]) < 1e-3)
    return bool(np.linalg.norm(group.rotations - R, axis=(1, 2)).min() < 1e-3)
