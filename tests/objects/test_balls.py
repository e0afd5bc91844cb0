"""Balls: SO(3) is declared and certified, and the turns that keep each part in place are the candidates."""

import numpy as np
import pytest
from balls import BLUE, CAP, CAP_FACES, FLAG, MARKED, MERIDIANS, RED, ball, ball_toml, flag_faces
from symsol_annot_assets.ball import X_HALF_WIDTH, X_REACH, disc_axis, is_in_x

from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.mesh import is_convex
from symsol_annot.objects.spec import load_object, read_object
from symsol_annot.rotations.groups import cyclic_group
from symsol_annot.rotations.so3 import angle_between


@pytest.fixture
def read(tmp_path):
    def made(toml, mesh):
        (tmp_path / "object.toml").write_text(toml)
        (tmp_path / "mesh.obj").write_text(mesh)
        return read_object(tmp_path)

    return made


def test_the_candidates_of_a_ball_are_the_turns_that_keep_one_of_its_parts(read):
    spec = read(*MARKED)
    assert spec.has_all_rotations
    expected = np.concatenate([cyclic_group(2, (1, 0, 0)), cyclic_group(MERIDIANS)[1:]])
    np.testing.assert_allclose(spec.symmetry_group, expected, atol=1e-9)
    np.testing.assert_array_equal(spec.kept_by_turns, [[True, False] + [True] * 23, [True, True] + [False] * 23])
    assert spec.mesh.breaking == (2, 3)
    np.testing.assert_array_equal(spec.stabiliser, [np.eye(3)])
    assert check_object(spec).group == "SO(3)"
    assert check_object(spec).residual < 0.02


def test_a_ball_with_one_part_has_that_parts_turns_as_candidates_and_as_stabiliser(read):
    spec = read(ball_toml(CAP), ball({"red": CAP_FACES}))
    assert len(spec.symmetry_group) == len(spec.stabiliser) == MERIDIANS
    assert spec.cosets.shape == (1, MERIDIANS)


def test_a_plain_ball_has_no_candidate_beside_the_identity(read):
    spec = read(ball_toml(), ball())
    assert spec.has_all_rotations
    assert spec.marking is None
    np.testing.assert_array_equal(spec.symmetry_group, [np.eye(3)])
    check_object(spec)


def test_an_ellipsoid_that_declares_all_rotations_is_refused_with_its_own_group(read):
    spec = read(ball_toml(), ball(stretch=(0.9, 0.9, 1.0)))
    with pytest.raises(ObjectError, match=r"declares all rotations, but its surface is no ball .* has D24|circle"):
        check_object(spec)


def test_a_ball_that_declares_another_group_is_told_which_to_declare(read):
    spec = read(ball_toml(group='of = ["body"]\nkind = "cyclic"\norder = 24\nmax_offset = 0.02'), ball())
    with pytest.raises(ObjectError, match=r'is a ball within 0\.01.*Declare kind = "so3" and max_offset = 0\.0'):
        check_object(spec)


def test_facets_that_are_farther_off_than_is_allowed_are_refused_with_the_offset_that_would_do(read):
    spec = read(ball_toml(group='of = ["body"]\nkind = "so3"\nmax_offset = 0.001'), ball())
    with pytest.raises(ObjectError, match=r"allowed 0\.001.*`max_offset = 0\.01\d+`"):
        check_object(spec)


@pytest.mark.parametrize(
    ("parts", "paint", "expected"),
    [
        ([("belt", "red", RED)], {"red": range(5 * MERIDIANS, 7 * MERIDIANS)}, "'belt' lies evenly around the ball's"),
        (
            [FLAG, ("other", "red", BLUE)],
            {"blue": flag_faces(), "red": [125, 126, 149, 150]},
            "'other' looks like 'flag'",
        ),
    ],
    ids=["a belt", "two alike"],
)
def test_parts_whose_sets_have_no_rule_are_refused(read, parts, paint, expected):
    with pytest.raises(ObjectError, match=expected):
        read(ball_toml(*parts), ball(paint))


def test_all_rotations_of_no_part_are_refused(read):
    with pytest.raises(ObjectError, match=r"symmetry\.of: names no part"):
        read(ball_toml(CAP, group='of = []\nkind = "so3"'), ball({"red": CAP_FACES}))


# --- the one that ships ---


def test_the_marked_ball_has_the_turns_of_its_x_and_the_circle_of_its_disc():
    spec = load_object("sphereX")
    angles = angle_between(spec.symmetry_group, np.eye(3))
    np.testing.assert_allclose(spec.symmetry_group[:4], cyclic_group(4), atol=1e-9)
    np.testing.assert_allclose(spec.symmetry_group[4:] @ disc_axis(), np.tile(disc_axis(), (359, 1)), atol=1e-9)
    np.testing.assert_allclose(np.degrees(np.sort(angles[4:]))[::2], np.arange(1, 181), atol=1e-6)
    assert spec.kept_by_turns.sum(axis=1).tolist() == [4, 360]
    assert is_convex(spec.mesh)
    assert check_object(spec).residual <= spec.max_offset


def test_where_something_of_the_x_is_before_a_horizon_a_corner_of_it_is():
    """So no image shows a piece of the X that could be moved along its own rim."""
    spec = load_object("sphereX")
    points = np.unique(spec.mesh.triangles_of(2).reshape(-1, 3), axis=0)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    assert is_in_x(points).all()
    x, y = np.abs(points[:, 0]), np.abs(points[:, 1])
    is_corner = np.isclose(np.maximum(x, y), X_REACH) & np.isclose(np.minimum(x, y), X_HALF_WIDTH)
    assert is_corner.sum() == 8
    directions = np.random.default_rng(0).normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for horizon in (0.1, 0.25, 0.4):  # the camera's distance is its inverse
        before = directions @ points.T - horizon
        assert (before.max(axis=1) > 0).any()
        assert ((before[:, is_corner].max(axis=1) > 0) | (before.max(axis=1) <= 1e-5)).all()


def test_a_group_of_no_kind_is_answered_with_all_kinds(read):
    with pytest.raises(ObjectError, match=r"line \d+: symmetry\.kind: expected one of cyclic, .*so3, found 'sphere'"):
        read(ball_toml(group='kind = "sphere"'), ball())
