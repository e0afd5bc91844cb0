"""The nearest rotations of a finite set, exactly, and of a set that stands for arcs of circles.

One matrix product gives the squared Frobenius distances of all pairs in float64, and eq. 5.6 the angle of the
smallest. Where rounding would show in it, the differences are formed entry by entry.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RotationError
from symsol_annot.rotations.groups import nearest_element
from symsol_annot.rotations.so3 import Angles, Rotations, angle_between, rotations_about

CONTINUOUS_CIRCLE_ORDER = 360  # a circle of steps of 1 degree or less stands for a continuous one
_CLOSE_SQUARED = 1e-4  # 0.4 degrees; from there on the product's rounding is under 1e-13 rad
_ROUNDING = 1e-13  # of the product, and more
_PAIRS_AT_ONCE = 2**18  # 2 MiB, which the caches hold


def nearest_angles(R_a: Rotations, R_b: Rotations) -> Angles:
    """Return, for each of R_a (a, 3, 3), the angle (a,) in rad to the nearest of R_b (b, 3, 3)."""
    step = max(1, _PAIRS_AT_ONCE // len(R_b))
    parts = [R_a[start : start + step] for start in range(0, max(1, len(R_a)), step)]
    return np.concatenate([_angles(part, R_b, _squared_distances(R_b, part)) for part in parts])


def nearest_angles_both_ways(R_a: Rotations, R_b: Rotations) -> tuple[Angles, Angles]:
    """Return the angles from each of R_a to the nearest of R_b, and those back.

    Args:
        R_a: (..., a, 3, 3) rotations, of any number of images.
        R_b: (..., b, 3, 3) rotations of as many.

    Returns:
        (..., a) and (..., b) angles in rad.
    """
    squared = _squared_distances(R_b, R_a)
    return _angles(R_a, R_b, squared), _angles(R_b, R_a, np.swapaxes(squared, -1, -2))


def _squared_distances(R_a: Rotations, R_b: Rotations) -> npt.NDArray[np.float64]:
    """Return |A - B|^2 = |A|^2 + |B|^2 - 2 <A, B> for all pairs (..., a, b), with an error of a few 1e-15.

    It is quicker with more b than a, and so are minima over a.
    """
    a, b = R_a.reshape(*R_a.shape[:-2], 9), R_b.reshape(*R_b.shape[:-2], 9)
    squared: npt.NDArray[np.float64] = (-2.0 * a) @ np.swapaxes(b, -1, -2)
    squared += np.einsum("...i,...i->...", b, b)[..., None, :]
    squared += np.einsum("...i,...i->...", a, a)[..., None]
    return squared


def _angles(R_a: Rotations, R_b: Rotations, squared: npt.NDArray[np.float64]) -> Angles:
    """Return eq. 5.6 of the least of the squared distances (..., b, a) of each of R_a.

    For close rotations they are formed again from differences, entry by entry, which loses nothing to rounding: those
    to all of R_b that may be the nearest, as far as the product can tell.
    """
    least = np.maximum(squared.min(axis=-2), 0.0)
    close = np.nonzero(least < _CLOSE_SQUARED)
    by_row, step = np.swapaxes(squared, -1, -2), max(1, _PAIRS_AT_ONCE // R_b.shape[-3])
    for start in range(0, len(close[0]), step):
        at = tuple(axis[start : start + step] for axis in close)
        row, of_b = np.nonzero(by_row[at] <= least[at][:, None] + _ROUNDING)
        differences = R_a[at][row] - R_b[(*(axis[row] for axis in at[:-1]), of_b)]
        exact = np.full(len(at[0]), np.inf)
        np.minimum.at(exact, row, np.square(differences).sum(axis=(-2, -1)))
        least[at] = exact
    return _angle_of_squared(least)


def _angle_of_squared(squared: npt.NDArray[np.float64]) -> Angles:
    """Return eq. 5.6 of squared Frobenius distances."""
    angles: Angles = 2.0 * np.arcsin(np.minimum(np.sqrt(squared) / (2.0 * np.sqrt(2.0)), 1.0))
    return angles


@dataclass(frozen=True, eq=False)
class Circles:
    """The full circles that a group consists of: g Rot(axis, k step), k = 0 .. n - 1.

    Attributes:
        axis: (3,) of the turns, in model coordinates.
        starts: (c, 3, 3), g of each circle.
        index: (c, n), the group's index of each element.
        isolated: (m, 3, 3) what lies on none of them; nothing of a group, but of a list of candidates perhaps.
        isolated_index: (m,) their indices in it.
    """

    axis: npt.NDArray[np.float64]
    starts: Rotations
    index: npt.NDArray[np.intp]
    isolated: Rotations
    isolated_index: npt.NDArray[np.intp]

    @property
    def step_rad(self) -> float:
        """The angle from one element to the next."""
        return 2.0 * np.pi / self.index.shape[1]


def find_circles(group: Rotations) -> Circles | None:
    """Return the circles of a group (G, 3, 3) that discretises a continuous one; None for any other group.

    It may be a list of candidates, which is no group: rotations of other axes beside circles about one.
    """
    angles = angle_between(group, np.eye(3))
    angles[0] = np.inf  # the identity
    step = group[int(np.argmin(angles))]
    order = round(2.0 * np.pi / float(angles.min())) if len(group) > 1 else 1
    if order < CONTINUOUS_CIRCLE_ORDER:
        return None
    axis = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]])
    axis /= np.linalg.norm(axis)
    index = _full_circles(group, rotations_about(axis, 2.0 * np.pi * np.arange(order) / order))
    if not len(index):
        return None
    isolated = np.setdiff1d(np.arange(len(group)), index)
    return Circles(axis, group[index[:, 0]], index, group[isolated], isolated)


def _full_circles(group: Rotations, circle: Rotations) -> npt.NDArray[np.intp]:
    """Return the indices (c, n) of the g Rot, Rot of a circle (n, 3, 3), that are in a list (G, 3, 3) as a whole."""
    unseen, found = np.ones(len(group), dtype=bool), []
    for first in range(len(group)):
        if unseen[first]:
            try:
                index = nearest_element(group, group[first] @ circle)
            except RotationError:
                continue  # it is isolated
            unseen[index] = False
            found.append(index)
    return np.array(found, dtype=np.intp).reshape(len(found), len(circle))


def angles_to_arcs(
    circles: Circles, R: Rotations, mask: npt.NDArray[np.bool_], R_other: Rotations, to_members: Angles
) -> Angles:
    """Return the angles (m,) in rad from R_other (m, 3, 3) to the arcs that join neighbouring members R g of a set.

    Where the nearest point of a whole circle lies between two members, the angle is to that point; elsewhere the
    nearest is an arc's end, a member.

    Args:
        circles: of the group.
        R: (3, 3) the image's rotation.
        mask: (G,) which g of the group are in the set.
        R_other: what the angles are from.
        to_members: (m,) the angles to the nearest members.
    """
    starts, steps = R @ circles.starts, circles.index.shape[1]
    turn = _turns_to_nearest(circles, starts, R_other)  # (m, c)
    before = turn.astype(int) % steps
    on_circle = mask[circles.index]
    every = np.arange(len(starts))
    on_arc = on_circle[every, before] & on_circle[every, (before + 1) % steps]
    m, c = np.nonzero(on_arc)
    points = starts[c] @ rotations_about(circles.axis, turn[m, c] * circles.step_rad)
    angles = to_members.copy()
    np.minimum.at(angles, m, angle_between(points, R_other[m]))
    return angles


def nearest_angles_on_circles(
    circles: Circles, R: Rotations, mask: npt.NDArray[np.bool_], R_other: Rotations
) -> Angles:
    """Return what `nearest_angles(R_other, members)` does, in time that does not grow with the set.

    On one circle the distance grows with the turn away from the circle's nearest point, so that the nearest member
    is the first to its left or to its right. The trace of R_m^T X of a member R_m = start Rot(axis, phi) is
    a cos(phi) + b sin(phi) + c, and |R_m - X|^2 = 3 + |X|^2 - 2 trace.
    """
    starts, steps = R @ circles.starts, circles.index.shape[1]
    on_axis, cosine, sine = _traces(circles, starts, R_other)
    turns = rotations_about(circles.axis, np.arange(steps) * circles.step_rad)
    cos, sin = np.cos(np.arange(steps) * circles.step_rad), np.sin(np.arange(steps) * circles.step_rad)
    best, nearest = np.full(len(R_other), -np.inf), np.zeros(len(R_other), dtype=np.intp)
    for c, row in enumerate(circles.index):
        if mask[row].any():
            gap = np.floor(np.arctan2(sine[c], cosine[c]) / circles.step_rad).astype(np.intp) % steps
            for neighbour in _neighbours(mask[row]):
                trace = cosine[c] * cos[neighbour][gap] + sine[c] * sin[neighbour][gap] + on_axis[c]
                is_nearer = trace > best
                np.copyto(best, trace, where=is_nearer)
                np.copyto(nearest, c * steps + neighbour[gap], where=is_nearer)
    squared = np.maximum(3.0 + np.einsum("mij,mij->m", R_other, R_other) - 2.0 * best, 0.0)
    close = np.flatnonzero(squared < _CLOSE_SQUARED)
    members = starts[nearest[close] // steps] @ turns[nearest[close] % steps]
    squared[close] = np.square(R_other[close] - members).sum(axis=(-2, -1))
    angles = _angle_of_squared(squared)
    is_member = mask[circles.isolated_index]
    if is_member.any():
        np.minimum(angles, nearest_angles(R_other, R @ circles.isolated[is_member]), out=angles)
    return angles


def _turns_to_nearest(circles: Circles, starts: Rotations, R_other: Rotations) -> npt.NDArray[np.float64]:
    """Return where on each whole circle the point nearest to R_other (m, 3, 3) lies, in steps: (m, c) in [0, n).

    It is where a cos(phi) + b sin(phi) + c is largest: at phi = atan2(b, a).
    """
    _, cosine, sine = _traces(circles, starts, R_other)
    turn: npt.NDArray[np.float64] = np.arctan2(sine, cosine).T / circles.step_rad
    return turn % circles.index.shape[1]


def _traces(
    circles: Circles, starts: Rotations, R_other: Rotations
) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    """Return c, a and b, each (circles, m), of the traces of (start Rot(axis, phi))^T X for X in R_other (m, 3, 3)."""
    n = circles.axis
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    along = np.outer(n, n)
    of_starts = np.stack([starts @ along, starts @ (np.eye(3) - along), starts @ cross]).reshape(-1, 9)
    on_axis, cosine, sine = (of_starts @ R_other.reshape(-1, 9).T).reshape(3, len(starts), len(R_other))
    return on_axis, cosine, sine


def _neighbours(on_circle: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return, for the gap after each step k of a circle, the last member at or before k and the first after it."""
    steps = np.arange(len(on_circle))
    members = np.flatnonzero(on_circle)
    at_or_before = members[np.searchsorted(members, steps, side="right") - 1]  # -1 wraps to the last
    after = members[np.searchsorted(members, steps, side="right") % len(members)]
    return at_or_before, after
