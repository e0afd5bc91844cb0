"""Rotations and axes for hypothesis to choose."""

import numpy as np
from hypothesis import assume
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation


@st.composite
def rotations(draw):
    """Any rotation, as scipy sees it; hypothesis is free to choose tiny angles and half turns."""
    quat = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 4)))
    assume(np.linalg.norm(quat) > 1e-3)
    return Rotation.from_quat(quat)


@st.composite
def axes(draw):
    """Any unit vector (3,)."""
    axis = np.array(draw(st.tuples(*[st.floats(-1, 1)] * 3)))
    assume(np.linalg.norm(axis) > 1e-3)
    return axis / np.linalg.norm(axis)
