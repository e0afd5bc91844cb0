"""The group of rotations that models_info.json states by some of its elements and by axes of circles.

A symmetry of BOP is a rigid motion x -> S x + s of the model. Its rotations S are what a symmetry set is made of.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bop.reading.json_files import numbers, typed
from symsol_annot.errors import DataError, ObjectError
from symsol_annot.objects.finding.found import Group
from symsol_annot.objects.finding.kinds import fitted_group
from symsol_annot.rotations.groups import CIRCLE_STEPS
from symsol_annot.rotations.so3 import (
    Rotations,
    angle_between,
    frame_about,
    nearest_rotations,
    rotation_deviation,
    rotation_to_quat_wxyz,
)

MAX_SYMMETRIES = 7200
_MAX_OFF_SO3 = 1e-3  # of a rotation in the file; the nearest one is taken
_SAME_RAD = 3e-4  # two elements that are nearer are one: files have six digits; of 7,200 turns two are 8.7e-4 apart
_PARALLEL = 1e-3  # sine of the angle between axes that are one, up to six digits
_MOVED = 0.2  # diameters that a symmetry may move the object's centre by: measured models are not exact
_LAST_ROW = (0.0, 0.0, 0.0, 1.0)
Points = npt.NDArray[np.float64]


def symmetry_group(info: dict[str, Any], centre_mm: Points, diameter_mm: float, what: str) -> Rotations:
    """Return the rotations (G, 3, 3), identity first, of the group that an object's symmetries generate.

    Args:
        info: the object's entry of models_info.json.
        centre_mm: (3,) of the object, in model coordinates.
        diameter_mm: of the object.
        what: the entry, in a message.

    Raises:
        DataError: a symmetry is none, or together they are no finite group but for circles about one axis.
    """
    listed = _listed(info, what)
    axes = _axes(info, what)
    for name, moved in (*_discrete_moves(listed, centre_mm, what), *_continuous_moves(axes, centre_mm, what)):
        if moved > _MOVED * diameter_mm:
            raise DataError(
                f"{name}: moves the object's centre by {moved:.3g} mm at a diameter of {diameter_mm:.3g}; no symmetry "
                "does, whatever its order: its translation or offset is wrong, or the model's box is"
            )
    rotations = nearest_rotations(np.array([matrix[:3, :3] for matrix in listed]).reshape(-1, 3, 3))
    group = _with_circle(rotations, [axis for axis, _ in axes], what) if axes else _finite(rotations, what)
    group[0] = np.eye(3)  # exactly
    return group


def _listed(info: dict[str, Any], what: str) -> list[Points]:
    """Return the discrete symmetries as 4x4 matrices."""
    found = []
    entries = typed(info, "symmetries_discrete", list, what) if "symmetries_discrete" in info else []
    if len(entries) > MAX_SYMMETRIES:
        raise DataError(f"{what}: symmetries_discrete: lists {len(entries):,}, more than {MAX_SYMMETRIES:,}")
    for number, entry in enumerate(entries):
        name = f"{what}: symmetries_discrete[{number}]"
        matrix = numbers(entry, 16, name).reshape(4, 4)
        off = float(rotation_deviation(matrix[:3, :3]))
        if not off <= _MAX_OFF_SO3:
            raise DataError(f"{name}: its first three columns are no rotation: off by {off:.3g} ({_MAX_OFF_SO3:g})")
        if not np.array_equal(matrix[3], _LAST_ROW):
            raise DataError(f"{name}: expected 16 numbers row by row, the last four 0, 0, 0, 1")
        found.append(matrix)
    return found


def _axes(info: dict[str, Any], what: str) -> list[tuple[Points, Points]]:
    """Return the unit axis and the offset of each circle."""
    found = []
    entries = typed(info, "symmetries_continuous", list, what) if "symmetries_continuous" in info else []
    for number, entry in enumerate(entries):
        name = f"{what}: symmetries_continuous[{number}]"
        axis = numbers(typed(entry, "axis", list, name), 3, f"{name}: axis")
        offset = numbers(typed(entry, "offset", list, name), 3, f"{name}: offset")
        length = float(np.linalg.norm(axis))
        if length < 1e-6:
            raise DataError(f"{name}: axis: expected a direction, found {axis.tolist()}")
        found.append((axis / length, offset))
    return found


def _discrete_moves(listed: list[Points], centre_mm: Points, what: str) -> list[tuple[str, float]]:
    return [
        (
            f"{what}: symmetries_discrete[{number}]",
            float(np.linalg.norm(matrix[:3, :3] @ centre_mm + matrix[:3, 3] - centre_mm)),
        )
        for number, matrix in enumerate(listed)
    ]


def _continuous_moves(axes: list[tuple[Points, Points]], centre_mm: Points, what: str) -> list[tuple[str, float]]:
    return [
        (f"{what}: symmetries_continuous[{number}]", 2.0 * float(np.linalg.norm(np.cross(axis, centre_mm - offset))))
        for number, (axis, offset) in enumerate(axes)
    ]


def _with_circle(rotations: Rotations, axes: list[Points], what: str) -> Rotations:
    """Return the circle's group, with the half turns that map its axis onto itself where one is listed."""
    axis, half_turn = axes[0], None
    for number, other in enumerate(axes):
        if np.linalg.norm(np.cross(axis, other)) > _PARALLEL:
            raise DataError(
                f"{what}: symmetries_continuous[{number}]: circles about two axes generate all rotations, a ball's, "
                "which no finite set stands for"
            )
    for number, R in enumerate(rotations):
        turned = R @ axis
        if np.linalg.norm(np.cross(axis, turned)) > _PARALLEL:
            raise DataError(
                f"{what}: symmetries_discrete[{number}]: takes the axis of symmetries_continuous to another one; "
                "circles about two axes generate all rotations, a ball's, which no finite set stands for"
            )
        if turned @ axis < 0 and half_turn is None:
            half_turn = rotation_to_quat_wxyz(R)[1:]
    kind = "cyclic" if half_turn is None else "dihedral"
    return Group(kind, CIRCLE_STEPS, frame_about(axis, half_turn)).rotations.copy()


def _finite(rotations: Rotations, what: str) -> Rotations:
    """Return the finite group that rotations (n, 3, 3) generate, fitted to them."""
    elements, generators = np.eye(3)[None], []
    for R in rotations:
        if angle_between(elements, R).min() > _SAME_RAD:
            generators.append(R)
            elements = _products(generators, what)
    try:
        group = fitted_group(elements).rotations.copy()
    except ObjectError:
        group = elements[:1]
    nearest = np.array([angle_between(group, R).min() for R in elements])
    if len(group) != len(elements) or nearest.max() > 10 * _SAME_RAD:
        raise DataError(f"{what}: symmetries_discrete: their {len(elements)} products are no group")
    return group


def _products(generators: list[Rotations], what: str) -> Rotations:
    """Return all products (n, 3, 3) of rotations, the identity first, as far as they differ."""
    least = 3.0 - 4.0 * np.sin(_SAME_RAD / 2.0) ** 2  # of <A, B> of the same: |A - B|^2 = 6 - 2 <A, B>
    found = np.empty((MAX_SYMMETRIES, 9))
    found[0], count, place = np.eye(3).ravel(), 1, 0
    while place < count:
        for generator in generators:
            product = (found[place].reshape(3, 3) @ generator).ravel()
            if (found[:count] @ product).max() < least:
                if count == MAX_SYMMETRIES:
                    raise DataError(
                        f"{what}: symmetries_discrete: have more than {MAX_SYMMETRIES:,} products, so they are no "
                        "finite group of that size; write full turns' parts to six digits, circles as "
                        "symmetries_continuous"
                    )
                found[count] = product
                count += 1
        place += 1
    return found[:count].reshape(-1, 3, 3)
