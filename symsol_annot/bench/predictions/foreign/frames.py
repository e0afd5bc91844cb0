"""The frames that rotations come in, in one table: how each becomes R_m2c of docs/conventions.md."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from symsol_annot.errors import SettingsError
from symsol_annot.rotations.so3 import Rotations, rotations_about
from symsol_annot.system.text.names import did_you_mean

_OPENGL = np.diag([1.0, -1.0, -1.0])  # x right, y up, z backwards
_PYTORCH3D = np.diag([-1.0, -1.0, 1.0])  # x left, y up, z forward
_Y_TO_Z = rotations_about((1.0, 0.0, 0.0), np.pi / 2.0)  # a model that stands on y, stood on z


@dataclass(frozen=True)
class Frame:
    """A way in which rotations differ from R_m2c.

    Attributes:
        words: what it is, as help and docs say it.
        to_ours: from (..., 3, 3) rotations as they are given to R_m2c.
    """

    words: str
    to_ours: Callable[[Rotations], Rotations]


def _transposed(R: Rotations) -> Rotations:
    return np.swapaxes(R, -1, -2)


FRAMES: dict[str, Frame] = {
    "opencv": Frame("R_m2c as it is here: model to camera, camera axes x right, y down, z forward", lambda R: R),
    "transposed": Frame("R_c2m, from camera to model, or matrices for row vectors", _transposed),
    "opengl": Frame("camera axes x right, y up, z backwards, as in OpenGL and Blender", lambda R: _OPENGL @ R),
    "pytorch3d": Frame(
        "matrices for row vectors, camera axes x left, y up, z forward", lambda R: _PYTORCH3D @ _transposed(R)
    ),
    "model-y-up": Frame("a model whose y axis points up where the mesh here has z", lambda R: R @ _Y_TO_Z.T),
    "model-z-up": Frame("a model whose z axis points up where the mesh here has y", lambda R: R @ _Y_TO_Z),
}


def to_opencv(R: Rotations, frames: Sequence[str]) -> Rotations:
    """Return R_m2c (..., 3, 3), given rotations that differ from it by some frames, which are undone in that order.

    Raises:
        SettingsError: there is no such frame.
    """
    for name in frames:
        if name not in FRAMES:
            raise SettingsError(f"there is no frame {name!r}{did_you_mean(name, FRAMES)}")
        R = FRAMES[name].to_ours(R)
    return np.ascontiguousarray(R)
