"""Rotations that are far from one another."""

import numpy as np

from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.nearest import nearest_angles
from symsol_annot.rotations.so3 import angle_between, uniform_rotations
from symsol_annot.rotations.spreading import farthest_points


def test_each_rotation_is_as_far_as_can_be_from_those_before_it():
    R = uniform_rotations(200, np.random.default_rng(0))
    chosen = farthest_points(R, 12)
    assert chosen[0] == 0
    for k in range(1, 12):
        distances = np.min([angle_between(R, R[one]) for one in chosen[:k]], axis=0)
        assert distances[chosen[k]] >= distances.max() - 1e-9


def test_all_are_chosen_where_there_are_no_more_and_none_twice():
    R = uniform_rotations(7, np.random.default_rng(0))
    assert sorted(farthest_points(R, 9).tolist()) == list(range(7))
    assert farthest_points(R, 0).tolist() == []
    assert farthest_points(R[:0], 3).tolist() == []


def test_spread_rotations_cover_the_grid_far_better_than_random_ones():
    grid = equivolumetric_grid(2)
    spread = grid[farthest_points(grid, 30)]
    random = uniform_rotations(30, np.random.default_rng(0))
    assert nearest_angles(grid, spread).max() < 0.7 * nearest_angles(grid, random).max()
