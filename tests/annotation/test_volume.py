"""Volumes of rotations: what is inside, how far the rest is, and how they are named, kept and drawn from."""

import copy
import pickle

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from symsol_annot.annotation.cells import Cells
from symsol_annot.annotation.volume import (
    BANDS_ERROR_RAD,
    CELLS,
    CELLS_ERROR_RAD,
    DIRECTIONS,
    Volume,
    viewing_directions,
)
from symsol_annot.errors import RotationError
from symsol_annot.rotations.grid import cell_of, equivolumetric_grid
from symsol_annot.rotations.so3 import angle_between, uniform_rotations

CAP_RAD = np.radians(40.0)
CENTRE = np.array([0.48, -0.6, 0.64])
HALF_STEP_RAD = np.radians(1.4)  # from a direction of level 5 to the farthest point of its piece, and a little


def cap_volume(centre=CENTRE, angle_rad=CAP_RAD):
    return Volume.of_directions(lambda v: v @ centre >= np.cos(angle_rad))


def two_caps():
    near_pole = np.array([0.1, 0.0, -0.99])
    return Volume.of_directions(lambda v: (v @ CENTRE > 0.8) | (v @ near_pole > 0.9))


def ball_volume(angle_rad=0.4):
    """Return the cells whose middle is at most an angle from a rotation: no region of directions."""
    centre = uniform_rotations(1, np.random.default_rng(4))[0]
    return centre, Volume(angle_between(GRID, centre) <= angle_rad)


GRID = equivolumetric_grid(5)
CAP, SMALL, TWO, (BALL_CENTRE, BALL) = cap_volume(), cap_volume(angle_rad=0.2), two_caps(), ball_volume()
EVERY_37TH, GRID = GRID[::37].copy(), None  # the whole takes 162 MiB
DRAWN = uniform_rotations(4000, np.random.default_rng(0))


def to_camera(R):
    """Return the direction, in model coordinates, from the object to the camera."""
    return np.swapaxes(R, 1, 2) @ [0.0, 0.0, -1.0]


def test_the_directions_that_are_asked_about_are_those_of_the_grids_rotations():
    tilt, direction = np.divmod(np.arange(CELLS)[::37], DIRECTIONS)
    ring = np.repeat(np.arange(127), [4 * min(r + 1, 127 - r, 32) for r in range(127)])[direction]
    np.testing.assert_allclose(viewing_directions()[tilt, ring], to_camera(EVERY_37TH), atol=1e-12)


def test_a_volume_of_directions_is_the_region_up_to_half_a_step():
    v = to_camera(DRAWN)
    beyond = np.arccos(v @ CENTRE) - CAP_RAD  # how far outside of the cap
    assert CAP.is_of_directions
    assert CAP.contains(DRAWN[beyond < -HALF_STEP_RAD]).all()
    assert not CAP.contains(DRAWN[beyond > HALF_STEP_RAD]).any()
    assert np.abs(CAP.distance(DRAWN) - np.maximum(beyond, 0.0)).max() < HALF_STEP_RAD
    assert CAP.measure == pytest.approx((1 - np.cos(CAP_RAD)) / 2, abs=1e-3)
    assert CAP.measure == len(CAP.cells) / CELLS == CAP.mask.mean()


@pytest.mark.parametrize("volume", [CAP, TWO], ids=["cap", "two caps, one at a pole"])
def test_what_is_in_a_volume_of_directions_follows_from_the_direction_alone(volume):
    turned = Rotation.from_rotvec([0, 0, 0.7]).as_matrix() @ DRAWN  # about the line of sight
    np.testing.assert_array_equal(volume.contains(turned), volume.contains(DRAWN))
    np.testing.assert_allclose(volume.distance(turned), volume.distance(DRAWN), atol=BANDS_ERROR_RAD)
    np.testing.assert_array_equal(volume.contains(EVERY_37TH), volume.mask[::37])
    agree = volume.contains(DRAWN) == volume.mask[cell_of(DRAWN, 5)]
    assert 0.97 < agree.mean() < 1  # bands have no teeth, as cells have


@pytest.mark.parametrize("volume", [CAP, TWO], ids=["cap", "two caps, one at a pole"])
def test_distance_to_a_volume_of_directions_is_that_to_the_nearest_of_very_many_of_its_rotations(volume):
    """The oracle goes through directions drawn from the volume, and one of those is within 0.3 degrees."""
    inside = to_camera(volume.sample(150_000, np.random.default_rng(2)))
    outside = DRAWN[~volume.contains(DRAWN)][:150]
    nearest = np.arccos(np.clip((to_camera(outside) @ inside.T).max(axis=1), -1, 1))
    found = volume.distance(outside)
    assert (found <= nearest + 1e-7).all()
    assert np.degrees(nearest - found).max() < 0.6
    assert np.degrees(nearest - found).mean() < 0.15


def test_the_nearest_rotation_of_a_volume_of_directions_is_as_far_as_is_said():
    """From a rotation to the volume's edge along the shortest way on the sphere: inside just after, outside before."""
    outside = DRAWN[~CAP.contains(DRAWN)][:40]
    for R, far in zip(outside, CAP.distance(outside), strict=True):
        axes = Rotation.random(400, random_state=1).as_matrix()[:, 0]
        turns = Rotation.from_rotvec(axes * (far - 1e-6)).as_matrix()
        assert not CAP.contains(turns @ R).any()


def test_any_other_volume_is_the_union_of_its_cells():
    assert not BALL.is_of_directions
    np.testing.assert_array_equal(BALL.contains(EVERY_37TH), BALL.mask[::37])
    beyond = angle_between(DRAWN, BALL_CENTRE) - 0.4
    assert BALL.contains(DRAWN[beyond < -0.045]).all()  # cells are compact: at the poles, too
    assert not BALL.contains(DRAWN[beyond > 0.045]).any()
    drawn = BALL.sample(2000, np.random.default_rng(0))
    assert BALL.contains(drawn).all()
    assert BALL.distance(drawn).max() == 0


@pytest.mark.parametrize("is_of_directions", [False, True])
def test_distance_to_any_other_volume_is_too_large_by_a_stated_angle_at_most(is_of_directions):
    volume = BALL
    if is_of_directions:  # one that is known exactly but for the way in which it is kept
        volume = copy.copy(SMALL)
        volume.__dict__["_bands"] = None
    outside = DRAWN[~volume.contains(DRAWN)][:100]
    found = volume.distance(outside)
    inside = volume.sample(30_000, np.random.default_rng(1)).reshape(-1, 9)
    nearest = 2 * np.arccos(np.sqrt(np.clip((1 + (outside.reshape(-1, 9) @ inside.T).max(axis=1)) / 4, 0, 1)))
    assert (nearest - found).max() < CELLS_ERROR_RAD + 0.08  # of the draws, which are as far apart
    assert (nearest - found).min() > -CELLS_ERROR_RAD
    if is_of_directions:
        exact = SMALL.distance(outside)
        assert (found - exact).max() < CELLS_ERROR_RAD
        assert (found - exact).min() > -CELLS_ERROR_RAD  # cells have teeth that stand out of the bands


def test_rotations_drawn_from_a_volume_are_uniform_in_it():
    for volume in (CAP, TWO, BALL):
        drawn = volume.sample(4000, np.random.default_rng(0))
        assert volume.contains(drawn).all()
        every = uniform_rotations(40_000, np.random.default_rng(1))
        inside = every[volume.contains(every)]
        assert abs(len(inside) / len(every) - volume.measure) < 5 * np.sqrt(volume.measure / len(every))
        deviation = np.sqrt(inside.var(axis=0) * (1 / len(inside) + 1 / len(drawn)))
        assert (np.abs(drawn.mean(axis=0) - inside.mean(axis=0)) < 5 * deviation + 1e-9).all()
    np.testing.assert_array_equal(*(CAP.sample(5, np.random.default_rng(3)) for _ in range(2)))


def test_all_of_SO3_is_a_volume():
    everything = Volume(np.ones(CELLS, dtype=bool))
    assert everything.measure == 1.0
    assert everything.contains(DRAWN).all()
    assert everything.distance(DRAWN).max() == 0
    assert everything.sample(3, np.random.default_rng(0)).shape == (3, 3, 3)


def test_volumes_are_equal_by_content():
    other = Volume.of_cells(CAP.cells)
    assert other == CAP
    assert hash(other) == hash(CAP)
    assert other.digest == CAP.digest
    assert TWO != CAP
    assert TWO.digest != CAP.digest
    assert CAP != "cap"
    assert pickle.loads(pickle.dumps(CAP)) == copy.deepcopy(CAP) == CAP
    assert len(pickle.dumps(CAP)) < CELLS / 7
    assert repr(Volume(np.arange(CELLS) < CELLS / 4)) == "<Volume: 25.00% of SO(3)>"


def test_a_mask_that_is_changed_afterwards_does_not_change_the_volume():
    mask = CAP.mask.copy()
    volume = Volume(mask)
    mask[:] = True
    assert volume == CAP
    with pytest.raises(ValueError, match="read-only"):
        volume.mask[0] = True


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda: Volume(np.ones(294_912, dtype=bool)),
            r"2359296 cells of the grid of level 5.* found shape \(294912,\)",
        ),
        (lambda: Volume(np.ones(CELLS)), "bool, found shape .* of float64"),
        (lambda: Volume(np.zeros(CELLS, dtype=bool)), "no cell is in it"),
        (lambda: Volume.of_cells(np.array([0, CELLS])), "indices 0 to 2359295, found 0 to 2359296"),
        (lambda: Volume.of_cells(np.array([-1, 3])), "found -1 to 3"),
        (lambda: Volume.of_cells(np.zeros(0, dtype=np.int64)), "no cell is in it"),
        (lambda: Volume.of_directions(lambda v: v[:, 0] > 2), "no cell is in it"),
    ],
)
def test_what_is_no_volume_is_refused(make, message):
    with pytest.raises(RotationError, match=message):
        make()


def test_no_rotation_of_a_cell_is_farther_from_the_centres_of_its_eighths_than_is_stated():
    rng = np.random.default_rng(0)
    for direction in (0, 8, 6000):
        cell = np.array([direction + DIRECTIONS * 17])
        union = Volume.of_cells(cell)
        drawn = union.sample(2000, rng)
        farthest = Cells(union.mask, 5).distance(drawn).max()
        assert 0.6 * CELLS_ERROR_RAD < farthest < CELLS_ERROR_RAD


@pytest.mark.parametrize("volume", [CAP, SMALL, TWO], ids=["cap", "small", "two"])
def test_within_is_exact_where_the_distance_is_nearly_the_angle(volume):
    R = DRAWN[:400]
    distances = volume.distance(R)
    for k in np.flatnonzero(distances > 0.0)[:40]:
        found = [volume.within(R[k : k + 1], distances[k] + more)[0] for more in (-1e-6, 1e-6)]
        assert found == [False, True], k


@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_a_wedge_that_ends_in_a_pole_is_as_near_as_the_pole_from_its_other_side(pole):
    wedge = Volume.of_directions(lambda v: (v[..., 2] * pole > 0.7) & (v[..., 0] > 2.0 * np.abs(v[..., 1])))
    R = uniform_rotations(4000, np.random.default_rng(1))
    v = to_camera(R)
    beyond = (v[:, 2] * pole > 0.8) & (-v[:, 0] > np.abs(v[:, 1]))
    assert np.count_nonzero(beyond) > 50
    np.testing.assert_allclose(
        wedge.distance(R[beyond]), np.arccos(v[beyond, 2] * pole), atol=BANDS_ERROR_RAD + HALF_STEP_RAD
    )


def test_distances_are_the_same_bits_wherever_arrays_lie_in_memory():
    """On a processor with AVX-512, some of 400 had other last bits while columns of R were passed as they are."""
    R, rng, kept = DRAWN[:500], np.random.default_rng(3), []
    first = CAP.distance(R)
    for size in rng.integers(1, 5000, 400):
        kept = [*kept[-20:], np.empty(size)]
        np.testing.assert_array_equal(CAP.distance(R), first)
