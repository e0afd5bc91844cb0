"""Rotations outside of the group that an object declares, for an audit to draw.

A set is made from candidates of the declared group alone. If the mesh has more symmetries, its pictures do not show it,
unless rotations that nobody declared are drawn as well: those of the group that is found from the mesh, as it is and as
it is without some faces; and random ones near the members.
"""

import numpy as np

from symsol_annot.annotation.symmetry_set import SymmetrySet
from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.claims import find_in_shell
from symsol_annot.objects.checking.shell import shell_of
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rotations.so3 import Angles, Rotations, angle_between, rotations_about

NEAR_MEMBER_RAD = (np.radians(3.0), np.radians(10.0))  # how far the random ones are from a member
_OFF_CENTRE = 1e-3  # radii; what turns about another point than the origin moves the object
_SAME = 1e-3  # Frobenius distance of rotations that are one


def found_outside(spec: ObjectSpec) -> tuple[Rotations, tuple[str, ...]]:
    """Return the rotations of groups found from an object's mesh that its declared group lacks.

    Args:
        spec: the object.

    Returns:
        (n, 3, 3) rotations g, of circles by whole degrees, and in words what was not looked for.
    """
    if spec.has_all_rotations:
        return np.zeros((0, 3, 3)), ()  # no rotation is outside of SO(3)
    try:
        found = find_in_shell(spec, shell_of(spec))
    except ObjectError as error:
        return np.zeros((0, 3, 3)), (str(error),)
    groups = [(found.object, found.shape.centre), *((one.as_it_is, one.centre) for one in found.larger)]
    if found.roundness is not None and found.roundness.deviation <= found.tolerance:
        groups.append((found.roundness.group, found.shape.centre))
    missing = []
    for group, centre in groups:
        R = group.rotations
        is_about_origin = np.linalg.norm((R - np.eye(3)) @ centre, axis=-1) <= _OFF_CENTRE
        step = np.radians(0.5) if group.is_continuous else 0.0
        missing.append(R[is_about_origin & (_angle_to(R, spec.symmetry_group) > step + _SAME)])
    return np.concatenate(missing), found.not_looked_for


def near_members(symmetry_set: SymmetrySet, count: int, rng: np.random.Generator) -> Rotations:
    """Return random rotations (n, 3, 3), at most `count`, of 3 to 10 degrees from members and no nearer to any."""
    members = symmetry_set.members[rng.integers(len(symmetry_set.members), size=count)]
    axes = rng.normal(size=(count, 3))
    low, high = NEAR_MEMBER_RAD
    turns = [rotations_about(axis, angle) for axis, angle in zip(axes, rng.uniform(low, high, count), strict=True)]
    near = members @ np.stack(turns)
    return near[_angle_to(near, symmetry_set.members) >= low - _SAME]


def _angle_to(rotations: Rotations, others: Rotations) -> Angles:
    """Return the angle in rad (n,) from rotations (n, 3, 3) to the nearest of others."""
    nearest = (rotations.reshape(-1, 9) @ others.reshape(-1, 9).T).argmax(axis=1)
    return np.asarray(angle_between(rotations, others[nearest]))
