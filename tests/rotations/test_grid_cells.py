"""The grid's cells: what they are, how large, and how far a rotation can be from its nearest."""

from functools import lru_cache

import healpix
import numpy as np
import pytest
from grid_tables import directions_of, grid_of, index_of, levels_to, quaternions_of, turn_z, uniform
from scipy import stats
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from symsol_annot.rotations import grid

COVERING_RADIUS_DEG = {0: 51.06493, 1: 27.86979, 2: 13.90378, 3: 6.94809, 4: 3.47357}
LARGEST_VOLUME = {0: 1.033, 1: 1.065, 2: 1.054}  # of a Voronoi cell, in units of the mean; measured
SMALLEST_VOLUME = {0: 0.934, 1: 0.978, 2: 0.966}


# --- volume ---


def product_cell_of(level, R):
    """The index whose HEALPix pixel holds the direction, and whose interval holds the tilt, of R (n, 3, 3)."""
    n_side = 2**level
    pixel = healpix.ang2pix(n_side, np.arccos(np.clip(R[:, 2, 2], -1, 1)), np.arctan2(R[:, 1, 2], R[:, 0, 2]))
    tilt = np.arctan2(R[:, 2, 1], -R[:, 2, 0])
    return np.round(tilt / (2 * np.pi / (6 * n_side))).astype(int) % (6 * n_side) * directions_of(level) + pixel


@levels_to[4]
def test_every_rotation_of_the_grid_lies_in_its_own_pixel_and_interval_of_tilt(level):
    np.testing.assert_array_equal(product_cell_of(level, grid_of(level)), np.arange(grid.grid_size(level)))


@levels_to[4]
def test_cell_is_the_product_of_pixel_and_interval_of_tilt(level):
    R = uniform(5_000)
    np.testing.assert_array_equal(grid.cell_of(R, level), product_cell_of(level, R))


@levels_to[4]
def test_rotations_drawn_in_cells_lie_in_them_and_fill_them(level):
    cells = np.repeat(np.array([0, 7, grid.grid_size(level) // 2, grid.grid_size(level) - 1]), 500)
    R = grid.uniform_in_cells(cells, level, np.random.default_rng(0))
    np.testing.assert_array_equal(product_cell_of(level, R), cells)
    finer = product_cell_of(level + 1, R).reshape(4, 500)  # each cell is made of 8, up to half a step of tilt
    assert all(len(np.unique(of_cell)) in (8, 12) for of_cell in finer)


@levels_to[2]
def test_pixels_times_intervals_of_tilt_have_equal_volume(level):
    counts = np.bincount(product_cell_of(level, uniform(300_000)), minlength=grid.grid_size(level))
    assert len(counts) == grid.grid_size(level)
    assert stats.chisquare(counts).pvalue > 1e-3


def cells_first_met(level, direction):
    """How far (m,) a Voronoi cell at tilt 0 reaches in m directions evenly spread.

    From the identity along n, a rotation by t is as far from the neighbour p as from the identity where
    cos(t/2) = p.w cos(t/2) + (p.xyz . n) sin(t/2).
    """
    quat_xyzw, tree = quaternions_of(level)
    twice_as_far = 2 * np.sin(np.radians(120 / 2**level) / 4)
    near = np.unique(np.array(tree.query_ball_point(quat_xyzw[direction], twice_as_far)) % len(quat_xyzw))
    here = Rotation.from_quat(quat_xyzw[direction])
    neighbours = (here.inv() * Rotation.from_quat(quat_xyzw[near[near != direction]])).as_quat(canonical=True)
    i = np.arange(3000) + 0.5
    z, azimuth = 1 - 2 * i / len(i), np.pi * (1 + 5**0.5) * i
    spiral = np.stack([np.sqrt(1 - z * z) * np.cos(azimuth), np.sqrt(1 - z * z) * np.sin(azimuth), z])
    towards = np.maximum(neighbours[:, :3] @ spiral, 1e-12)
    reach = 2 * np.arctan(((1 - neighbours[:, 3:]) / towards).min(axis=0))
    assert reach.max() < np.radians(60 / 2**level)  # so that no neighbour was left out
    return reach


@lru_cache
def voronoi_volumes(level):
    """The part of SO(3) in each index's Voronoi cell; the density of rotations by t is (1 - cos t) / pi."""
    reaches = [cells_first_met(level, direction) for direction in range(directions_of(level))]
    return np.tile([np.mean(reach - np.sin(reach)) / np.pi for reach in reaches], 6 * 2**level)


@levels_to[2]
def test_voronoi_cells_are_within_seven_percent_of_equal_volume(level):
    relative = voronoi_volumes(level) * grid.grid_size(level)
    assert relative.mean() == pytest.approx(1, abs=1e-3)
    assert relative.min() == pytest.approx(SMALLEST_VOLUME[level], abs=2e-3)
    assert relative.max() == pytest.approx(LARGEST_VOLUME[level], abs=2e-3)
    assert np.abs(relative - 1).max() < 0.07


@levels_to[2]
def test_uniform_rotations_have_the_nearest_index_as_often_as_its_voronoi_cell_is_large(level):
    count = 1000 * directions_of(level) if level < 2 else 120_000
    counts = np.bincount(index_of(level).nearest(uniform(count, seed=3)), minlength=grid.grid_size(level))
    volumes = voronoi_volumes(level)
    assert stats.chisquare(counts, count * volumes / volumes.sum()).pvalue > 1e-3


def test_spread_of_voronoi_cells_shows_in_the_counts_as_more_than_chance():
    by_direction = np.bincount(index_of(0).nearest(uniform(40_000, seed=4)) % 12, minlength=12)
    assert stats.chisquare(by_direction).pvalue < 1e-6
    assert np.abs(by_direction / by_direction.mean() - 1).max() < 0.09


# --- covering radius ---


def covering_radius_deg(level):
    """How far a rotation can be from the grid, exactly.

    The points farthest from all quaternions are the normals of their convex hull. All cells are copies of those of
    a quarter of the directions at tilt 0, and a hull of the rotations around these has the facets that touch them.
    """
    quat_xyzw, tree = quaternions_of(level)
    azimuth = healpix.pix2ang(2**level, np.arange(directions_of(level)))[1]
    quarter = np.flatnonzero((azimuth + 1e-9) % (2 * np.pi) < np.pi / 2)
    enough_deg = 60 / 2**level
    lists = tree.query_ball_point(quat_xyzw[quarter], 2 * np.sin(np.radians(2 * enough_deg) / 4))
    near = np.unique(np.concatenate(lists).astype(int) % len(quat_xyzw))
    hull = ConvexHull(np.concatenate([quat_xyzw[near], -quat_xyzw[near]]))
    touches = np.isin(near[hull.simplices % len(near)], quarter).any(axis=1)
    radius_deg = 2 * np.degrees(np.arccos(-hull.equations[touches, 4].max()))
    assert radius_deg < enough_deg  # else a rotation that was left out could be nearer
    return radius_deg


@levels_to[4]
def test_covering_radius_is_the_measured_one(level):
    assert covering_radius_deg(level) == pytest.approx(COVERING_RADIUS_DEG[level], abs=2e-5)


@levels_to[4]
def test_no_rotation_is_farther_from_the_grid_than_the_covering_radius(level):
    index, rng, tilt_deg = index_of(level), np.random.default_rng(level), 60 / 2**level
    at_the_pole = np.stack([turn_z(turn) for turn in np.radians(np.linspace(180, 180 + tilt_deg, 100))])
    tried, farthest = np.concatenate([uniform(10_000, seed=5), at_the_pole]), 0.0
    for spread in (0.3, 0.2, 0.1, 0.05, 0.02, 0.01, 0.003):  # climbs from the farthest of them
        nearest = index.rotations[index.nearest(tried)]
        off_deg = np.degrees((Rotation.from_matrix(nearest).inv() * Rotation.from_matrix(tried)).magnitude())
        farthest = max(farthest, off_deg.max())
        steps = Rotation.from_rotvec(np.radians(rng.normal(scale=spread * tilt_deg, size=(80, 3)))).as_matrix()
        steps[0] = np.eye(3)
        tried = (tried[np.argsort(off_deg)[-20:], None] @ steps).reshape(-1, 3, 3)
    assert 0.995 * COVERING_RADIUS_DEG[level] < farthest < COVERING_RADIUS_DEG[level] + 2e-5
