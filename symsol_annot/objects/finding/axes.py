"""Angles and axes of rotations."""

import numpy as np

from symsol_annot.objects.finding.surface import Points
from symsol_annot.rotations.so3 import Angles, Rotations, rotation_to_quat_wxyz


def angles_and_axes(rotations: Rotations) -> tuple[Angles, Points]:
    """Return the angles (n,) in [0, pi] and the unit axes (n, 3) of rotations (n, 3, 3)."""
    quat_wxyz = rotation_to_quat_wxyz(rotations)
    length = np.asarray(np.linalg.norm(quat_wxyz[:, 1:], axis=1), dtype=np.float64)
    angles: Angles = 2.0 * np.asarray(np.arctan2(length, quat_wxyz[:, 0]), dtype=np.float64)
    return angles, quat_wxyz[:, 1:] / np.maximum(length, 1e-300)[:, None]
