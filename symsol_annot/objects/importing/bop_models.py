"""A folder of models as BOP has them: which file a model is, and whether the symmetries stated are its mesh's."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError, first_of
from symsol_annot.objects.finding.found import CIRCLE_WITH_HALF_TURNS, Group, Symmetries
from symsol_annot.objects.obj_file import read_object_file
from symsol_annot.rotations.so3 import Rotations, rotations_about

INFO_NAME = "models_info.json"
_MAX_INFO_BYTES = 2**26
_MAX_SYMMETRIES = 100_000
_SHOWN = 8
_OFF = 0.01  # of the radius, and of a rotation's matrix: so exactly BOP's symmetries are taken
_STEPS = np.radians([37.0, 101.0, 163.0])  # of a circle, none of them a part of a full turn


@dataclass(frozen=True, eq=False)
class BopSymmetries:
    """The symmetries x -> R x + t that models_info.json states of a model, in the model's unit.

    Attributes:
        discrete: (n, 4, 4) transformations, without the identity.
        axes: (m, 3) unit vectors, of the circles.
        offsets: (m, 3) a point on each axis.
    """

    discrete: npt.NDArray[np.float64]
    axes: npt.NDArray[np.float64]
    offsets: npt.NDArray[np.float64]

    @property
    def in_words(self) -> str:
        """What they are."""
        counts = [f"{len(self.discrete)} discrete" if len(self.discrete) else "", _circles_in_words(len(self.axes))]
        return " and ".join(count for count in counts if count) or "no symmetry"


def bop_model(folder: Path, number: int | None) -> tuple[Path, BopSymmetries | None]:
    """Return the file of a model, and the symmetries that models_info.json states; None where there is no such file.

    Args:
        folder: of `obj_000001.ply` and its like.
        number: of the model; None where there is only one.

    Raises:
        ObjectError: there is no such model, or models_info.json is broken.
    """
    there = {int(path.stem[4:]): path for path in sorted(folder.glob("obj_*.ply")) if path.stem[4:].isdecimal()}
    if not there:
        raise ObjectError(
            f"{folder}: is a folder without obj_000001.ply or its like, so it is none of BOP's models; give a mesh file"
        )
    if number is None and len(there) > 1:
        raise ObjectError(f"{folder}: has {len(there)} models; say which with --id, one of {_numbers(there)}")
    number = next(iter(there)) if number is None else number
    if number not in there:
        raise ObjectError(f"{folder}: has no model {number}; there are {_numbers(there)}")
    path = folder / INFO_NAME
    return there[number], _read_symmetries(path, number) if path.exists() else None


def compare_with_bop(bop: BopSymmetries, found: Symmetries, of_object: Rotations, path: Path) -> None:
    """Refuse symmetries of BOP's that the mesh has not, and symmetries of the object that BOP does not state.

    Both are moved to the fixed point of what was found: a circle of BOP's may be one of many facets.

    Args:
        bop: what models_info.json states.
        found: of the body.
        of_object: (H, 3, 3) the rotations that leave the object with its parts in place, in the model's frame.
        path: of the model, for messages.

    Raises:
        ObjectError: they contradict each other; the message names both.
    """
    shape = found.shape
    allowed = shape.group if found.roundness is None else found.roundness.group
    fault = _not_found(bop, allowed, shape.centre, found.radius)
    if fault is None and not _are_stated(of_object, bop):
        fault = f"the mesh has {len(of_object)} rotations that leave it in place, and not all of them are stated"
    if fault is not None:
        nearly = "" if allowed is shape.group else f", nearly {allowed.name}"
        raise ObjectError(
            f"{path}: {INFO_NAME} states {bop.in_words}, and the mesh has {shape.group.name}{nearly}: {fault}. "
            "Correct the one that is wrong (`symsol-annot symmetries MESH --bop` writes the file), or take "
            "the symmetries of the mesh: --ignore-bop"
        )


def _not_found(bop: BopSymmetries, group: Group, centre: npt.NDArray[np.float64], radius: float) -> str | None:
    """Return which of BOP's symmetries the group has not, in words; None where it has all."""
    for place, matrix in enumerate(bop.discrete):
        moved = matrix[:3, :3] @ centre + matrix[:3, 3] - centre
        off = float(np.linalg.norm(moved)) / radius
        if off > _OFF:
            return f"number {place + 1} of symmetries_discrete moves the mesh's fixed point by {off:.2g} of its radius"
        if not _contains(group, matrix[:3, :3]):
            return f"number {place + 1} of symmetries_discrete is no rotation of that group"
    for place, (axis, offset) in enumerate(zip(bop.axes, bop.offsets, strict=True)):
        off = float(np.linalg.norm(np.cross(axis, centre - offset))) / radius
        if off > _OFF:
            return f"axis {place + 1} of symmetries_continuous passes the mesh's fixed point at {off:.2g} of its radius"
        if not all(_contains(group, R) for R in rotations_about(axis, _STEPS)):
            return f"the turns about axis {place + 1} of symmetries_continuous are not in that group"
    return None


def _contains(group: Group, R: Rotations) -> bool:
    if group.is_continuous and group.kind != "so3":
        z = group.frame[:, 2]
        along = float(z @ R @ z)
        return along > 1.0 - _OFF or (group.kind == CIRCLE_WITH_HALF_TURNS and along < _OFF - 1.0)
    if group.is_continuous:
        return True
    return bool(np.abs(group.rotations - R).max(axis=(1, 2)).min() <= _OFF)


def _are_stated(rotations: Rotations, bop: BopSymmetries) -> bool:
    """Tell whether each rotation is a product of a discrete symmetry of BOP's and a turn about one of its axes."""
    starts = np.concatenate([np.eye(3)[None], bop.discrete[:, :3, :3]])
    for R in rotations:
        rest = np.swapaxes(starts, -1, -2) @ R
        if np.abs(rest - np.eye(3)).max(axis=(1, 2)).min() <= _OFF:
            continue
        off = [np.linalg.norm(rest @ axis - axis, axis=1).min() for axis in bop.axes]
        if not off or min(off) > _OFF:
            return False
    return True


def _read_symmetries(path: Path, number: int) -> BopSymmetries:
    try:
        entries = json.loads(read_object_file(path, _MAX_INFO_BYTES))
    except (ValueError, RecursionError) as error:
        raise ObjectError(f"{path}: is no JSON: {error}") from None
    entry = entries.get(str(number)) if isinstance(entries, dict) else None
    if not isinstance(entry, dict):
        raise ObjectError(f"{path}: has no entry of the model {number}; add one, or remove the file")
    discrete = _numbers_in(path, entry.get("symmetries_discrete", []), 16, f"{number}.symmetries_discrete")
    circles = entry.get("symmetries_continuous", [])
    if not isinstance(circles, list) or not all(isinstance(one, dict) for one in circles):
        raise ObjectError(f"{path}: {number}.symmetries_continuous: expected a list of tables with axis and offset")
    axes = _numbers_in(path, [one.get("axis") for one in circles], 3, f"{number}.symmetries_continuous, axis")
    offsets = _numbers_in(path, [one.get("offset") for one in circles], 3, f"{number}.symmetries_continuous, offset")
    matrices = discrete.reshape(-1, 4, 4)
    R = matrices[:, :3, :3]
    is_rotation = np.abs(R @ np.swapaxes(R, -1, -2) - np.eye(3)).max(axis=(1, 2), initial=0.0) <= _OFF
    if not (is_rotation & (np.linalg.det(R) > 0)).all():
        raise ObjectError(f"{path}: {number}.symmetries_discrete: an entry is no rotation with a translation")
    lengths = np.linalg.norm(axes, axis=1, keepdims=True)
    if (lengths <= 0).any():
        raise ObjectError(f"{path}: {number}.symmetries_continuous: an axis has no direction")
    return BopSymmetries(matrices, axes / lengths, offsets)


def _numbers_in(path: Path, rows: Any, width: int, where: str) -> npt.NDArray[np.float64]:
    """Return rows (n, width) of finite numbers."""
    is_list = isinstance(rows, list) and len(rows) <= _MAX_SYMMETRIES
    if not is_list or not all(isinstance(row, list) and len(row) == width and _are_finite(row) for row in rows):
        raise ObjectError(f"{path}: {where}: expected lists of {width} numbers each")
    return np.array(rows, dtype=np.float64).reshape(-1, width)


def _are_finite(row: list[Any]) -> bool:
    return all(type(value) in (int, float) and math.isfinite(value) and abs(value) < 1e30 for value in row)


def _numbers(there: dict[int, Path]) -> str:
    return first_of([str(number) for number in there], _SHOWN)


def _circles_in_words(count: int) -> str:
    return f"{count} continuous" if count else ""
