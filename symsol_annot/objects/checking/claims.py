"""The group that an object.toml declares, held against the one that its mesh has.

A declared group that is too small would leave rotations out of symmetry sets without a word; one that is too large is
no symmetry of the mesh. Looked for are also larger groups of what is left where some faces are out of sight.
"""

import numpy as np

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.found import Group, LargerGroup, Symmetries
from symsol_annot.objects.finding.kinds import fitted_group
from symsol_annot.objects.finding.remainders.roundness import NEARLY_BALL, off_ball
from symsol_annot.objects.finding.report import axis_in_words, is_close
from symsol_annot.objects.finding.surface import Points, Surface
from symsol_annot.objects.finding.symmetries import find_symmetries
from symsol_annot.objects.parts import MOST_OFFSET
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.objects.surface import SURFACE_TOLERANCE
from symsol_annot.rotations.groups import ALL_ROTATIONS, CIRCLE_STEPS

_SAME = 1e-3  # Frobenius distance of elements of a declared and of a found group
_STEP = 0.02  # Frobenius distance, half a step of a circle by degrees and a little more
_SOME = 24  # elements that are held against the centre
_OFF_CENTRE = 1e-3  # radii that a declared rotation may move the fixed point of what was found


def group_field(spec: ObjectSpec) -> str:
    """Return the table of the object.toml that declares the group."""
    return "symmetry" if spec.has_general_rule else "body.group"


def refuse_balls(spec: ObjectSpec, shell: Surface) -> None:
    """Refuse a surface that any rotation leaves as it is, where another group is declared.

    Raises:
        ObjectError: it is a ball about the origin, as far as anybody sees.
    """
    thickness = off_ball(shell)
    if thickness <= max(NEARLY_BALL, spec.max_offset):
        by_offset = f" and max_offset = {1.1 * thickness:.2g}" if thickness > SURFACE_TOLERANCE else ""
        raise ObjectError(
            f"{spec.folder}: {spec.name!r} is a ball within {thickness:.2g} of its radius: any rotation leaves it as "
            f"it is, and symmetry sets by the group that {group_field(spec)} declares would lack nearly all of them. "
            f'Declare kind = "{ALL_ROTATIONS}"{by_offset} in [symmetry] of an object.toml of format version 2'
        )


def certify_ball(spec: ObjectSpec, shell: Surface) -> float:
    """Return how far the surface of an object that declares SO(3) is from a ball about the origin, in radii.

    No rotation about the origin carries a point of it farther off it.

    Raises:
        ObjectError: that is farther than `symmetry.max_offset` allows; the message names the group that it has.
    """
    thickness = off_ball(shell)
    allowed = max(SURFACE_TOLERANCE, spec.max_offset)
    if thickness <= allowed:
        return thickness
    try:
        has = f"The surface has {what_it_has(find_symmetries(shell))}"
    except ObjectError as error:
        has = f"What group it has cannot be told: {error}"
    advice = f", or write `max_offset = {1.1 * thickness:.2g}` to take it for one" * (thickness <= MOST_OFFSET / 1.1)
    raise ObjectError(
        f"{spec.folder}: {group_field(spec)} of {spec.name!r} declares all rotations, but its surface is no ball about "
        f"the origin: it lies between {1.0 - thickness:.4g} and 1 from it (allowed {allowed:g}). {has}. Declare that "
        f"group{advice}"
    )


def find_in_shell(spec: ObjectSpec, shell: Surface) -> Symmetries:
    """Return what is found of the surface that an object declares a group of.

    Raises:
        ObjectError: it has no group that can be told at this tolerance.
    """
    try:
        return find_symmetries(shell)
    except ObjectError as error:
        raise ObjectError(
            f"{spec.folder}: whether {spec.name!r} has the group that {group_field(spec)} declares, and no larger one, "
            f"cannot be told: {error}"
        ) from None


def refuse_other_group(spec: ObjectSpec, found: Symmetries) -> None:
    """Refuse a declared group that lacks rotations which the mesh has, or has where some faces are out of sight.

    A circle is declared by steps: by at least 360 turns about the axis that the mesh is round about.

    Raises:
        ObjectError: the declared group is too small; the message names the one that was found.
    """
    nearly = found.roundness
    is_circle = nearly is not None and nearly.deviation <= max(found.tolerance, spec.max_offset)
    if not _has_all(spec, found.object, found.shape.centre) and not (
        nearly is not None and is_circle and _has_all(spec, nearly.group, found.shape.centre)
    ):
        raise ObjectError(_too_small(spec, found))
    for larger in found.larger:
        is_round = larger.residual <= max(found.tolerance, spec.max_offset)
        groups = (larger.as_it_is, larger.group) if is_round else (larger.as_it_is,)
        if not any(_has_all(spec, group, larger.centre) for group in groups):
            raise ObjectError(_larger_behind_faces(spec, larger))


def what_it_has(found: Symmetries) -> str:
    """Return in words what group a mesh has, and whether it is nearly round."""
    group, nearly = found.object, found.roundness
    axis = f" about {axis_in_words(group.axes[0])}" if group.kind in {"cyclic", "dihedral"} and group.axes else ""
    almost = "" if nearly is None else f", or {nearly.group.name} within {nearly.deviation:.2g} of the radius"
    return f"{group.name}{axis}{almost}"


def what_is_undecided(found: Symmetries) -> tuple[str, ...]:
    """Return in words what another tolerance might decide otherwise."""
    shape, failed = found.shape, found.shape.failed
    if not is_close(shape, found.tolerance):
        return ()
    missed = f"; the next candidate fails by {failed.residual:.2g}" if failed is not None else ""
    return (
        (
            f"close to the tolerance: points are carried {shape.residual:.2g} of the radius off the surface, "
            f"{found.tolerance:g} is allowed{missed}; look at the mesh, another tolerance might decide otherwise"
        ),
    )


def _has_all(spec: ObjectSpec, group: Group, centre: Points) -> bool:
    """Tell whether the declared rotations are all those of a group about a centre (3,), of a circle by steps."""
    if group.kind == ALL_ROTATIONS or (group.is_continuous and len(spec.symmetry_group) < CIRCLE_STEPS):
        return False
    wanted, declared = group.rotations, spec.symmetry_group
    if np.linalg.norm((wanted[:_SOME] - np.eye(3)) @ centre, axis=-1).max() > _OFF_CENTRE:
        return False
    nearest = (wanted.reshape(-1, 9) @ declared.reshape(-1, 9).T).max(axis=1)
    off = np.sqrt(np.maximum(6.0 - 2.0 * nearest, 0.0))
    return bool(off.max() <= (_STEP if group.is_continuous else _SAME))


def _too_small(spec: ObjectSpec, found: Symmetries) -> str:
    count = "more" if found.object.is_continuous else f"{len(found.object.rotations):,}"
    return (
        f"{spec.folder}: {group_field(spec)} of {spec.name!r} declares {_declared(spec)}, but the surface has "
        f"{count}: {what_it_has(found)}. Symmetry sets would lack the others. Declare that "
        "group; `symsol-annot symmetries MESH --write FOLDER` turns a mesh to the axes of object.toml and writes it"
    )


def _larger_behind_faces(spec: ObjectSpec, larger: LargerGroup) -> str:
    group, nearly = larger.as_it_is, larger.group
    if group.kind == ALL_ROTATIONS:
        return (
            f"{spec.folder}: {group_field(spec)} of {spec.name!r} declares {_declared(spec)}, but what is left without "
            f"{larger.what}, {larger.area_left:.0%} of the surface, is a ball, which any rotation leaves as it is. "
            "Where those faces are out of sight, symmetry sets would lack nearly all rotations. Make them a [[part]] "
            "of an object.toml of format version 2, a closed surface of its own that may reach into the ball, and "
            f'declare kind = "{ALL_ROTATIONS}" for the rest'
        )
    by_steps = " A circle is declared by order = 360" * group.is_continuous
    name = (
        group.name if group.kind == nearly.kind or not nearly.is_continuous else f"{group.name}, nearly {nearly.name}"
    )
    return (
        f"{spec.folder}: {group_field(spec)} of {spec.name!r} declares {_declared(spec)}, but what is left without "
        f"{larger.what}, {larger.area_left:.0%} of the surface, has more: {name}. Where those are out of sight, "
        "symmetry sets would lack rotations. Make them a [[part]] of an object.toml of format version 2, which stands "
        f"out as a closed surface of its own or is painted on, and declare {group.name} as the group of the rest; or "
        f"declare it with `of = []`, and all of the mesh is compared.{by_steps}"
    )


def _declared(spec: ObjectSpec) -> str:
    count = len(spec.symmetry_group)
    return f"{fitted_group(spec.symmetry_group).name}, {count:,} rotation{'s' if count > 1 else ''}"
