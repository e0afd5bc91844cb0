"""The search in the grid: the nearest rotation, and all within an angle."""

import numpy as np
import pytest
from grid_tables import grid_of, index_of, levels_to, uniform
from scipy.spatial.transform import Rotation

from symsol_annot.rotations import grid


def traces(R, rotations):
    """The trace of each relative rotation (n, m): the larger, the nearer."""
    return R.reshape(-1, 9) @ rotations.reshape(-1, 9).T


def half_turns(gap_rad, count=100):
    """Rotations by pi less a gap, about any axes and the ones through a pixel or between two."""
    axes = np.random.default_rng(0).normal(size=(count, 3))
    axes = np.concatenate([axes, np.eye(3), -np.eye(3), [[1, 1, 0], [1, 0, -1], [0, 1, 1]]])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return Rotation.from_rotvec((np.pi - gap_rad) * axes).as_matrix()


NEARBY = {
    "anywhere": lambda level: uniform(200, seed=level),
    "on the grid": lambda level: grid_of(level)[:: max(1, grid.grid_size(level) // 300)],
    "at a half turn": lambda level: half_turns(0.0),
    "just below a half turn": lambda level: half_turns(1e-9),
    "just above a half turn": lambda level: half_turns(-1e-9),
    "around a half turn": lambda level: half_turns(np.random.default_rng(1).normal(scale=0.05, size=(109, 1))),
    "near the identity": lambda level: Rotation.from_rotvec([[0, 0, 0], [1e-9, 0, 0], [0, -1e-9, 1e-12]]).as_matrix(),
}


@levels_to[3]
@pytest.mark.parametrize("place", NEARBY)
def test_nearest_is_as_near_as_any(level, place):
    R = NEARBY[place](level)
    found = index_of(level).nearest(R)
    trace = traces(R, grid_of(level))
    assert (found.shape, found.dtype) == ((len(R),), np.int64)
    np.testing.assert_allclose(trace[np.arange(len(R)), found], trace.max(axis=1), rtol=0, atol=1e-12)


@levels_to[3]
def test_nearest_of_a_rotation_of_the_grid_is_its_index(level):
    np.testing.assert_array_equal(index_of(level).nearest(grid_of(level)), np.arange(grid.grid_size(level)))


@levels_to[2]
def test_nearest_of_a_rotation_moved_by_a_third_of_the_least_gap_is_its_index(level):
    axes = np.random.default_rng(0).normal(size=(grid.grid_size(level), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    moved = Rotation.from_rotvec(np.radians(0.8 * 60 / 2**level) / 3 * axes).as_matrix()
    np.testing.assert_array_equal(index_of(level).nearest(moved @ grid_of(level)), np.arange(len(axes)))


@levels_to[4]
def test_index_knows_its_level_and_rotations(level):
    index = index_of(level)
    assert (index.level, len(index)) == (level, grid.grid_size(level))
    np.testing.assert_array_equal(index.rotations, grid_of(level))


@levels_to[2]
@pytest.mark.parametrize("place", NEARBY)
@pytest.mark.parametrize("angle_deg", [1.234, 7.77, 21.98, 61.11, 123.4, 179.3])
def test_within_finds_what_brute_force_finds(level, place, angle_deg):
    R = NEARBY[place](level)[:25]
    is_near = (traces(R, grid_of(level)) - 1) / 2 >= np.cos(np.radians(angle_deg))
    np.testing.assert_array_equal(index_of(level).within(R, np.radians(angle_deg)), np.flatnonzero(is_near.any(axis=0)))


@levels_to[2]
def test_within_of_several_is_the_union_of_each_once_and_in_order(level):
    R, index = uniform(6, seed=8), index_of(level)
    found = index.within(R, np.radians(40))
    assert found.dtype == np.int64
    assert (np.diff(found) > 0).all()
    assert set(found.tolist()) == set().union(*(index.within(one[None], np.radians(40)).tolist() for one in R))


@levels_to[2]
def test_within_less_than_the_distance_to_the_nearest_is_nothing(level):
    R, index = uniform(50, seed=9), index_of(level)
    nearest = (Rotation.from_matrix(index.rotations[index.nearest(R)]).inv() * Rotation.from_matrix(R)).magnitude()
    for one, angle in zip(R, nearest, strict=True):
        nothing = index.within(one[None], angle - 1e-8)
        assert (nothing.shape, nothing.dtype) == ((0,), np.int64)
        assert index.within(one[None], angle + 1e-8).tolist() == index.nearest(one[None]).tolist()


@levels_to[2]
def test_within_no_angle_of_a_rotation_of_the_grid_is_that_one_and_within_all_angles_is_all(level):
    index = index_of(level)
    for i in range(0, len(index), len(index) // 24):
        assert index.within(grid_of(level)[i][None], 1e-9).tolist() == [i]
        assert len(index.within(grid_of(level)[i][None], np.pi)) == len(index)
