"""The nearest rotations of a finite set, exactly, and of a set that stands for arcs of circles.

The nearest is chosen by the squared Frobenius distance in float64, which one matrix product gives for all pairs;
the angle to it is then computed by eq. 5.6.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.so3 import Angles, Rotations, angle_between, left_cosets, rotations_about

CONTINUOUS_CIRCLE_ORDER = 360  # a circle of steps of 1 degree or less stands for a continuous one
_CLOSE_SQUARED = 1e-9  # below, the product's rounding (1e-15) could choose the wrong one of two
_PAIRS_AT_ONCE = 2**21


def nearest_angles(R_a: Rotations, R_b: Rotations) -> Angles:
    """Return, for each of R_a (a, 3, 3), the angle (a,) in rad to the nearest of R_b (b, 3, 3)."""
    step = max(1, _PAIRS_AT_ONCE // len(R_b))
    parts = []
    for start in range(0, len(R_a), step):
        part = R_a[start : start + step]
        parts.append(_chosen_angles(part, R_b, _squared_distances(part, R_b)))
    return np.concatenate(parts)


def nearest_angles_both_ways(R_a: Rotations, R_b: Rotations) -> tuple[Angles, Angles]:
    """Return the angles (a,) from each of R_a (a, 3, 3) to the nearest of R_b (b, 3, 3), and those (b,) back."""
    squared = _squared_distances(R_a, R_b)
    return _chosen_angles(R_a, R_b, squared), _chosen_angles(R_b, R_a, squared.T)


def _squared_distances(R_a: Rotations, R_b: Rotations) -> npt.NDArray[np.float64]:
    """Return |A - B|^2 = |A|^2 + |B|^2 - 2 <A, B> for all pairs (a, b), with an error of about 1e-15."""
    a, b = R_a.reshape(-1, 9), R_b.reshape(-1, 9)
    left, right = np.empty((len(a), 11)), np.empty((len(b), 11))
    left[:, :9], right[:, :9] = a, -2.0 * b
    left[:, 9], right[:, 9] = 1.0, np.einsum("ij,ij->i", b, b)
    left[:, 10], right[:, 10] = np.einsum("ij,ij->i", a, a), 1.0
    squared: npt.NDArray[np.float64] = left @ right.T
    return squared


def _chosen_angles(R_a: Rotations, R_b: Rotations, squared: npt.NDArray[np.float64]) -> Angles:
    chosen = squared.argmin(axis=1)
    angles = angle_between(R_a, R_b[chosen])
    close = np.flatnonzero(angles * angles < 2.0 * _CLOSE_SQUARED)
    step = max(1, _PAIRS_AT_ONCE // (9 * len(R_b)))
    for start in range(0, len(close), step):
        rows = close[start : start + step]
        angles[rows] = angle_between(R_a[rows, None], R_b[None]).min(axis=1)
    return angles


@dataclass(frozen=True, eq=False)
class Circles:
    """The full circles that a group consists of: g Rot(axis, k step), k = 0 .. n - 1.

    Attributes:
        axis: (3,) of the turns, in model coordinates.
        starts: (c, 3, 3), g of each circle.
        index: (c, n), the group's index of each element.
    """

    axis: npt.NDArray[np.float64]
    starts: Rotations
    index: npt.NDArray[np.intp]

    @property
    def step_rad(self) -> float:
        """The angle from one element to the next."""
        return 2.0 * np.pi / self.index.shape[1]


def find_circles(group: Rotations) -> Circles | None:
    """Return the circles of a group (G, 3, 3) that discretises a continuous one; None for any other group."""
    angles = angle_between(group, np.eye(3))
    angles[0] = np.inf  # the identity
    step = group[int(np.argmin(angles))]
    order = round(2.0 * np.pi / float(angles.min())) if len(group) > 1 else 1
    if order < CONTINUOUS_CIRCLE_ORDER:
        return None
    axis = np.array([step[2, 1] - step[1, 2], step[0, 2] - step[2, 0], step[1, 0] - step[0, 1]])
    axis /= np.linalg.norm(axis)
    index = left_cosets(group, rotations_about(axis, 2.0 * np.pi * np.arange(order) / order))
    return Circles(axis, group[index[:, 0]], index)


def angles_to_arcs(circles: Circles, R: Rotations, mask: npt.NDArray[np.bool_], R_other: Rotations) -> Angles:
    """Return the angles (m,) in rad from R_other (m, 3, 3) to the arcs that join neighbouring members R g of a set.

    Where the nearest point of a whole circle lies between two members, the angle is to that point; elsewhere the
    nearest is an arc's end, a member.

    Args:
        circles: of the group.
        R: (3, 3) the image's rotation.
        mask: (G,) which g of the group are in the set.
        R_other: what the angles are from.
    """
    angles = nearest_angles(R_other, R @ _elements(circles)[mask])
    starts = R @ circles.starts
    turn = _turns_to_nearest(circles, starts, R_other)  # (m, c)
    before = np.floor(turn).astype(int) % circles.index.shape[1]
    after = (before + 1) % circles.index.shape[1]
    for c, row in enumerate(circles.index):
        on_arc = mask[row[before[:, c]]] & mask[row[after[:, c]]]
        points = starts[c] @ rotations_about(circles.axis, turn[:, c] * circles.step_rad)
        angles = np.where(on_arc, np.minimum(angles, angle_between(points, R_other)), angles)
    return angles


def nearest_angles_on_circles(
    circles: Circles, R: Rotations, mask: npt.NDArray[np.bool_], R_other: Rotations
) -> Angles:
    """Return what `nearest_angles(R_other, members)` does, in time that does not grow with the set.

    On one circle the distance grows with the turn away from the circle's nearest point, so that the nearest member
    is the first to its left or to its right.
    """
    starts = R @ circles.starts
    turn = _turns_to_nearest(circles, starts, R_other)
    best = np.full(len(R_other), np.inf)
    for c, row in enumerate(circles.index):
        if mask[row].any():
            for neighbour in _neighbours(mask[row]):
                element = neighbour[np.floor(turn[:, c]).astype(int) % len(row)]
                members = starts[c] @ rotations_about(circles.axis, np.arange(len(row)) * circles.step_rad)
                np.minimum(best, angle_between(R_other, members[element]), out=best)
    return best


def _elements(circles: Circles) -> Rotations:
    """Return the group in its own order."""
    turns = rotations_about(circles.axis, np.arange(circles.index.shape[1]) * circles.step_rad)
    group = np.empty((circles.index.size, 3, 3))
    group[circles.index] = circles.starts[:, None] @ turns
    return group


def _turns_to_nearest(circles: Circles, starts: Rotations, R_other: Rotations) -> npt.NDArray[np.float64]:
    """Return where on each whole circle the point nearest to R_other (m, 3, 3) lies, in steps: (m, c) in [0, n).

    <start Rot(axis, phi), X> = a cos(phi) + b sin(phi) + c, largest at phi = atan2(b, a).
    """
    n = circles.axis
    cross = np.array([[0.0, -n[2], n[1]], [n[2], 0.0, -n[0]], [-n[1], n[0], 0.0]])
    cosine = (starts @ (np.eye(3) - np.outer(n, n))).reshape(-1, 9)
    sine = (starts @ cross).reshape(-1, 9)
    X = R_other.reshape(-1, 9)
    turn: npt.NDArray[np.float64] = np.arctan2(X @ sine.T, X @ cosine.T) / circles.step_rad
    return turn % circles.index.shape[1]


def _neighbours(on_circle: npt.NDArray[np.bool_]) -> tuple[npt.NDArray[np.intp], npt.NDArray[np.intp]]:
    """Return, for the gap after each step k of a circle, the last member at or before k and the first after it."""
    steps = np.arange(len(on_circle))
    members = np.flatnonzero(on_circle)
    at_or_before = members[np.searchsorted(members, steps, side="right") - 1]  # -1 wraps to the last
    after = members[np.searchsorted(members, steps, side="right") % len(members)]
    return at_or_before, after
