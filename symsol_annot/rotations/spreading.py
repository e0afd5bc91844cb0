"""Rotations of a finite set that are far from one another."""

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import Rotations


def farthest_points(R: Rotations, count: int) -> npt.NDArray[np.int64]:
    """Choose rotations one by one, each as far as can be from those that were chosen (Gonzalez, 1985).

    No choice of as many comes closer to all of R than half as far.

    Args:
        R: (n, 3, 3), of which the first is chosen first.
        count: how many.

    Returns:
        (min(count, n),) their indices.
    """
    flat = R.reshape(-1, 9)
    chosen = [0] if len(flat) else []
    nearest = flat @ flat[0] if chosen else np.zeros(0)  # the trace of A^T B falls with the angle
    while len(chosen) < min(count, len(flat)):
        chosen.append(int(np.argmin(nearest)))
        np.maximum(nearest, flat @ flat[chosen[-1]], out=nearest)
    return np.array(chosen[:count], dtype=np.int64)
