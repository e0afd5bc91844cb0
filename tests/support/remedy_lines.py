"""The rotations that remedies are tried on, and the line of code that a refusal ends with."""

import numpy as np

from symsol_annot.rotations.so3 import uniform_rotations

IMAGES, M, LEVEL = 12, 5, 1
R = uniform_rotations(IMAGES * M, np.random.default_rng(0)).reshape(IMAGES, M, 3, 3)


def line_of(refused):
    """The last line of a message, which is the code."""
    said = str(refused.value).splitlines()
    assert "; this line " in said[-2], said
    return said[-1].strip()
