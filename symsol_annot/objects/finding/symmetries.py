"""All that is found of a mesh's symmetries: its shape, its parts, how round it is, what is left without some faces."""

import numpy as np

from symsol_annot.objects.finding.ball_parts import parts_of_ball
from symsol_annot.objects.finding.distance.verifying import Verifier
from symsol_annot.objects.finding.find import DEFAULT_TOLERANCE, find_group
from symsol_annot.objects.finding.found import CertifiedGroup, Group, PartSymmetry, Roundness, Symmetries
from symsol_annot.objects.finding.kinds import fitted_group
from symsol_annot.objects.finding.remainders.balls import Ball, ball_limit, ball_of
from symsol_annot.objects.finding.remainders.remainder import NOT_LOOKED_FOR, larger_groups
from symsol_annot.objects.finding.remainders.roundness import roundness
from symsol_annot.objects.finding.search import search_group
from symsol_annot.objects.finding.surface import Flags, Surface
from symsol_annot.rotations.so3 import Rotations


def find_symmetries(
    surface: Surface,
    tolerance: float = DEFAULT_TOLERANCE,
    *,
    round_within: float | None = None,
    looks_for_larger: bool = True,
) -> Symmetries:
    """Return what is found about a surface with parts.

    Args:
        surface: in any unit and place.
        tolerance: how far a symmetry may carry a point from the surface, in radii of the surface about its centre.
        round_within: how far from round a surface of facets may be, in radii, to count as round; None: as it is,
            unless it is a ball as far as anybody sees.
        looks_for_larger: whether to look for larger groups of what is left without some faces.

    Raises:
        ObjectError: it is flat, or like a ball, or what passes is no group at this tolerance.
    """
    ball = ball_of(surface, ball_limit(round_within))
    if ball is not None:
        return _of_ball(surface, ball, tolerance, ball_limit(round_within))
    shape = find_group(surface.without_parts(), tolerance)
    radius = float(np.linalg.norm(surface.vertices - shape.centre, axis=1).max())
    placed = surface.placed(shape.centre, radius)
    nearly = roundness(placed, shape.group)
    if nearly is not None and round_within is not None and nearly.deviation <= round_within:
        shape = _as_round(shape, nearly)
    parts, of_object = _parts(placed, shape.group, max(tolerance, shape.residual))
    larger = larger_groups(surface, shape, nearly, tolerance, ball_limit(round_within)) if looks_for_larger else ()
    missing = NOT_LOOKED_FOR if looks_for_larger else ("larger groups of what is left without some faces",)
    return Symmetries(shape, of_object, parts, nearly, larger, radius, tolerance, missing)


def _of_ball(surface: Surface, ball: Ball, tolerance: float, within: float) -> Symmetries:
    """Return what is found of a ball: it has all rotations, so that no group is larger, whatever is left."""
    parts: tuple[PartSymmetry, ...] = (PartSymmetry(surface.part_names[0], len(surface.triangles), ball.group, 0.0),)
    of_object = ball.group
    if len(surface.part_names) > 1:
        parts, of_object = parts_of_ball(surface.placed(ball.centre, ball.radius), tolerance)
    nearly = Roundness(ball.group, ball.deviation)
    return Symmetries(ball.certified, of_object, parts, nearly, (), ball.radius, within, ())


def _as_round(shape: CertifiedGroup, nearly: Roundness) -> CertifiedGroup:
    return CertifiedGroup(
        nearly.group, shape.centre, nearly.deviation, nearly.deviation, 0, shape.failed, shape.candidates
    )


def _parts(placed: Surface, group: Group, tolerance: float) -> tuple[tuple[PartSymmetry, ...], Group]:
    """Return the parts' stabilisers in the group, and the group of the whole: what maps every part onto itself."""
    count = len(placed.part_names)
    if count == 1:
        return (PartSymmetry(placed.part_names[0], len(placed.triangles), group, 0.0),), group
    R = group.rotations
    R = R[np.argsort(np.linalg.norm(R - np.eye(3), axis=(1, 2)), kind="stable")]
    parts, keeps_all = [], np.ones(len(R), dtype=bool)
    for part in range(count):
        is_of_part = placed.part_of == part
        is_most = placed.areas[is_of_part].sum() > placed.areas[~is_of_part].sum()
        is_compared = is_of_part ^ is_most  # all stays in place, so a part does where all others together do
        verifier = Verifier(placed.chosen(is_compared), tolerance)
        kept = search_group(R, verifier.passes, 1e-4)
        keeps_all &= _is_among(R, kept.elements)
        residual = max((verifier.residual(g) for g in kept.generators), default=0.0)
        parts.append(
            PartSymmetry(placed.part_names[part], int(is_of_part.sum()), _named(kept.elements, group), residual)
        )
    return tuple(parts), _named(R[keeps_all], group)


def _named(elements: Rotations, group: Group) -> Group:
    """Return the group that some of a group's rotations are; the group itself where they are all."""
    return group if len(elements) == len(group.rotations) else fitted_group(elements)


def _is_among(rotations: Rotations, others: Rotations) -> Flags:
    """Tell which of rotations (n, 3, 3) are among others."""
    return np.asarray((rotations.reshape(-1, 9) @ others.reshape(-1, 9).T).max(axis=1) > 3.0 - 1e-9)
