"""Flat faces cut anew: the same surface with the same corners, in triangles that all look the same way."""

import numpy as np
import pytest

from symsol_annot.objects.mesh import Mesh
from symsol_annot.objects.spec import builtin_names, load_object
from symsol_annot.rendering.frames.flat_faces import cut_polygon, with_few_slivers

FANS_OF_A_CIRCLE = {"cyl": 4, "cylO": 4, "cone": 2, "mug": 4, "screw": 4, "dots": 4}  # two triangles of each


def areas(mesh):
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    return 0.5 * np.cross(b - a, c - a)


def open_sides(triangles):
    sides = {(t[i], t[(i + 1) % 3]) for t in triangles.tolist() for i in range(3)}
    return {side for side in sides if side[::-1] not in sides}


def flat_mesh(triangles, corners, marked=False):
    """A mesh that is one flat face: enough for what is done face by face."""
    vertices = np.column_stack([corners, np.zeros(len(corners))])
    normals = np.tile([0.0, 0.0, 1.0], (len(triangles), 3, 1))
    return Mesh(vertices, np.array(triangles), normals, np.full(len(triangles), 1 + marked, np.uint8))


def fan(corners, middle=(0.0, 0.0)):
    count = len(corners)
    return [(i, (i + 1) % count, count) for i in range(count)], np.vstack([corners, middle])


def regular(count):
    angles = 2 * np.pi * np.arange(count) / count
    return np.column_stack([np.cos(angles), np.sin(angles)])


@pytest.mark.parametrize("count", [*range(3, 20), 359, 360])
def test_a_convex_polygon_is_cut_into_two_less_triangles_that_cover_it_once(count):
    corners = regular(count)
    triangles = cut_polygon(list(range(count)))
    assert triangles.shape == (count - 2, 3)
    a, b, c = np.moveaxis(corners[triangles], 1, 0)
    doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert (doubled > 0).all()
    assert np.isclose(doubled.sum(), count * np.sin(2 * np.pi / count))
    assert open_sides(triangles) == {(i, (i + 1) % count) for i in range(count)}


@pytest.mark.parametrize("name", builtin_names())
def test_a_bodys_surface_and_its_corners_stay(name):
    mesh = load_object(name).mesh
    cut = with_few_slivers(mesh)
    assert np.array_equal(cut.vertices, mesh.vertices)
    assert not open_sides(cut.triangles)
    assert np.isclose(np.linalg.norm(areas(cut), axis=1).sum(), np.linalg.norm(areas(mesh), axis=1).sum())
    assert np.allclose(areas(cut)[cut.is_marking], areas(mesh)[mesh.is_marking])
    facing = (areas(cut) * cut.corner_normals.mean(axis=1)).sum(axis=1)
    assert (facing > 0).all()
    assert len(mesh.triangles) - len(cut.triangles) == FANS_OF_A_CIRCLE.get(name, 0)


def test_a_fan_loses_its_middle():
    triangles, corners = fan(regular(40))
    cut = with_few_slivers(flat_mesh(triangles, corners))
    assert len(cut.triangles) == 38
    assert 40 not in cut.triangles
    assert open_sides(cut.triangles) == open_sides(np.array(triangles))


def star(count):
    return regular(count) * np.where(np.arange(count) % 2, 0.8, 1.0)[:, None]


def with_a_hole(count):
    outer, inner = regular(count), 0.5 * regular(count)
    strip = [
        ((i, (i + 1) % count, count + i), (count + i, (i + 1) % count, count + (i + 1) % count)) for i in range(count)
    ]
    return [triangle for pair in strip for triangle in pair], np.vstack([outer, inner])


def test_a_face_that_is_no_convex_polygon_or_marked_or_small_stays_as_it_is():
    square = (
        np.repeat([[0, 0], [1, 0], [1, 1], [0, 1]], 10, axis=0)
        + np.repeat([[1, 0], [0, 1], [-1, 0], [0, -1]], 10, axis=0) * np.tile(np.arange(10) / 10, 4)[:, None]
    )
    kept = {
        "star": flat_mesh(*fan(star(40))),
        "ring": flat_mesh(*with_a_hole(40)),
        "corners in a row": flat_mesh(*fan(square, (0.5, 0.5))),
        "marked": flat_mesh(*fan(regular(40)), marked=True),
        "small": flat_mesh(*fan(regular(12))),
    }
    for what, mesh in kept.items():
        assert np.array_equal(with_few_slivers(mesh).triangles, mesh.triangles), what


def test_two_faces_that_touch_in_a_corner_alone_are_two():
    triangles, corners = fan(regular(40))
    shifted = [tuple(41 if corner == 0 else corner + 41 for corner in triangle) for triangle in triangles]
    both = flat_mesh(triangles + shifted, np.vstack([corners, corners + np.array([3.0, 0.0])]))
    assert len(with_few_slivers(both).triangles) == 2 * 38
