"""Groups, spheres and turned pictures of an import from BOP, against what they must be."""

import struct

import numpy as np
import pytest
from imported_sets import angles
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

from symsol_annot.bop.reading.ply_vertices import read_vertices
from symsol_annot.bop.reading.smallest_sphere import smallest_sphere
from symsol_annot.bop.reading.symmetries import symmetry_group
from symsol_annot.bop.turned_views import picture_of, turn_to_axis, view_of
from symsol_annot.errors import DataError

ORIGIN = np.zeros(3)


def motion(rotvec, about=(0, 0, 0)):
    """A rotation about a point, as models_info.json lists it."""
    R, matrix = Rotation.from_rotvec(rotvec).as_matrix(), np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = R, np.asarray(about) - R @ about
    return matrix.ravel().tolist()


def group_of(discrete=(), axes=(), centre=ORIGIN):
    circles = [{"axis": list(axis), "offset": np.asarray(centre, float).tolist()} for axis in axes]
    info = {"symmetries_discrete": list(discrete), "symmetries_continuous": circles}
    return symmetry_group(info, np.asarray(centre, float), 100.0, "5")


THIRD, HALF = np.array([1, 1, 1]) / 3**0.5 * 2 * np.pi / 3, np.array([0, 0, np.pi])
FIFTH = np.array([0, 1, (1 + 5**0.5) / 2]) / np.hypot(1, (1 + 5**0.5) / 2) * 2 * np.pi / 5
GROUPS = {
    "none": ([], [], 1),
    "the identity": ([motion(ORIGIN)], [], 1),
    "a half turn about an axis off the origin": ([motion(HALF, (5, 2, 0))], [], 2),
    "a turn of 7": ([motion(HALF / 3.5)], [], 7),
    "a tetrahedron of two generators": ([motion(THIRD), motion(HALF)], [], 12),
    "a cube": ([motion(THIRD), motion(HALF / 2)], [], 24),
    "an icosahedron": ([motion(THIRD), motion(FIFTH)], [], 60),
    "a circle": ([], [(0, 0, 2)], 360),
    "a circle, its axis given twice": ([], [(0, 0, 1), (0, 0, -1)], 360),
    "a circle with a flip": ([motion([0, np.pi, 0])], [(0, 0, 1)], 720),
    "a circle with a turn about it": ([motion([0, 0, 1.0])], [(0, 0, 1)], 360),
}


@pytest.mark.parametrize(("discrete", "axes", "order"), GROUPS.values(), ids=GROUPS)
def test_listed_symmetries_generate_a_closed_group_that_holds_them(discrete, axes, order):
    centre = (5, 2, 0) if discrete and discrete[0][3] else ORIGIN
    group = group_of(discrete, axes, centre)
    assert len(group) == order
    assert np.array_equal(group[0], np.eye(3))
    rows = group[:: max(1, order // 30)]
    products = (rows[:, None] @ rows[None]).reshape(-1, 3, 3)
    assert angles(products, group).min(axis=1).max() < 1e-7
    assert order == 1 or angles(group, group)[~np.eye(order, dtype=bool)].min() > 0.017
    for matrix in discrete:
        R = np.reshape(matrix, (4, 4))[None, :3, :3]
        assert angles(R, group).min() < (0.5 * np.pi / 180 if axes else 1e-7)  # of a circle, the steps stand for it


def test_six_digits_of_a_symmetry_are_enough():
    listed = [np.round(motion(rotvec), 6).tolist() for rotvec in (THIRD, FIFTH)]
    assert len(group_of(listed)) == 60


CONTRADICTIONS = {
    "two circles": ([], [(0, 0, 1), (0, 1, 0)], "symmetries_continuous.1.: circles about two axes"),
    "a circle whose axis is moved": ([motion(THIRD)], [(0, 0, 1)], "takes the axis of symmetries_continuous to anoth"),
    "turns of no finite order": ([motion([0, 0, 1.0]), motion([1.0, 0, 0])], [], "more than 7,200 products"),
    "a translation": ([[*motion(ORIGIN)[:3], 50.0, *motion(ORIGIN)[4:]]], [], "moves the object's centre by 50 mm"),
    "an axis that is none": ([], [(0, 0, 0)], "axis: expected a direction"),
    "a mirror": ([np.diag([1.0, 1, -1, 1]).ravel().tolist()], [], "are no rotation"),
    "no last row": ([[*motion(ORIGIN)[:15], 2.0]], [], "the last four 0, 0, 0, 1"),
}


@pytest.mark.parametrize(("discrete", "axes", "message"), CONTRADICTIONS.values(), ids=CONTRADICTIONS)
def test_symmetries_that_are_no_finite_group_are_refused(discrete, axes, message):
    with pytest.raises(DataError, match=message):
        group_of(discrete, axes)


@pytest.mark.parametrize("count", [1, 2, 3, 5, 60])
def test_no_smaller_sphere_holds_the_points(count):
    points = np.random.default_rng(count).normal(size=(count, 3)) * [1, 2, 3]
    centre, radius = smallest_sphere(points)
    found = minimize(
        lambda c: np.linalg.norm(points - c, axis=1).max(), centre + 0.01, method="Nelder-Mead", options={"xatol": 1e-9}
    )
    assert np.linalg.norm(points - centre, axis=1).max() <= radius * (1 + 1e-12)
    assert radius <= found.fun + 1e-9


@pytest.mark.parametrize(("kind", "order"), [("ascii", ""), ("binary_little_endian", "<"), ("binary_big_endian", ">")])
def test_vertices_of_every_ply_are_the_same(tmp_path, kind, order):
    points = [(1.5, -2.0, 3.25), (4.0, 5.5, -6.0)]
    header = ["ply", f"format {kind} 1.0", "element vertex 2", *(f"property double {axis}" for axis in "zxy")]
    header += ["property short flag", "element face 0", "property list uchar int vertex_indices", "end_header", ""]
    rows = [(z, x, y, -7) for x, y, z in points]
    body = b"".join(
        struct.pack(f"{order}3dh", *row) if order else f"{' '.join(map(str, row))}\n".encode() for row in rows
    )
    (tmp_path / "a.ply").write_bytes("\n".join(header).encode() + body)
    assert np.array_equal(read_vertices(tmp_path, tmp_path / "a.ply").points, points)


def test_the_turn_takes_a_direction_to_the_axis_by_the_smallest_angle():
    for direction in np.random.default_rng(0).normal(size=(20, 3)):
        n = direction / np.linalg.norm(direction)
        n[2] = abs(n[2])
        R = turn_to_axis(n)
        np.testing.assert_allclose(R @ n, [0, 0, 1], atol=1e-12)
        np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-12)
        assert np.trace(R) == pytest.approx(1 + 2 * n[2])


@pytest.mark.parametrize("pixels_per_pixel", [1, 2, 5, 12])
def test_a_picture_that_shrinks_is_averaged(pixels_per_pixel):
    """A board of single pixels, black and white, is grey where more than one of them lies in a pixel."""
    board = np.indices((400, 400)).sum(axis=0) % 2 * 254
    before = np.stack(3 * [board], axis=-1).astype(np.uint8)
    distance, radius, size = 400.0, 100.0, 16
    focal = pixels_per_pixel * 0.45 * size * np.sqrt((distance / radius) ** 2 - 1)
    K = np.array([[focal, 0, 199.5], [0, focal, 199.5], [0, 0, 1]])
    found = picture_of(view_of(np.array([0, 0, distance]), radius, K, size, ""), before)
    if pixels_per_pixel == 1:
        np.testing.assert_array_equal(found, before[192:208, 192:208])
    else:
        assert np.abs(found[1:-1, 1:-1].astype(int) - 127).max() <= (26 if pixels_per_pixel == 5 else 1)


def test_what_the_camera_did_not_see_is_black():
    before, K = np.full((100, 100, 3), 200, np.uint8), np.array([[200.0, 0, 49.5], [0, 200.0, 49.5], [0, 0, 1]])
    found = picture_of(view_of(np.array([100.0, 0, 400.0]), 50.0, K, 32, ""), before)
    assert (found[:, :10] == 200).all()
    assert (found[:, -10:] == 0).all()
