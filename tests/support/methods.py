"""Methods whose predictions are written to files, also by processes that are started anew."""

import numpy as np

from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

IMAGES = 24  # of the small set that they are written for


def model(degrees, stops_at=None):
    """A method that turns everything by one angle, by which its answers are told; it may fail at an image."""

    def answer(i, *R):
        if i == stops_at:
            raise RuntimeError("out of memory")
        if not R:
            return rotations_about((0, 0, 1), np.radians([degrees]))
        return np.full(len(R[0]), degrees / 360.0) + 0.001 * R[0][:, 0, 0]

    return answer


def random_rotations(count=3):
    return uniform_rotations(IMAGES * count, np.random.default_rng(0)).reshape(IMAGES, count, 3, 3)
