"""Vertices on the lattice: the camera's projection, rounded, alone and many rotations at once."""

import numpy as np
import pytest

from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.frames.projection import SUBPIXELS, doubled_areas, projected
from symsol_annot.rotations.so3 import uniform_rotations

LATTICE = Camera.filling(224).lattice(2)
R = uniform_rotations(5, np.random.default_rng(2))


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_a_vertex_is_within_half_a_step_of_where_the_camera_sees_it_and_on_the_grid(name):
    vertices = load_object(name).mesh.vertices
    points, z = projected(vertices, R, LATTICE)
    for rotation, found, depths in zip(R, points, z, strict=True):
        world = [rotation @ vertex for vertex in vertices]
        assert np.allclose(depths, [one[2] + 4.0 for one in world])
        assert np.abs(found - LATTICE.project(np.array(world))).max() <= 0.5 / SUBPIXELS + 1e-9
    assert np.array_equal(points * SUBPIXELS, np.round(points * SUBPIXELS))
    alone, _ = projected(vertices, R[3], LATTICE)
    assert np.array_equal(alone, points[3])


def test_what_faces_the_camera_has_a_negative_area():
    mesh = load_object("icosa").mesh
    points, _ = projected(mesh.vertices, R, LATTICE)
    world = np.einsum("nij,tkj->ntki", R, mesh.vertices[mesh.triangles]) + np.array([0.0, 0.0, 4.0])
    normals = np.cross(world[:, :, 1] - world[:, :, 0], world[:, :, 2] - world[:, :, 0])
    faces = (normals * world[:, :, 0]).sum(axis=-1) < 0
    assert np.array_equal(doubled_areas(points, mesh.triangles) < 0, faces)
