"""Which group rotations are, and the exact group that fits best to rotations that were found with small errors."""

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.axes import angles_and_axes
from symsol_annot.objects.finding.found import CIRCLE_STEPS, Group, trivial_group
from symsol_annot.objects.finding.surface import Points
from symsol_annot.objects.part_symmetries import lands_on
from symsol_annot.objects.surface import SURFACE_TOLERANCE
from symsol_annot.rotations.groups import GROUP_KINDS, icosahedral_group, octahedral_group
from symsol_annot.rotations.so3 import Angles, Rotations, rotations_about

_PARALLEL = np.cos(0.03)
_HALF_TURN = np.radians(170.0)  # of the groups' angles, those beyond it are half turns, or by steps of a large circle
_NO_TURN = 1e-4  # rad: less is none
_DECIMALS = 9  # of vertices, as meshes have them
_LEAST_SHARE = 0.7  # of a group's elements that must be there, or the tolerance has told them apart badly


def fitted_group(elements: Rotations) -> Group:
    """Return the exact group that rotations (n, 3, 3), the identity among them, are up to small errors.

    Raises:
        ObjectError: they are no group.
    """
    angle, axis = angles_and_axes(elements)
    is_turn = angle > 1e-4
    if not is_turn.any():
        return trivial_group()
    angle, axis = angle[is_turn], axis[is_turn]
    main = axis[int(angle.argmin())]
    is_parallel = np.abs(axis @ main) > _PARALLEL
    is_long = ~is_parallel & (angle < _HALF_TURN)
    if is_long.any():
        group = _polyhedral(elements[is_turn], angle, axis)
    else:
        z = _mean_axis(axis[is_parallel], main)
        order = round(2 * np.pi / float(angle.min()))
        across = axis[~is_parallel]
        group = Group("dihedral", order, _dihedral_frame(z, across, order)) if len(across) else _cyclic(z, order)
    if not _LEAST_SHARE * len(group.rotations) <= len(elements) <= len(group.rotations):
        raise ObjectError(
            f"at this tolerance {len(elements)} rotations pass, which are no group: the nearest one, {group.name}, has "
            f"{len(group.rotations)}; state a smaller tolerance, or one that is as large as the mesh is inexact"
        )
    return group


def frame_about(z: Points, x: Points | None = None) -> Rotations:
    """Return the frame (3, 3) with the third column along z, and the first near x; by default near the x axis."""
    z = z / np.linalg.norm(z)
    for wanted in (x, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])):
        if wanted is None:
            continue
        across = wanted - (wanted @ z) * z
        if np.linalg.norm(across) > 0.1:
            across /= np.linalg.norm(across)
            return np.stack([across, np.cross(z, across), z], axis=1)
    return np.eye(3)


def order_about(axis: Points, triangles: Points) -> int:
    """Return how many turns about an axis (3,) map triangles (T, 3, 3) onto themselves; 360 where a circle does.

    They carry the corner farthest from the axis onto others that are as far, so that few have to be tried.
    """
    x, y, _ = (np.unique(triangles.reshape(-1, 3).round(_DECIMALS), axis=0) @ frame_about(axis)).T
    radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
    farthest = azimuth[radius >= radius.max() - SURFACE_TOLERANCE]
    turns = np.sort((farthest - farthest[0]) % (2.0 * np.pi))
    for turn in turns[turns > _NO_TURN].tolist():
        order = round(2.0 * np.pi / turn)
        generator = rotations_about(axis, 2.0 * np.pi / order)
        if abs(2.0 * np.pi / order - turn) * radius.max() <= SURFACE_TOLERANCE and lands_on(
            triangles, triangles, generator
        ):
            return CIRCLE_STEPS if order % CIRCLE_STEPS == 0 else order
    return 1


def _cyclic(z: Points, order: int) -> Group:
    return Group("cyclic", order, frame_about(z))


def _mean_axis(axes: Points, main: Points) -> Points:
    """Return the mean of axes (n, 3), whose signs mean nothing, with its largest coordinate positive."""
    mean = (axes * np.sign(axes @ main)[:, None]).sum(axis=0)
    mean = _plain(mean / np.linalg.norm(mean))
    return mean * np.sign(mean[int(np.abs(mean).argmax())])


def _plain(vector: Points) -> Points:
    """Return a vector whose entries of rounding size are 0."""
    return np.where(np.abs(vector) < 1e-12, 0.0, vector)


def _dihedral_frame(z: Points, half_turns: Points, order: int) -> Rotations:
    """Return the frame with x along the mean axis of half turns, of all those the one next to the x axis."""
    frame = frame_about(z)
    phase = np.arctan2(half_turns @ frame[:, 1], half_turns @ frame[:, 0])
    mean = np.angle(np.exp(2j * order * phase).mean()) / (2 * order)
    steps = mean + np.pi / order * np.arange(2 * order)
    best = steps[np.argmax(np.round(np.cos(steps), 9))]
    return frame_about(z, np.cos(best) * frame[:, 0] + np.sin(best) * frame[:, 1])


def _polyhedral(elements: Rotations, angle: Angles, axis: Points) -> Group:
    folds = np.round(2 * np.pi / angle)
    if (folds == 5).any():
        frame = _icosahedral_frame(axis[np.abs(angle - 2 * np.pi / 5) < 0.1])
        return Group("icosahedral", None, _nearest_frame(frame, icosahedral_group()))
    kind, wanted = ("octahedral", np.pi / 2) if (folds == 4).any() else ("tetrahedral", np.pi)
    found = axis[np.abs(angle - wanted) < 0.1]
    columns = found[_three_across(found)].T
    U, _, Vt = np.linalg.svd(columns)
    frame = U @ Vt
    frame[:, 2] *= np.sign(np.linalg.det(frame))
    frame = _nearest_frame(frame, octahedral_group())
    return Group(kind, None, _fit(frame, GROUP_KINDS[kind].make(), elements))


def _three_across(axes: Points) -> list[int]:
    """Return the indices of three axes (n, 3) that are as good as perpendicular."""
    chosen = [0]
    for index, axis in enumerate(axes):
        if len(chosen) < 3 and (np.abs(axes[chosen] @ axis) < 0.1).all():
            chosen.append(index)
    if len(chosen) < 3:
        raise ObjectError("at this tolerance rotations pass that are no group; state a smaller or a larger one")
    return chosen


def _icosahedral_frame(fives: Points) -> Rotations:
    """Return the frame that carries the standard axes of fifth turns onto those found."""
    phi = (1 + np.sqrt(5)) / 2
    standard = np.array([[0, 1, phi], [0, -1, phi]]) / np.hypot(1, phi)  # neighbours: their cosine is 1 / sqrt 5
    first = fives[0]
    cosines = fives @ first
    second = fives[int(np.abs(np.abs(cosines) - 1 / np.sqrt(5)).argmin())]
    second = second * np.sign(second @ first)
    return frame_about(first, second) @ frame_about(standard[0], standard[1]).T


def _nearest_frame(frame: Rotations, same: Rotations) -> Rotations:
    """Return the frame next to the identity among those that mean the same group."""
    frames = frame @ same
    return np.asarray(frames[int(np.round(np.trace(frames, axis1=1, axis2=2), 9).argmax())])


def _fit(frame: Rotations, standard: Rotations, elements: Rotations) -> Rotations:
    """Return the frame after a step towards the elements (n, 3, 3): their axes on those of the standard group."""
    ideal = frame @ standard @ frame.T
    index = (elements.reshape(-1, 9) @ ideal.reshape(-1, 9).T).argmax(axis=1)
    _, found = angles_and_axes(elements)
    _, wanted = angles_and_axes(ideal[index])
    found = found * np.sign(np.einsum("ni,ni->n", found, wanted))[:, None]
    U, _, Vt = np.linalg.svd(found.T @ wanted)
    turn: npt.NDArray[np.float64] = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return turn @ frame
