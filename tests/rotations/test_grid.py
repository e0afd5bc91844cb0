"""The grid: its definition, digest and frames, what a cell's volume is, how far off it can be, and the search in it."""

import hashlib
import math
from functools import lru_cache

import healpix
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.errors import SettingsError
from symsol_annot.rotations import grid

HASHED_SCALE = 2**20
PUBLISHED_SHA256 = {
    0: "701429eea659f4e5ffbcb60df7e19361a91174de4500370c2fe9b403793555f3",
    1: "032f86d5dd844de37d779bed16c122fb262c68878c4c1ab3fa950630469e5741",
    2: "71e9e74ca86c5ca4e53e035dce91d0b29c12a341faf18cd5a44ee6d77f91fcd1",
    3: "d262a4e10590181383c1109c571ff0398782c548f31a6157257e02523a2e9a32",
    4: "9031aada19e9366e7770b644361f7086a44ecf8f727763a9d9ff5bdc7eccd806",
}
COVERING_RADIUS_DEG = {0: 51.06493, 1: 27.86979, 2: 13.90378, 3: 6.94809, 4: 3.47357}
LARGEST_VOLUME = {0: 1.033, 1: 1.065, 2: 1.054}  # of a Voronoi cell, in units of the mean; measured
SMALLEST_VOLUME = {0: 0.934, 1: 0.978, 2: 0.966}

levels_to = {top: pytest.mark.parametrize("level", range(top + 1)) for top in (1, 2, 3, 4)}
hashed_levels = pytest.mark.parametrize("level", range(5))
angles = st.floats(-10, 10)


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


def digest(matrices):
    return hashlib.sha256(np.round(np.ravel(matrices) * HASHED_SCALE).astype("<i4").tobytes()).hexdigest()


def uniform(count, seed=0):
    return Rotation.random(count, random_state=seed).as_matrix()


def turn_x(angle):
    return np.array([[1, 0, 0], [0, math.cos(angle), -math.sin(angle)], [0, math.sin(angle), math.cos(angle)]])


def turn_y(angle):
    return np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])


def turn_z(angle):
    return np.array([[math.cos(angle), -math.sin(angle), 0], [math.sin(angle), math.cos(angle), 0], [0, 0, 1]])


# --- what it is ---


@pytest.mark.parametrize(("level", "size"), list(enumerate([72, 576, 4_608, 36_864, 294_912, 2_359_296, 18_874_368])))
def test_level_has_72_times_8_to_its_power_rotations(level, size):
    assert grid.grid_size(level) == size
    if level <= grid.STANDARD_LEVEL:
        assert grid_of(level).shape == (size, 3, 3)
        assert grid_of(level).dtype == np.float64


def test_standard_level_has_294912_rotations():
    assert grid.grid_size(grid.STANDARD_LEVEL) == 294_912
    np.testing.assert_array_equal(grid.equivolumetric_grid(), grid_of(grid.STANDARD_LEVEL))
    assert grid.grid_sha256() == PUBLISHED_SHA256[grid.STANDARD_LEVEL]


@levels_to[4]
def test_grid_holds_only_rotations(level):
    R = grid_of(level)
    assert np.abs(np.einsum("nji,njk->nik", R, R) - np.eye(3)).max() < 1e-14
    assert np.abs(np.linalg.det(R) - 1).max() < 1e-14


@levels_to[4]
def test_no_two_rotations_of_the_grid_are_closer_than_four_fifths_of_a_tilt(level):
    quat_xyzw, tree = quaternions_of(level)
    chord = tree.query(quat_xyzw, k=2)[0][:, 1]
    closest_deg = np.degrees(4 * np.arcsin(chord.min() / 2))
    assert 0.8 * 60 / 2**level < closest_deg < 60 / 2**level + 1e-9


@levels_to[2]
def test_grid_is_rz_azimuth_ry_polar_rz_tilt_in_the_order_of_tilts_then_healpix_rings(level):
    np.testing.assert_allclose(grid_of(level), Rotation.from_euler("ZYZ", angles_of(level)).as_matrix(), atol=1e-14)


@pytest.mark.parametrize("level", [3, 4, 5])
def test_index_is_tilt_times_directions_plus_direction(level):
    n_side, rng = 2**level, np.random.default_rng(level)
    by_tilt_and_direction = grid.equivolumetric_grid(level).reshape(6 * n_side, 12 * n_side**2, 3, 3)
    for _ in range(200):
        tilt, direction = rng.integers(6 * n_side), rng.integers(directions_of(level))
        polar, azimuth = healpix.pix2ang(n_side, direction)
        expected = turn_z(azimuth) @ turn_y(polar) @ turn_z(2 * math.pi * tilt / (6 * n_side))
        np.testing.assert_allclose(by_tilt_and_direction[tilt, direction], expected, atol=1e-14)


@levels_to[4]
def test_turning_by_a_step_of_tilt_moves_on_by_the_number_of_directions(level):
    turned = grid_of(level) @ turn_z(math.radians(60 / 2**level))
    np.testing.assert_allclose(turned, np.roll(grid_of(level), -directions_of(level), axis=0), atol=1e-13)


@levels_to[3]
@pytest.mark.parametrize("half_turn", [np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])])
def test_half_turns_of_model_or_camera_and_quarter_turns_about_z_map_the_grid_onto_itself(level, half_turn):
    tree = cKDTree(grid_of(level).reshape(-1, 9))
    for moved in (half_turn @ grid_of(level), grid_of(level) @ half_turn, turn_z(math.pi / 2) @ grid_of(level)):
        distance, index = tree.query(moved.reshape(-1, 9))
        assert distance.max() < 1e-13
        assert len(np.unique(index)) == len(index)


@pytest.mark.parametrize("level", [-1, 7])
@pytest.mark.parametrize(
    "function",
    [
        grid.grid_size,
        grid.equivolumetric_grid,
        grid.grid_sha256,
        grid.ring_to_nested,
        grid.GridIndex,
        lambda level: grid.cell_of(np.eye(3)[None], level),
        lambda level: grid.uniform_in_cells(np.zeros(1, dtype=np.int64), level, np.random.default_rng(0)),
    ],
)
def test_level_that_does_not_exist_is_a_settings_error(function, level):
    with pytest.raises(SettingsError, match=f"the grid has levels 0 to 6; there is no level {level}"):
        function(level)


# --- its digest ---


@levels_to[4]
def test_digest_is_the_published_one(level):
    assert grid.grid_sha256(level) == PUBLISHED_SHA256[level]


@levels_to[4]
def test_digest_is_of_the_rotations_in_order_as_millionths(level):
    assert digest(grid_of(level)) == grid.grid_sha256(level)


@hashed_levels
def test_digest_follows_from_the_definition_by_other_arithmetic(level):
    n_side = 2**level
    polar, azimuth = healpix.pix2ang(n_side, np.arange(12 * n_side**2))
    tilt = np.arange(6 * n_side) * (2 * np.pi / (6 * n_side))
    euler = np.stack([np.tile(azimuth, len(tilt)), np.tile(polar, len(tilt)), np.repeat(tilt, len(polar))], axis=-1)
    assert digest(Rotation.from_euler("ZYZ", euler).as_matrix()) == PUBLISHED_SHA256[level]


@hashed_levels
def test_digest_survives_the_last_bits_of_another_c_library(level):
    rng = np.random.default_rng(0)
    for noise in (1e-15, 1e-12):
        for _ in range(3):
            signs = rng.choice([-noise, noise], size=grid_of(level).shape)
            assert digest(grid_of(level) + signs) == PUBLISHED_SHA256[level]


@levels_to[2]
def test_digest_is_another_for_another_order_frame_or_convention(level):
    R = grid_of(level)
    others = [np.swapaxes(R, 1, 2), R[::-1], np.roll(R, 1, axis=0), grid.grid_frame_to_e3nn(R)]
    others += [R.reshape(6 * 2**level, -1, 3, 3).swapaxes(0, 1)]
    assert len({digest(other) for other in [*others, R]}) == len(others) + 1


# --- the frames of others ---


def implicit_pdf_grid(level):
    """As google-research/implicit_pdf generates it: about x by the azimuth, z by the polar angle, x by the tilt."""
    return np.stack([turn_x(azimuth) @ turn_z(polar) @ turn_x(tilt) for azimuth, polar, tilt in angles_of(level)])


def e3nn_grid(level):
    """As its users generate it: alpha azimuth, beta polar, gamma tilt, and e3nn's Ry(alpha) Rx(beta) Ry(gamma)."""
    return np.stack([turn_y(alpha) @ turn_x(beta) @ turn_y(gamma) for alpha, beta, gamma in angles_of(level)])


FRAMES = {
    "Implicit-PDF": (implicit_pdf_grid, grid.implicit_pdf_to_grid_frame, grid.grid_frame_to_implicit_pdf),
    "e3nn": (e3nn_grid, grid.e3nn_to_grid_frame, grid.grid_frame_to_e3nn),
}
every_frame = pytest.mark.parametrize("frame", FRAMES)


@every_frame
@levels_to[2]
def test_grid_of_others_is_this_grid_index_by_index(frame, level):
    theirs, to_ours, to_theirs = FRAMES[frame]
    np.testing.assert_allclose(to_ours(theirs(level)), grid_of(level), atol=1e-14)
    np.testing.assert_allclose(to_theirs(grid_of(level)), theirs(level), atol=1e-14)


@every_frame
def test_conversion_there_and_back_changes_nothing(frame):
    _, to_ours, to_theirs = FRAMES[frame]
    R = uniform(60).reshape(3, 4, 5, 3, 3)
    np.testing.assert_array_equal(to_ours(to_theirs(R)), R)
    np.testing.assert_array_equal(to_theirs(to_ours(R)), R)
    np.testing.assert_array_equal(to_ours(R[1, 2, 3]), to_ours(R)[1, 2, 3])


@every_frame
def test_conversion_keeps_products_and_is_no_identity(frame):
    _, to_ours, to_theirs = FRAMES[frame]
    a, b = uniform(20, seed=1), uniform(20, seed=2)
    for convert in (to_ours, to_theirs):
        np.testing.assert_allclose(convert(a) @ convert(b), convert(a @ b), atol=1e-14)
        assert np.abs(convert(a) - a).max() > 0.1
    assert np.abs(to_ours(a) - to_theirs(a)).max() > 0.1


@given(first=angles, second=angles, third=angles)
@settings(deadline=None, max_examples=40)
def test_euler_angles_of_others_are_ours_about_our_axes(first, second, third):
    ours = turn_z(first) @ turn_y(second) @ turn_z(third)
    implicit_pdf = turn_x(first) @ turn_z(second) @ turn_x(third)
    e3nn = turn_y(first) @ turn_x(second) @ turn_y(third)
    np.testing.assert_allclose(grid.implicit_pdf_to_grid_frame(implicit_pdf), ours, atol=1e-14)
    np.testing.assert_allclose(grid.e3nn_to_grid_frame(e3nn), ours, atol=1e-14)


# --- HEALPix's other order ---


def nested_direction(n_side, pixel):
    """The centre of a nested pixel as a unit vector (Gorski et al., 2005, sections 4 and 5)."""
    face, inside = divmod(pixel, n_side**2)
    bits = range(n_side.bit_length())
    x = sum((inside >> 2 * bit & 1) << bit for bit in bits)
    y = sum((inside >> 2 * bit + 1 & 1) << bit for bit in bits)
    row, column = divmod(face, 4)
    ring = (row + 2) * n_side - x - y - 1
    pixels_a_quarter = min(ring, n_side, 4 * n_side - ring)
    from_pole = pixels_a_quarter**2 / (3 * n_side**2)
    belt_z = 4 / 3 - 2 * ring / (3 * n_side)
    z = 1 - from_pole if ring < n_side else belt_z if ring <= 3 * n_side else from_pole - 1
    azimuth = math.pi / (2 * pixels_a_quarter) * ((2 * column - row % 2 + 1) * pixels_a_quarter + x - y) / 2
    return [math.sqrt(1 - z * z) * math.cos(azimuth), math.sqrt(1 - z * z) * math.sin(azimuth), z]


@levels_to[3]
def test_nested_index_has_the_same_tilt_and_its_nested_pixel_the_same_direction(level):
    directions = directions_of(level)
    centres = np.array([nested_direction(2**level, pixel) for pixel in range(directions)])
    nested = grid.ring_to_nested(level)
    np.testing.assert_array_equal(nested // directions, np.arange(len(nested)) // directions)
    np.testing.assert_allclose(centres[nested % directions], grid_of(level)[:, :, 2], atol=1e-14)


@levels_to[4]
def test_nested_order_is_a_permutation(level):
    nested = grid.ring_to_nested(level)
    assert nested.dtype == np.int64
    np.testing.assert_array_equal(np.sort(nested), np.arange(grid.grid_size(level)))


def test_nested_order_of_two_pixels_a_side_starts_as_healpy_documents_it():
    assert grid.ring_to_nested(1)[:10].tolist() == [3, 7, 11, 15, 2, 1, 6, 5, 10, 9]
    np.testing.assert_array_equal(grid.ring_to_nested(0), np.arange(72))


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


# --- the search ---


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
