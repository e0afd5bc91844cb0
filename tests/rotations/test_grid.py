"""The grid: its definition, and the digest that it is known by."""

import hashlib
import math

import healpix
import numpy as np
import pytest
from grid_tables import angles_of, directions_of, grid_of, levels_to, quaternions_of, turn_y, turn_z
from scipy.spatial import cKDTree
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
hashed_levels = pytest.mark.parametrize("level", range(5))


def digest(matrices):
    return hashlib.sha256(np.round(np.ravel(matrices) * HASHED_SCALE).astype("<i4").tobytes()).hexdigest()


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


def test_an_index_up_to_the_standard_level_is_made_once_and_a_larger_one_is_not_kept(monkeypatch):
    shared = grid.grid_index(1)
    assert grid.grid_index(1) is shared
    np.testing.assert_array_equal(shared.rotations, grid.equivolumetric_grid(1))
    monkeypatch.setattr(grid, "STANDARD_LEVEL", 0)
    assert grid.grid_index(1) is not grid.grid_index(1)
