"""Rotations: the distance is the angle, quaternions are scipy's, the samples are uniform."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rotation_strategies import axes, rotations
from scipy import stats
from scipy.spatial.transform import Rotation

from symsol_annot.errors import RotationError, SymsolError
from symsol_annot.rotations import so3
from symsol_annot.rotations.groups import octahedral_group, tetrahedral_group

quick = settings(deadline=None, max_examples=60)
angles_near_0 = st.floats(1e-12, 1e-6)
angles_near_pi = st.floats(0, 1e-6).map(lambda gap: np.pi - gap)
angles = st.one_of(st.floats(0, np.pi), angles_near_0, angles_near_pi)


# --- turns about an axis ---


@given(axis=axes(), angle=st.floats(-10, 10))
@quick
def test_rotations_about_an_axis_agree_with_scipy(axis, angle):
    expected = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(so3.rotations_about(axis, angle), expected, atol=1e-13)
    assert so3.rotations_about(axis, np.full((2, 5), angle)).shape == (2, 5, 3, 3)


# --- distance ---


@given(a=rotations(), b=rotations())
@quick
def test_angle_between_is_the_magnitude_of_the_relative_rotation(a, b):
    found = so3.angle_between(a.as_matrix(), b.as_matrix())
    np.testing.assert_allclose(found, (a.inv() * b).magnitude(), rtol=0, atol=2e-7)
    assert 0 <= found <= np.pi


@given(a=rotations(), axis=axes(), angle=angles_near_0)
@quick
def test_angle_between_keeps_small_angles(a, axis, angle):
    b = a * Rotation.from_rotvec(angle * axis)
    assert abs(so3.angle_between(a.as_matrix(), b.as_matrix()) - angle) < 1e-14


def test_angle_between_resolves_a_billionth_of_a_radian_to_six_digits():
    turned = so3.rotations_about([1, 2, 3], 1e-9)
    assert so3.angle_between(np.eye(3), turned) == pytest.approx(1e-9, rel=1e-6)


@given(a=rotations(), axis=axes(), gap=st.floats(0, 1e-3))
@quick
def test_angle_between_is_accurate_near_a_half_turn(a, axis, gap):
    b = a * Rotation.from_rotvec((np.pi - gap) * axis)
    assert abs(so3.angle_between(a.as_matrix(), b.as_matrix()) - (np.pi - gap)) < 2e-7


def test_angle_between_of_a_half_turn_is_pi():
    assert so3.angle_between(np.eye(3), np.diag([1.0, -1.0, -1.0])) == np.pi


@given(a=rotations(), b=rotations())
@quick
def test_angle_between_is_symmetric(a, b):
    assert so3.angle_between(a.as_matrix(), b.as_matrix()) == so3.angle_between(b.as_matrix(), a.as_matrix())


@given(a=rotations(), axis=axes(), angle=st.floats(0, np.pi - 1e-3), moved_by=rotations())
@quick
def test_angle_between_is_invariant_under_left_and_right_multiplication(a, axis, angle, moved_by):
    R_a, R_b, R = (r.as_matrix() for r in (a, a * Rotation.from_rotvec(angle * axis), moved_by))
    expected = so3.angle_between(R_a, R_b)
    np.testing.assert_allclose(so3.angle_between(R @ R_a, R @ R_b), expected, rtol=0, atol=1e-11)
    np.testing.assert_allclose(so3.angle_between(R_a @ R, R_b @ R), expected, rtol=0, atol=1e-11)


def test_angle_between_broadcasts_its_arguments():
    group = tetrahedral_group()
    table = so3.angle_between(group[:, None], group[None])
    assert table.shape == (12, 12)
    np.testing.assert_array_equal(np.diag(table), 0)
    np.testing.assert_array_equal(table[3], so3.angle_between(group[3], group))


@pytest.mark.parametrize("shape", [(3,), (4, 4), (5, 3, 4), ()])
def test_angle_between_refuses_what_is_not_3_by_3(shape):
    with pytest.raises(RotationError, match=r"expected shapes \(\.\.\., 3, 3\), found"):
        so3.angle_between(np.eye(3), np.zeros(shape))
    with pytest.raises(RotationError, match=r"expected shapes \(\.\.\., 3, 3\), found"):
        so3.angle_between(np.zeros(shape), np.eye(3))


# --- quaternions ---


@given(axis=axes(), angle=angles)
@quick
def test_quaternion_of_a_rotation_is_scipys_with_the_scalar_first_and_not_negative(axis, angle):
    R = Rotation.from_rotvec(angle * axis)
    x, y, z, w = R.as_quat()
    quat_wxyz = so3.rotation_to_quat_wxyz(R.as_matrix())
    assert abs(np.linalg.norm(quat_wxyz) - 1) < 1e-14
    assert quat_wxyz[0] >= 0
    assert min(np.abs(quat_wxyz - sign * np.array([w, x, y, z])).max() for sign in (1, -1)) < 1e-13


@given(axis=axes(), angle=angles)
@quick
def test_rotation_survives_the_way_through_its_quaternion(axis, angle):
    R = Rotation.from_rotvec(angle * axis).as_matrix()
    np.testing.assert_allclose(so3.quat_wxyz_to_rotation(so3.rotation_to_quat_wxyz(R)), R, rtol=0, atol=1e-13)


@given(rotation=rotations(), scale=st.floats(1e-3, 1e3))
@quick
def test_rotation_of_a_quaternion_depends_on_its_direction_alone(rotation, scale):
    quat_wxyz = np.roll(rotation.as_quat(), 1)
    for factor in (scale, -scale):
        found = so3.quat_wxyz_to_rotation(factor * quat_wxyz)
        np.testing.assert_allclose(found, rotation.as_matrix(), rtol=0, atol=1e-13)


def test_quaternions_keep_leading_axes():
    R = octahedral_group().reshape(2, 3, 4, 3, 3)
    quat_wxyz = so3.rotation_to_quat_wxyz(R)
    assert quat_wxyz.shape == (2, 3, 4, 4)
    np.testing.assert_allclose(so3.quat_wxyz_to_rotation(quat_wxyz), R, atol=1e-14)


# --- what is a rotation ---


@given(rotation=rotations())
@quick
def test_a_rotation_is_accepted_and_returned_as_it_is(rotation):
    np.testing.assert_array_equal(so3.check_rotations(rotation.as_matrix().tolist(), "R"), rotation.as_matrix())


@pytest.mark.parametrize(
    "broken",
    [
        np.diag([1.0, 1.0, -1.0]),
        np.eye(3) * 1.001,
        np.full((3, 3), np.nan),
        np.diag([1.0, np.inf, 1.0]),
        np.zeros((3, 3)),
        np.array([[1, 1e-3, 0], [0, 1, 0], [0, 0, 1.0]]),
    ],
    ids=["reflection", "scaled", "NaN", "infinite", "zero", "sheared"],
)
def test_a_matrix_that_is_no_rotation_is_refused_with_its_row(broken):
    R = np.stack([np.eye(3), np.eye(3), broken, np.eye(3)])
    with pytest.raises(RotationError, match=r"labels: 1 of 4 matrices are no rotations, the first in row 2"):
        so3.check_rotations(R, "labels")


@pytest.mark.parametrize("shape", [(9,), (3,), (2, 3), (5, 3, 4), ()])
def test_an_array_of_another_shape_holds_no_rotations(shape):
    with pytest.raises(RotationError, match=r"labels: expected an array of shape \(\.\.\., 3, 3\), found"):
        so3.check_rotations(np.zeros(shape), "labels")


def test_the_tolerance_decides_what_is_a_rotation():
    off_by_2e_6 = np.eye(3) * (1 + 1e-6)
    so3.check_rotations(off_by_2e_6, "R", tolerance=1e-5)
    with pytest.raises(RotationError, match=r"allowed 1e-09"):
        so3.check_rotations(off_by_2e_6, "R")


@given(stretch=st.floats(1e-4, 1))
@quick
def test_deviation_is_the_larger_of_both_defects(stretch):
    stretched, mirrored = np.diag([1 + stretch, 1, 1]), np.diag([1.0, -1.0, 1.0])
    found = so3.rotation_deviation(np.stack([np.eye(3), stretched, mirrored]))
    np.testing.assert_allclose(found, [0, (1 + stretch) ** 2 - 1, 2], atol=1e-14)


def test_a_rotation_error_is_one_of_this_packages_errors():
    assert issubclass(RotationError, SymsolError)


# --- the uniform distribution ---

COUNT = 10_000
LEAST_P_VALUE = 1e-6
LARGEST_Z_SCORE = 5.5


def uniform_on_interval(values, low, high):
    return stats.kstest(values, stats.uniform(low, high - low).cdf).pvalue


def deviations_from_haar(R):
    """Name the statistics of (n, 3, 3) rotations that the uniform distribution on SO(3) would not give."""
    fixed = Rotation.from_rotvec([0.3, -1.1, 0.7]).as_matrix()
    p_values, z_scores = {}, {}
    for where, moved in {"": R, " after a left multiplication": fixed @ R, " after a right one": R @ fixed}.items():
        rotvec = Rotation.from_matrix(moved).as_rotvec()
        angle = np.linalg.norm(rotvec, axis=1)
        axis = rotvec / angle[:, None]
        p_values[f"angle{where}"] = stats.kstest(angle, lambda a: (a - np.sin(a)) / np.pi).pvalue
        p_values[f"axis, height{where}"] = uniform_on_interval(axis[:, 2], -1, 1)
        p_values[f"axis, azimuth{where}"] = uniform_on_interval(np.arctan2(axis[:, 1], axis[:, 0]), -np.pi, np.pi)
        for column in range(3):  # the image of a basis vector is uniform on the sphere
            x, y, z = moved[:, :, column].T
            p_values[f"image {column}, height{where}"] = uniform_on_interval(z, -1, 1)
            p_values[f"image {column}, azimuth{where}"] = uniform_on_interval(np.arctan2(y, x), -np.pi, np.pi)
        for degree in (1, 2, 3, 4):  # the characters: mean 0, variance 1
            character = 1 + 2 * np.cos(np.outer(np.arange(1, degree + 1), angle)).sum(axis=0)
            z_scores[f"character {degree}{where}"] = character.mean() * len(R) ** 0.5
    entries = R.reshape(-1, 9)
    products = entries.T @ entries / len(R)  # the Wigner matrices of degree 1: orthogonal, of mean square 1/3
    z_scores["mean of an entry"] = np.abs(entries.mean(axis=0)).max() * (3 * len(R)) ** 0.5
    z_scores["product of entries"] = np.abs(products - np.eye(9) / 3).max() * 3 * len(R) ** 0.5
    return {name: p for name, p in p_values.items() if p < LEAST_P_VALUE} | {
        name: z for name, z in z_scores.items() if abs(z) > LARGEST_Z_SCORE
    }


def uniform_euler_angles(rng):
    return Rotation.from_euler("zyx", rng.uniform(-np.pi, np.pi, (COUNT, 3))).as_matrix()


def euler_angles_with_half_the_middle_range(rng):
    low, high = np.array([[-np.pi, -np.pi / 2, -np.pi], [np.pi, np.pi / 2, np.pi]])
    return Rotation.from_euler("zyx", rng.uniform(low, high, (COUNT, 3))).as_matrix()


def quaternions_of_a_cube(rng):
    return Rotation.from_quat(rng.uniform(-1, 1, (COUNT, 4))).as_matrix()


def quaternions_of_positive_numbers(rng):
    return Rotation.from_quat(rng.uniform(0, 1, (COUNT, 4))).as_matrix()


def uniform_axis_and_uniform_angle(rng):
    axis = rng.normal(size=(COUNT, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    return Rotation.from_rotvec(rng.uniform(0, np.pi, (COUNT, 1)) * axis).as_matrix()


def uniform_rotation_vectors(rng):
    vectors = rng.uniform(-np.pi, np.pi, (3 * COUNT, 3))
    return Rotation.from_rotvec(vectors[np.linalg.norm(vectors, axis=1) < np.pi][:COUNT]).as_matrix()


def mostly_uniform(rng):
    R = Rotation.random(COUNT, random_state=np.random.RandomState(rng.integers(2**31))).as_matrix()
    R[: COUNT // 20] = np.eye(3)
    return R @ Rotation.from_rotvec(rng.normal(scale=1e-3, size=(COUNT, 3))).as_matrix()


NAIVE_SAMPLERS = [
    uniform_euler_angles,
    euler_angles_with_half_the_middle_range,
    quaternions_of_a_cube,
    quaternions_of_positive_numbers,
    uniform_axis_and_uniform_angle,
    uniform_rotation_vectors,
    mostly_uniform,
]


@pytest.mark.parametrize("seed", range(3))
def test_uniform_rotations_follow_the_haar_measure(seed):
    assert deviations_from_haar(so3.uniform_rotations(COUNT, np.random.default_rng(seed))) == {}


@pytest.mark.parametrize("sampler", NAIVE_SAMPLERS, ids=lambda sampler: sampler.__name__)
def test_a_naive_sampler_does_not_follow_the_haar_measure(sampler):
    assert deviations_from_haar(sampler(np.random.default_rng(0))) != {}


def test_uniform_rotations_are_rotations():
    R = so3.uniform_rotations(1000, np.random.default_rng(0))
    assert np.abs(R @ np.swapaxes(R, 1, 2) - np.eye(3)).max() < 1e-14
    np.testing.assert_allclose(np.linalg.det(R), 1, atol=1e-14)


@given(seed=st.integers(0, 2**32), count=st.integers(0, 20), more=st.integers(0, 20))
@quick
def test_the_first_rotations_drawn_do_not_depend_on_how_many_are_drawn(seed, count, more):
    few = so3.uniform_rotations(count, np.random.default_rng(seed))
    many = so3.uniform_rotations(count + more, np.random.default_rng(seed))
    assert few.shape == (count, 3, 3)
    np.testing.assert_array_equal(few, many[:count])


def test_another_seed_draws_other_rotations():
    first, second = (so3.uniform_rotations(10, np.random.default_rng(seed)) for seed in (0, 1))
    assert np.abs(first - second).max(axis=(1, 2)).min() > 1e-3
