"""The grid's levels as tests need them: made once, and by other arithmetic than the package's."""

import math
from functools import lru_cache

import healpix
import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.rotations import grid

levels_to = {top: pytest.mark.parametrize("level", range(top + 1)) for top in (1, 2, 3, 4)}


@lru_cache
def grid_of(level):
    return grid.equivolumetric_grid(level)


@lru_cache
def index_of(level):
    return grid.GridIndex(level)


@lru_cache
def quaternions_of(level):
    """The (n, 4) quaternions of a level, scalar last, and the tree of them and their negatives."""
    quat_xyzw = Rotation.from_matrix(grid_of(level)).as_quat()
    return quat_xyzw, cKDTree(np.concatenate([quat_xyzw, -quat_xyzw]))


def directions_of(level):
    return 12 * 4**level


def angles_of(level):
    """Azimuth, polar and tilt (n, 3) of every index, in loops."""
    n_side = 2**level
    directions = [healpix.pix2ang(n_side, pixel) for pixel in range(12 * n_side**2)]
    found = []
    for tilt in range(6 * n_side):
        for polar, azimuth in directions:
            found.append([float(azimuth), float(polar), math.radians(60 / n_side * tilt)])
    return np.array(found)


def uniform(count, seed=0):
    return Rotation.random(count, random_state=seed).as_matrix()


def turn_y(angle):
    return np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])


def turn_z(angle):
    return np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])
