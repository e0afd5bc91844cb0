"""The forms that rotations come in, in one table: how each becomes matrices, and by which shape it is told."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from symsol_annot.bench.predictions.advice.remedies import six_numbers_to_rotation
from symsol_annot.bench.predictions.columns import Array
from symsol_annot.errors import RotationError, SettingsError
from symsol_annot.rotations.so3 import Rotations, quat_wxyz_to_rotation, rotation_deviation
from symsol_annot.system.text.names import did_you_mean

_NEARLY = 0.05  # how far from a rotation a matrix, or from 1 a quaternion's norm, may be that the nearest one is taken
_LONGEST_VECTOR = 2.0 * np.pi + 1e-3  # rad
ORDERS = ("wxyz", "xyzw")


@dataclass(frozen=True)
class Form:
    """A form of rotations.

    Attributes:
        words: what it is, as help and docs say it.
        shapes: the trailing shapes that it has.
        to_matrices: from (..., *shape) numbers, f8, to (..., 3, 3) matrices, which need not be rotations yet.
        is_said: whether the shape alone does not tell it, so that it has to be named.
    """

    words: str
    shapes: tuple[tuple[int, ...], ...]
    to_matrices: Callable[[npt.NDArray[np.float64]], Rotations]
    is_said: bool = False


def _of_poses(x: npt.NDArray[np.float64]) -> Rotations:
    if x.shape[-1] == 16:
        x = x.reshape(*x.shape[:-1], 4, 4)
    return x[..., :3, :3]


def _of_entries(x: npt.NDArray[np.float64]) -> Rotations:
    return x.reshape(*x.shape[: -2 if x.shape[-2:] == (3, 3) else -1], 3, 3)


def _of_vectors(x: npt.NDArray[np.float64]) -> Rotations:
    longest = np.linalg.norm(x, axis=-1).max(initial=0.0)
    if not longest <= _LONGEST_VECTOR:
        raise RotationError(
            f"rotation vectors: expected lengths in rad of at most 2 pi, found {longest:.4g}; "
            "where they are in degrees, convert them with np.radians"
        )
    R: Rotations = Rotation.from_rotvec(x.reshape(-1, 3)).as_matrix().reshape(*x.shape[:-1], 3, 3)
    return R


def _of_columns(x: npt.NDArray[np.float64]) -> Rotations:
    return six_numbers_to_rotation(x)


def _of_rows(x: npt.NDArray[np.float64]) -> Rotations:
    return np.swapaxes(six_numbers_to_rotation(x), -1, -2)


def _of_quaternions(x: npt.NDArray[np.float64]) -> Rotations:
    norms = np.linalg.norm(x, axis=-1)
    if not (np.abs(norms - 1.0) <= _NEARLY).all():
        raise RotationError(
            f"quaternions: expected norms of 1 within {_NEARLY}, found {norms.min():.4g} to {norms.max():.4g}; "
            "divide them by np.linalg.norm(q, axis=-1, keepdims=True) if they are meant as rotations"
        )
    return quat_wxyz_to_rotation(x)


FORMS: dict[str, Form] = {
    "matrix": Form("3x3 matrices, or their 9 entries row by row", ((3, 3), (9,)), _of_entries),
    "pose": Form("4x4 or 3x4 poses, or the 16 entries row by row", ((4, 4), (3, 4), (16,)), _of_poses),
    "quaternion": Form("4 numbers, whose order --order names", ((4,),), _of_quaternions),
    "rotvec": Form("rotation vectors in rad", ((3,),), _of_vectors, is_said=True),
    "6d-columns": Form("6 numbers, the first two columns of a matrix", ((6,),), _of_columns, is_said=True),
    "6d-rows": Form("6 numbers, the first two rows of a matrix, as in PyTorch3D", ((6,),), _of_rows, is_said=True),
}


def to_rotations(given: Array, form: str | None, order: str | None) -> Rotations:
    """Return matrices (..., 3, 3), f8, of rotations in some form.

    Args:
        given: (..., *shape) real numbers.
        form: its name; None to tell it from the order or, where that has one meaning, from the shape.
        order: "wxyz" or "xyzw" for quaternions; there is no default.

    Raises:
        SettingsError: the shape is none of the form, or has several meanings; the message says what to name.
        RotationError: these are no rotations.
    """
    name = form or ("quaternion" if order else _form_of(given.shape))
    if name not in FORMS:
        raise SettingsError(f"there is no form {name!r}{did_you_mean(name, FORMS)}")
    chosen = FORMS[name]
    if not any(given.shape[-len(shape) :] == shape for shape in chosen.shapes):
        shapes = " or ".join(str((..., *shape)).replace("Ellipsis", "...") for shape in chosen.shapes)
        raise SettingsError(f"the form {name!r} has the shape {shapes}, found {given.shape}")
    if (order is not None) != (name == "quaternion"):
        raise SettingsError(
            f"--order belongs to quaternions; these are taken for the form {name!r}"
            if order
            else "quaternions come in two orders, and the file does not say which: --order wxyz where the scalar is "
            "first, --order xyzw where it is last (scipy, ROS)"
        )
    x = given.astype(np.float64)
    if not np.isfinite(x).all():
        raise RotationError(
            f"{_first_row(~np.isfinite(x), len(x))}: NaN or an infinite number, where a rotation belongs"
        )
    if order == "xyzw":
        x = x[..., [3, 0, 1, 2]]
    return _nearest(chosen.to_matrices(x))


def _form_of(shape: tuple[int, ...]) -> str:
    """Return the form that a shape tells."""
    fitting = [name for name, form in FORMS.items() if any(shape[-len(s) :] == s for s in form.shapes)]
    matrices = [name for name in fitting if shape[-2:] in FORMS[name].shapes]
    if matrices:  # three rotation vectors, or three quaternions, have to be named
        return matrices[0]
    if not fitting:
        raise SettingsError(f"no form of rotations ends in the shape {shape[-2:]}; forms are {', '.join(FORMS)}")
    if any(FORMS[name].is_said for name in fitting):
        names = " or ".join(f"--form {name} ({FORMS[name].words})" for name in fitting)
        raise SettingsError(
            f"{shape[-1]} numbers per rotation have more than one meaning: say {names}"
            + (
                "; Euler angles have no form here: convert them with scipy's Rotation.from_euler"
                if shape[-1] == 3
                else ""
            )
        )
    return fitting[0]


def _nearest(R: Rotations) -> Rotations:
    """Return the rotations nearest to matrices that are nearly some."""
    with np.errstate(invalid="ignore"):
        off = rotation_deviation(R)
    off = np.where(np.isnan(off), np.inf, off)
    if off.max(initial=0.0) > _NEARLY:
        row = _first_row(off > _NEARLY, len(R))
        raise RotationError(
            f"{row}: expected rotations (R^T R = I, det R = 1), found a matrix that is off by {off.max():.2g}; "
            "--form names another form of the numbers"
        )
    rough = off > 1e-9
    if rough.any():
        R = R.copy()
        left, _, right = np.linalg.svd(R[rough])
        R[rough] = left @ right
    return R


def _first_row(flags: Array, rows: int) -> str:
    row = int(np.argmax(flags.reshape(rows, -1).any(axis=1)))
    return f"row {row}"
