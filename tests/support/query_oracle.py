"""The queries of an image, from the docstring alone."""

import hashlib
import math
import struct

import numpy as np
from scipy.spatial.transform import Rotation


def recomputed(fingerprint, image_index, R_gt, group, compose=lambda R, g: R @ g):
    """An image's queries from the docstring alone, in loops."""
    count = 9 * len(group)
    text = f"symsol-annot queries 1/{fingerprint}/{image_index}"
    numbers = struct.unpack(f"<{24 + count}Q", hashlib.shake_256(text.encode("ascii")).digest(8 * (24 + count)))
    listed = [compose(R_gt, g) for g in group]
    for decoy in range(8):
        u = [number / 2**64 for number in numbers[3 * decoy : 3 * decoy + 3]]
        inner, outer = math.sqrt(1 - u[0]), math.sqrt(u[0])  # Shoemake's x, y, z, w
        alpha, beta = 2 * math.pi * u[1], 2 * math.pi * u[2]
        quat_xyzw = [inner * math.sin(alpha), inner * math.cos(alpha), outer * math.sin(beta), outer * math.cos(beta)]
        decoy_rotation = Rotation.from_quat(quat_xyzw).as_matrix()
        listed += [compose(decoy_rotation, g) for g in group]
    order = sorted(range(count), key=lambda number: numbers[24 + number])
    return np.array([listed[number] for number in order])
