"""The nearest rotation is the nearest, whatever the angles, and an arc's nearest point is nearer than any other."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from scoring_oracle import angle_to_arcs, angles, arc_pieces

from symsol_annot.objects.spec import builtin_names, load_object
from symsol_annot.rotations import nearest
from symsol_annot.rotations.groups import cyclic_group, dihedral_group, octahedral_group, tetrahedral_group
from symsol_annot.rotations.nearest import (
    angles_to_arcs,
    find_circles,
    nearest_angles,
    nearest_angles_both_ways,
    nearest_angles_on_circles,
)
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

NEAR_PI_TOLERANCE, TOLERANCE = 1e-7, 1e-12
quick = settings(deadline=None, max_examples=40)
seeds = st.integers(0, 2**32 - 1)


def brute(R_a, R_b):
    return np.array([angles(R, R_b).min() for R in R_a])


def tolerance_at(expected):
    """1e-12, but eq. 5.6 itself errs near pi, the more the nearer."""
    gap = np.maximum(np.pi - expected, 1e-15)
    return np.minimum(TOLERANCE + 1e-14 / gap, NEAR_PI_TOLERANCE)


def assert_angles(found, expected):
    off = np.abs(found - expected)
    assert (off <= tolerance_at(expected)).all(), (off.max(), expected[off.argmax()])


def assert_nearest(R_a, R_b):
    to_b, to_a = brute(R_a, R_b), brute(R_b, R_a)
    assert_angles(nearest_angles(R_a, R_b), to_b)
    found_b, found_a = nearest_angles_both_ways(R_a, R_b)
    assert_angles(found_b, to_b)
    assert_angles(found_a, to_a)


def turned(R, angles_rad, rng):
    """(n, 3, 3): R @ a turn by each angle about an axis of its own."""
    axes = rng.normal(size=(len(angles_rad), 3))
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return R @ Rotation.from_rotvec(np.asarray(angles_rad)[:, None] * axes).as_matrix()


# --- finite sets ---


@quick
@given(seeds, st.integers(1, 12), st.integers(1, 12))
def test_nearest_of_any_rotations_is_that_of_all_pairs(seed, a, b):
    rng = np.random.default_rng(seed)
    assert_nearest(uniform_rotations(a, rng), uniform_rotations(b, rng))


@quick
@given(seeds)
def test_hypotheses_that_differ_by_next_to_nothing_are_told_apart(seed):
    """From 1e-12 to 1e-2 rad: through the size at which the way of computing changes."""
    rng = np.random.default_rng(seed)
    R = uniform_rotations(1, rng)[0]
    small = 10.0 ** rng.uniform(-12, -2, size=(2, 8))
    R_a, R_b = turned(R, small[0], rng), turned(R, small[1], rng)
    assert_nearest(R_a, R_b)
    to_b, _ = nearest_angles_both_ways(R_a, R_b)
    np.testing.assert_allclose(to_b, brute(R_a, R_b), rtol=1e-9, atol=3e-16)


@pytest.mark.parametrize("angle", [1e-12, 1e-10, 1e-9, 1e-7, 1e-5, 1e-3, 6e-3, 7e-3, 7.2e-3, 0.01, 0.1])
def test_a_small_angle_is_found_as_small_as_it_is(angle):
    rng = np.random.default_rng(0)
    R = uniform_rotations(50, rng)
    R_a = np.concatenate([turned(one, [angle], rng) for one in R])
    found, back = nearest_angles_both_ways(R_a, R)
    np.testing.assert_allclose(found, angle, rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(back, angle, rtol=1e-10, atol=1e-15)
    np.testing.assert_allclose(nearest_angles(R_a, R), angle, rtol=1e-10, atol=1e-15)


def test_a_rotation_is_at_exactly_0_from_itself_and_from_its_copies():
    R = uniform_rotations(200, np.random.default_rng(1))
    np.testing.assert_array_equal(nearest_angles(R, np.concatenate([R[::-1], R])), 0.0)
    for found in nearest_angles_both_ways(R, R[::-1]):
        np.testing.assert_array_equal(found, 0.0)


@quick
@given(seeds)
def test_angles_near_pi_are_within_what_the_formula_allows(seed):
    rng = np.random.default_rng(seed)
    R = uniform_rotations(1, rng)
    gaps = np.concatenate([[0.0], 10.0 ** rng.uniform(-12, -1, size=9)])
    R_a = turned(R[0], np.pi - gaps, rng)
    assert_nearest(R_a, R)
    found = nearest_angles(R_a, R)
    assert (found <= np.pi).all()
    is_farther = gaps > 1e-3
    np.testing.assert_allclose(found[is_farther], np.pi - gaps[is_farther], rtol=0, atol=1e-9)
    np.testing.assert_allclose(found, np.pi - gaps, rtol=0, atol=NEAR_PI_TOLERANCE)


@quick
@given(seeds)
def test_matrices_that_are_off_by_a_float32_are_taken_as_they_are(seed):
    rng = np.random.default_rng(seed)
    members = uniform_rotations(1, rng)[0] @ tetrahedral_group()
    hypotheses = np.concatenate([turned(members[3], [0.0, 1e-6, 1e-3, 0.3], rng), uniform_rotations(4, rng)])
    hypotheses = (hypotheses + rng.uniform(-4e-6, 4e-6, hypotheses.shape)).astype(np.float32).astype(float)
    assert_nearest(members, hypotheses)


def test_images_side_by_side_are_as_images_one_by_one():
    rng = np.random.default_rng(2)
    R_a, R_b = uniform_rotations(60, rng).reshape(5, 12, 3, 3), uniform_rotations(35, rng).reshape(5, 7, 3, 3)
    R_b[:, 0] = R_a[:, 3]
    to_b, to_a = nearest_angles_both_ways(R_a, R_b)
    for i in range(5):
        assert_angles(to_b[i], brute(R_a[i], R_b[i]))
        assert_angles(to_a[i], brute(R_b[i], R_a[i]))


def test_the_size_of_the_steps_changes_nothing(monkeypatch):
    rng = np.random.default_rng(3)
    R_b = uniform_rotations(9, rng)
    R_a = np.concatenate([uniform_rotations(40, rng), R_b, turned(R_b[2], [1e-9, 1e-4], rng)])
    expected = nearest_angles(R_a, R_b), *nearest_angles_both_ways(R_a, R_b)
    monkeypatch.setattr(nearest, "_PAIRS_AT_ONCE", 20)
    found = nearest_angles(R_a, R_b), *nearest_angles_both_ways(R_a, R_b)
    for one, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=TOLERANCE)


# --- circles of a group ---


@pytest.mark.parametrize("name", builtin_names())
def test_circles_of_a_built_in_object_part_its_group_or_there_are_none(name):
    group = load_object(name).symmetry_group
    circles = find_circles(group)
    if name not in ("cone", "cyl", "cylO", "dots", "mug", "screw", "sphereX"):
        assert circles is None
        return
    assert circles.index.shape == (len(group) // 360, 360)
    assert sorted([*circles.index.reshape(-1), *circles.isolated_index]) == list(range(len(group)))
    assert (len(circles.isolated) > 0) == (name == "sphereX")
    assert circles.step_rad == pytest.approx(np.radians(1), abs=1e-15)
    if name != "sphereX":  # its circle is about the disc's axis
        np.testing.assert_allclose(np.abs(circles.axis), [0, 0, 1], atol=1e-12)
    for start, row in zip(circles.starts, circles.index, strict=True):
        turns = rotations_about(circles.axis, np.radians(np.arange(360)))
        np.testing.assert_allclose(group[row], start @ turns, rtol=0, atol=1e-12)


def test_a_circle_is_continuous_from_steps_of_one_degree_on():
    assert find_circles(cyclic_group(359)) is None
    assert find_circles(np.eye(3)[None]) is None
    assert find_circles(octahedral_group()) is None
    assert find_circles(cyclic_group(720)).index.shape == (1, 720)


A = uniform_rotations(1, np.random.default_rng(4))[0]
SHUFFLED = np.concatenate([[0], 1 + np.random.default_rng(5).permutation(719)])
BODIES = {  # name to (group, A, the group about z that it is when turned back by A)
    "cone": (cyclic_group(360), np.eye(3), cyclic_group(360)),
    "cyl": (dihedral_group(360), np.eye(3), dihedral_group(360)),
    "a tilted cyl with its elements in another order": (
        A @ dihedral_group(360)[SHUFFLED] @ A.T,
        A,
        dihedral_group(360)[SHUFFLED],
    ),
}
PIECES = {name: arc_pieces(upright) for name, (_, _, upright) in BODIES.items()}
CIRCLES = {name: find_circles(group) for name, (group, _, _) in BODIES.items()}


def test_circles_are_found_about_any_axis_and_in_any_order():
    group, _, _ = BODIES["a tilted cyl with its elements in another order"]
    circles = CIRCLES["a tilted cyl with its elements in another order"]
    np.testing.assert_allclose(np.abs(circles.axis @ A[:, 2]), 1.0, atol=1e-12)
    assert sorted(circles.index.reshape(-1)) == list(range(720))
    for start, row in zip(circles.starts, circles.index, strict=True):
        np.testing.assert_allclose(
            group[row], start @ rotations_about(circles.axis, np.radians(np.arange(360))), atol=1e-12
        )


def some_mask(circles, kind, rng):
    """(G,): which elements are in, laid out along the circles."""
    count, steps = circles.index.shape
    on_circle = np.zeros((count, steps), dtype=bool)
    for c in range(count):
        arc = (np.arange(steps) - rng.integers(steps)) % steps < rng.integers(2, steps)
        on_circle[c] = {
            "full circles": np.ones(steps, dtype=bool),
            "arcs": arc,
            "an arc on one circle only": arc & (c == 0),
            "frayed arcs": arc ^ (rng.random(steps) < 0.05),
            "every other member": np.arange(steps) % 2 == 0,
            "a few members": rng.random(steps) < 0.01,
            "one member": (np.arange(steps) == rng.integers(steps)) & (c == 0),
            "all but one": np.arange(steps) != rng.integers(steps),
        }[kind]
    on_circle[0, rng.integers(steps)] |= not on_circle.any()
    mask = np.zeros(count * steps, dtype=bool)
    mask[circles.index] = on_circle
    return mask


MASKS = [
    "full circles",
    "arcs",
    "an arc on one circle only",
    "frayed arcs",
    "every other member",
    "a few members",
    "one member",
    "all but one",
]


def some_others(group, circles, R, mask, rng):
    """Anywhere, near arcs and far, between members, on them, just past the ends, and half turns across the axis."""
    members = R @ group[mask]
    between = rng.choice(members, 4) @ rotations_about(circles.axis, np.radians(rng.uniform(-1.5, 1.5, 4)))
    half_turn = rotations_about(np.cross(circles.axis, rng.normal(size=3)), np.pi)
    tiny = np.concatenate([turned(one, 10.0 ** rng.uniform(-12, -3, 1), rng) for one in between])
    near = np.concatenate([turned(one, [rng.uniform(0, 0.2)], rng) for one in between])
    float32 = between + rng.uniform(-4e-6, 4e-6, between.shape)
    return np.concatenate([uniform_rotations(4, rng), members[:1], between, tiny, near, float32, [R @ half_turn]])


@pytest.mark.parametrize("kind", MASKS)
@pytest.mark.parametrize("name", BODIES)
def test_the_nearest_point_of_arcs_is_that_of_a_search_along_them(name, kind):
    group, turn_back, upright = BODIES[name]
    rng = np.random.default_rng(MASKS.index(kind))
    R, mask = uniform_rotations(1, rng)[0], some_mask(CIRCLES[name], kind, rng)
    others = some_others(group, CIRCLES[name], R, mask, rng)
    members_of = {g: R @ turn_back @ upright[g] for g in np.flatnonzero(mask)}
    expected = np.array([angle_to_arcs(members_of, PIECES[name], X @ turn_back) for X in others])
    to_members = nearest_angles(others, R @ group[mask])
    found = angles_to_arcs(CIRCLES[name], R, mask, others, to_members)
    assert_angles(found, expected)
    assert (found <= to_members).all()


@pytest.mark.parametrize("kind", MASKS)
@pytest.mark.parametrize("name", BODIES)
def test_the_nearest_member_on_circles_is_that_of_all_members(name, kind):
    group, _, _ = BODIES[name]
    rng = np.random.default_rng(100 + MASKS.index(kind))
    R, mask = uniform_rotations(1, rng)[0], some_mask(CIRCLES[name], kind, rng)
    others = np.concatenate([some_others(group, CIRCLES[name], R, mask, rng), uniform_rotations(100, rng)])
    expected = brute(others, R @ group[mask])
    assert_angles(nearest_angles_on_circles(CIRCLES[name], R, mask, others), expected)


def test_a_point_between_members_is_on_the_arc_and_a_point_past_its_end_is_not():
    circles = find_circles(cyclic_group(360))
    mask = np.isin(circles.index[0], np.arange(10, 21))
    mask = mask[np.argsort(circles.index[0])]
    others = cyclic_group(360)[0] @ rotations_about((0, 0, 1), np.radians([15.5, 20.0, 20.5, 9.75, 200.0]))
    to_members = nearest_angles(others, cyclic_group(360)[mask])
    np.testing.assert_allclose(np.degrees(to_members), [0.5, 0, 0.5, 0.25, 170], atol=1e-9)
    found = angles_to_arcs(circles, np.eye(3), mask, others, to_members)
    np.testing.assert_allclose(np.degrees(found), [0, 0, 0.5, 0.25, 170], atol=1e-9)
