"""Models: the PLY and models_info.json say in millimetres what mesh and group say in radii."""

import numpy as np
import pytest
from bop_reader import read_ply, symmetry_transformations
from scipy.spatial.distance import pdist

from symsol_annot.bop import models
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.settings import RenderSettings


@pytest.mark.parametrize("name", ["tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO"])
def test_models_info_states_the_whole_group_and_nothing_else(name):
    spec = load_object(name)
    for group in (spec.symmetry_group, spec.stabiliser):
        stated = symmetry_transformations(models.symmetries_of(group))
        assert len(stated) == len(group)
        nearest = np.array([np.abs(group - R).max(axis=(1, 2)).min() for R in stated])
        assert nearest.max() < 1e-9
        assert len({int(np.abs(group - R).max(axis=(1, 2)).argmin()) for R in stated}) == len(group)


def test_a_trivial_group_is_not_stated():
    assert models.symmetries_of(load_object("cylO").stabiliser) == {}


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_the_ply_is_the_mesh_in_millimetres(tmp_path, name):
    mesh, settings = load_object(name).mesh, RenderSettings()
    (tmp_path / "model.ply").write_bytes(models.to_ply(mesh, settings, 50.0))
    vertices, normals, colours, triangles = read_ply(tmp_path / "model.ply")
    np.testing.assert_allclose(vertices[triangles], 50.0 * mesh.vertices[mesh.triangles], atol=1e-6)
    np.testing.assert_allclose(normals[triangles], mesh.corner_normals, atol=1e-8)
    assert {tuple(row) for row in colours[triangles][mesh.is_marking].reshape(-1, 3)} == {(249, 111, 56)}
    assert {tuple(row) for row in colours[triangles][~mesh.is_marking].reshape(-1, 3)} == {(221, 231, 248)}


def test_sizes_are_those_of_the_vertices():
    mesh = load_object("cone").mesh
    info = models.model_info(mesh, load_object("cone").symmetry_group, 100.0)
    points = 100.0 * mesh.vertices
    assert info["diameter"] == pytest.approx(pdist(points).max(), abs=1e-9)
    for axis, values in zip("xyz", points.T, strict=True):
        assert info[f"min_{axis}"] == values.min()
        assert info[f"size_{axis}"] == pytest.approx(np.ptp(values))


def test_the_diameter_of_points_in_a_plane_is_found():
    assert models.diameter(np.array([[0, 0, 0], [3, 0, 0], [0, 4, 0], [1, 1, 0]], dtype=float)) == 5.0
