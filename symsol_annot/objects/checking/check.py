"""Has an object's mesh the symmetries that its object.toml declares, and no others?

What is declared is not believed: symmetry sets are made from it, and an audit of their pictures could draw only
rotations that it names. So the group is found from the mesh, and compared.
"""

from dataclasses import dataclass

import numpy as np

from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.any_part import refuse_parts_that_fix_no_rotation
from symsol_annot.objects.checking.claims import (
    certify_ball,
    find_in_shell,
    group_field,
    refuse_balls,
    refuse_other_group,
    what_is_undecided,
    what_it_has,
)
from symsol_annot.objects.checking.shading import refuse_other_shading
from symsol_annot.objects.checking.shell import breaks_itself, shell_of
from symsol_annot.objects.finding.found import Symmetries
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.objects.spec import ObjectSpec, is_builtin
from symsol_annot.objects.surface import SURFACE_POINTS, SURFACE_TOLERANCE, Points, surface_offsets, surface_points
from symsol_annot.rotations.so3 import Rotations

_ELEMENTS = 12
_FEW_POINTS = 8  # most elements move one of a few points off the marking
_MAX_DISTANCES = 2**28  # of turned points to triangles of the marking: about 20 s


@dataclass(frozen=True)
class Checked:
    """What a check found, for whoever renders the object to read.

    Attributes:
        group: the group in words; None of a built-in object, whose declarations were compared before it was shipped.
        residual: how far the surface is from having it, in radii.
        notes: what may be there and was not looked for, and what another tolerance would decide otherwise; whole lines.
    """

    group: str | None
    residual: float
    notes: tuple[str, ...]


def check_object(spec: ObjectSpec, *, compares_builtin: bool = False) -> Checked:
    """Check what an object declares of its mesh: the group, the stabiliser, and that any part fixes the rotation.

    Args:
        spec: the object.
        compares_builtin: whether the groups of built-in objects are found and compared as well; this takes a second
            for what was compared before they were shipped.

    Raises:
        ObjectError: the surface or the marking lacks a declared symmetry, or has one that is not declared; or some part
            of the marking, seen alone, fixes less than was declared; or this cannot be told.
    """
    _refuse_fine_markings(spec)
    shell = shell_of(spec)
    if spec.has_all_rotations:
        return Checked(None if is_builtin(spec) else "SO(3)", certify_ball(spec, shell), ())
    refuse_balls(spec, shell)
    off = 0.0 if breaks_itself(spec) else _farthest_off(spec, shell)
    allowed = max(SURFACE_TOLERANCE, spec.max_offset)
    if is_builtin(spec) and not compares_builtin and off <= allowed:
        _check_marking(spec)
        return Checked(None, off, ())
    found = find_in_shell(spec, shell)
    if not off <= allowed:
        raise ObjectError(_not_invariant(spec, found, off, allowed))
    refuse_other_group(spec, found)
    if spec.max_offset == 0.0:
        refuse_other_shading(spec, shell, _sampled(spec))
    _check_marking(spec)
    unseen = found.not_looked_for
    if spec.marking is not None and not spec.has_general_rule:
        unseen += refuse_parts_that_fix_no_rotation(spec)
    notes = (*(f"not looked for: {what}" for what in unseen), *what_is_undecided(found))
    return Checked(what_it_has(found), max(off, found.shape.residual), notes)


def _farthest_off(spec: ObjectSpec, shell: Surface) -> float:
    """Return how far a sample of the declared group carries points off the surface, in radii; all parts are kept."""
    elements = _sampled(spec)
    pieces = [shell.corners[shell.part_of == part] for part in range(len(shell.part_names))]
    return max(float(surface_offsets(surface_points(piece), piece, elements).max()) for piece in pieces)


def _sampled(spec: ObjectSpec) -> Rotations:
    """Return some elements of the declared group (n, 3, 3), the second among them."""
    group = spec.symmetry_group
    return np.concatenate([group[1:2], group[np.unique(np.linspace(0, len(group) - 1, _ELEMENTS).astype(int))]])


def _not_invariant(spec: ObjectSpec, found: Symmetries, off: float, allowed: float) -> str:
    """Return that the surface lacks a declared symmetry, what it has, and what to do."""
    is_of_parts = spec.has_general_rule and spec.marking is not None
    stands_out = (
        " A part that stands out has to be a closed surface of its own, which may reach into the body." * is_of_parts
    )
    nearly = found.roundness
    by_offset = (
        f" To take it for round, write `max_offset = {1.1 * nearly.deviation:.2g}` into [symmetry] of format version 2."
        if nearly is not None and nearly.deviation > allowed
        else ""
    )
    return (
        f"{spec.folder}: the surface of {spec.name!r} is not invariant under {group_field(spec)}: an element of it "
        f"moves points {off:.3g} off the surface (allowed {allowed:g}). The surface has {what_it_has(found)}."
        f"{stands_out} A round body needs a multiple of the group's order of facets, about the group's axis.{by_offset}"
    )


def _refuse_fine_markings(spec: ObjectSpec) -> None:
    """Refuse a marking of format version 1 that would take minutes to check."""
    if spec.has_general_rule:
        return
    triangles = int(np.count_nonzero(spec.mesh.is_marking))
    distances = triangles * (SURFACE_POINTS * len(spec.stabiliser) + _FEW_POINTS * len(spec.symmetry_group))
    if distances > _MAX_DISTANCES:
        raise ObjectError(
            f"{spec.folder}: the marking of {spec.name!r} has {triangles:,} triangles, too many to hold against "
            f"{len(spec.symmetry_group):,} rotations; simplify it to {triangles * _MAX_DISTANCES // distances:,}"
        )


def _check_marking(spec: ObjectSpec) -> None:
    """Check the marking of format version 1 against its stabiliser; that of version 2 is derived."""
    if spec.marking is None or spec.has_general_rule:
        return
    marking: Points = spec.mesh.vertices[spec.mesh.triangles[spec.mesh.is_marking]]
    points = surface_points(marking)
    kept = surface_offsets(points, marking, spec.stabiliser)
    if not kept.max() <= SURFACE_TOLERANCE:
        raise ObjectError(
            f"{spec.folder}: marking.stabiliser moves the marking of {spec.name!r} {kept.max():.3g} off itself "
            f"(allowed {SURFACE_TOLERANCE:g})"
        )
    others = spec.symmetry_group[spec.cosets[1:, 0]]
    suspects = others[surface_offsets(points[-_FEW_POINTS:], marking, others) <= SURFACE_TOLERANCE]
    corners = np.unique(marking.reshape(-1, 3), axis=0)
    extra = surface_offsets(np.concatenate([points, corners]), marking, suspects) <= SURFACE_TOLERANCE
    if extra.any():
        raise ObjectError(
            f"{spec.folder}: {np.count_nonzero(extra) + 1} cosets of marking.stabiliser in body.group map the marking "
            f"of {spec.name!r} onto itself, expected 1: the stabiliser is larger than declared"
        )
