"""Finding all symmetries of a surface."""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.axes import angles_and_axes
from symsol_annot.objects.finding.candidates import Candidates, candidate_rotations, hull_corners
from symsol_annot.objects.finding.distance.verifying import Verifier
from symsol_annot.objects.finding.found import CertifiedGroup, Failed, Group
from symsol_annot.objects.finding.kinds import fitted_group
from symsol_annot.objects.finding.search import SearchResult, search_group
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.rotations.so3 import Rotations

DEFAULT_TOLERANCE = 1e-4  # of the radius: a hundredth of a pixel of an image of 224 pixels
_NEAREST_FAILED = 8  # candidates that are measured in full, to say which came nearest
_MOST_ELEMENTS = 24  # of the group that are measured again, once they are exact
_SMALL_ORDER = 12  # up to which all turns are made of the smallest
_A_TURN = 1e-3  # rad: less is the identity
_POLYHEDRAL_WORDS = 3  # of either of two generators, and their inverses, in a product that makes an element


def find_group(surface: Surface, tolerance: float = DEFAULT_TOLERANCE) -> CertifiedGroup:
    """Return the group of rotations that map a surface onto itself, each part onto itself.

    Args:
        surface: in any unit and place.
        tolerance: how far a symmetry may carry a point from the surface, in radii of the surface about its centre.

    Raises:
        ObjectError: it is flat, or like a ball, or what passes is no group at this tolerance.
    """
    corners = hull_corners(surface.vertices)
    radius = float(np.linalg.norm(corners.points, axis=1).max())
    placed = surface.placed(corners.centroid, radius)
    unit = hull_corners(placed.vertices)
    candidates = candidate_rotations(unit, tolerance)
    verifier = Verifier(placed, tolerance)
    result = search_group(candidates.rotations, verifier.passes, max(1e-3, 10 * tolerance))
    group = fitted_group(result.elements)
    residual = max((verifier.residual(R) for R in _some(group)), default=0.0)
    bound, unbounded = 0.0, 0
    for R, times in generators_of(group):
        farthest, unknown = verifier.bound(R)
        bound, unbounded = bound + times * farthest, max(unbounded, unknown)
    failed = _nearest_failed(candidates, result, verifier, group)
    return CertifiedGroup(group, corners.centroid, residual, bound, unbounded, failed, candidates.tried)


def generators_of(group: Group) -> list[tuple[Rotations, int]]:
    """Return rotations that make a finite group, and how often each is needed at most to make an element."""
    R = group.rotations
    if len(R) == 1:
        return []
    if group.kind in {"cyclic", "dihedral"}:
        order = group.order or 1
        step = max(1, round(np.sqrt(order / 2.0))) if order > _SMALL_ORDER else order
        turns = [(R[1 % order], step // 2)] if order > 1 else []
        turns += [(R[step], -(-order // (2 * step)))] if step < order else []
        return turns + ([(R[order], 1)] if group.kind == "dihedral" else [])
    angle, axis = angles_and_axes(R)
    first = int(np.where(angle > _A_TURN, angle, np.inf).argmin())
    is_other = (np.abs(axis @ axis[first]) < np.cos(0.1)) & (angle > _A_TURN)
    second = int(np.where(is_other, angle, np.inf).argmin())
    return [(R[first], _POLYHEDRAL_WORDS), (R[second], _POLYHEDRAL_WORDS)]


def _some(group: Group) -> list[Rotations]:
    R = group.rotations[1:]
    return [R[index] for index in np.unique(np.linspace(0, len(R) - 1, _MOST_ELEMENTS).astype(int))] if len(R) else []


def _nearest_failed(candidates: Candidates, result: SearchResult, verifier: Verifier, group: Group) -> Failed | None:
    rotations = np.concatenate([result.refuted, candidates.refuted])
    at_least = np.concatenate([result.refuted_by, candidates.refuted_by])
    is_other = _distance_from(group, rotations) > 0.05
    rotations, at_least = rotations[is_other], at_least[is_other]
    order = np.argsort(at_least)[:_NEAREST_FAILED]
    if not len(order):
        return None
    known = np.concatenate([result.refuted_by, np.zeros(len(candidates.refuted))])[is_other]  # corners are no points
    measured = [max(verifier.residual(rotations[index]), float(known[index])) for index in order]
    best = int(np.argmin(measured))
    angle, axis = angles_and_axes(rotations[order[best]][None])
    x, y, z = axis[0].tolist()
    return Failed(float(angle[0]), (x, y, z), measured[best])


def _distance_from(group: Group, rotations: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return the Frobenius distance (n,) of rotations from the nearest element of a group."""
    if not len(rotations):
        return np.zeros(0)
    largest = (rotations.reshape(-1, 9) @ group.rotations.reshape(-1, 9).T).max(axis=1)
    return np.sqrt(np.maximum(6.0 - 2.0 * largest, 0.0))
