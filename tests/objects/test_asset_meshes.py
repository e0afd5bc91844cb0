"""The meshes of the built-in objects: closed, without a flaw, of radius 1, with normals that look outwards."""

import numpy as np
import pytest
from asset_geometry import boundary_edges, every_marked_object, every_object, height_above, triangles_of
from oracle import CONE_BASE_Z, half_spaces
from scipy.optimize import linprog
from scipy.spatial import cKDTree

ROUND = ("cone", "cyl", "cylO")
FLAT = ("tet", "tetX", "cube", "icosa")


def geometric_normals(triangles):
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


# --- the mesh ---


@every_object
def test_every_edge_is_shared_by_two_triangles_in_opposite_directions(meshes, name):
    triangles = meshes[name].triangles
    edges = np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])
    assert len(np.unique(edges, axis=0)) == len(edges)
    np.testing.assert_array_equal(np.unique(edges, axis=0), np.unique(edges[:, ::-1], axis=0))


@every_marked_object
def test_the_cut_is_shared_by_the_body_and_the_marking(meshes, name):
    mesh = meshes[name]
    cut = boundary_edges(mesh.triangles, mesh.is_marking)
    assert {edge[::-1] for edge in cut} == set(boundary_edges(mesh.triangles, ~mesh.is_marking))


@every_object
def test_no_two_vertices_coincide_and_none_is_unused(meshes, name):
    mesh = meshes[name]
    assert cKDTree(mesh.vertices).query(mesh.vertices, k=2)[0][:, 1].min() > 1e-5
    np.testing.assert_array_equal(np.unique(mesh.triangles), np.arange(len(mesh.vertices)))


@every_object
def test_no_vertex_lies_inside_of_another_triangles_edge(meshes, name):
    mesh = meshes[name]
    edges = np.sort(np.concatenate([mesh.triangles[:, [0, 1]], mesh.triangles[:, [1, 2]], mesh.triangles[:, [2, 0]]]))
    edges = np.unique(edges, axis=0)
    starts, along = mesh.vertices[edges[:, 0]], mesh.vertices[edges[:, 1]] - mesh.vertices[edges[:, 0]]
    length_squared = np.square(along).sum(axis=1)
    for index, vertex in enumerate(mesh.vertices):
        part = np.einsum("ei,ei->e", vertex - starts, along) / length_squared
        off = np.linalg.norm(vertex - starts - part[:, None] * along, axis=1)
        assert not np.any((part > 0) & (part < 1) & (off < 1e-6) & np.all(edges != index, axis=1))


@every_object
def test_every_triangle_lies_along_its_facet_and_looks_outwards(meshes, name):
    triangles = triangles_of(meshes[name])
    hit = height_above(name, triangles.mean(axis=1))[1]
    expected = half_spaces(name)[0][hit]
    np.testing.assert_allclose(np.einsum("ti,ti->t", geometric_normals(triangles), expected), 1, rtol=0, atol=1e-6)


@every_object
def test_the_unit_sphere_is_the_smallest_that_holds_the_body(meshes, name):
    distance = np.linalg.norm(meshes[name].vertices, axis=1)
    assert abs(distance.max() - 1) < 1e-8
    touching = meshes[name].vertices[distance > 1 - 1e-7]
    surrounds_the_centre = linprog(
        np.zeros(len(touching)), A_eq=np.vstack([touching.T, np.ones(len(touching))]), b_eq=[0, 0, 0, 1]
    )
    assert surrounds_the_centre.success


@pytest.mark.parametrize("name", ROUND)
def test_a_round_body_has_a_multiple_of_360_facets(meshes, name):
    vertices = meshes[name].vertices
    at_the_base = np.abs(vertices[:, 2] - vertices[:, 2].min()) < 1e-9
    rim = vertices[at_the_base & (np.hypot(vertices[:, 0], vertices[:, 1]) > 0.1)]
    assert len(rim) % 360 == 0
    assert len(rim) > 0


# --- normals ---


def side_of(name, mesh):
    """Which triangles belong to the curved side, by their geometry."""
    flat_z = {"cone": [-1.0], "cyl": [-1.0, 1.0], "cylO": [-1.0, 1.0]}[name]
    return ~np.isclose(geometric_normals(triangles_of(mesh))[:, 2, None], flat_z, atol=1e-6).any(axis=1)


@every_object
def test_normals_have_length_1_and_look_to_the_side_of_their_triangle(meshes, name):
    mesh = meshes[name]
    np.testing.assert_allclose(np.linalg.norm(mesh.corner_normals, axis=-1), 1, rtol=0, atol=1e-12)
    cosines = np.einsum("tci,ti->tc", mesh.corner_normals, geometric_normals(triangles_of(mesh)))
    assert cosines.min() > np.cos(np.radians(0.6))


@pytest.mark.parametrize("name", FLAT)
def test_faces_of_a_solid_with_flat_faces_are_flat(meshes, name):
    mesh = meshes[name]
    expected = np.repeat(geometric_normals(triangles_of(mesh))[:, None], 3, axis=1)
    np.testing.assert_allclose(mesh.corner_normals, expected, rtol=0, atol=1e-7)


@pytest.mark.parametrize("name", ROUND)
def test_the_flat_ends_of_a_round_body_are_flat(meshes, name):
    mesh = meshes[name]
    ends = ~side_of(name, mesh)
    assert np.count_nonzero(ends) == (360 if name == "cone" else 720)
    z = np.sign(triangles_of(mesh)[ends].mean(axis=1)[:, 2])
    expected = z[:, None, None] * np.array([0, 0, 1])
    np.testing.assert_allclose(mesh.corner_normals[ends], np.broadcast_to(expected, (len(z), 3, 3)), atol=1e-9)


@pytest.mark.parametrize("name", ["cyl", "cylO"])
def test_normals_of_the_cylinders_side_are_radial_on_the_cut_too(meshes, name):
    mesh = meshes[name]
    side = side_of(name, mesh)
    assert mesh.is_marking[~side].sum() == 0
    radial = triangles_of(mesh)[side] * [1, 1, 0]
    radial /= np.linalg.norm(radial, axis=-1, keepdims=True)
    np.testing.assert_allclose(mesh.corner_normals[side], radial, rtol=0, atol=1e-6)


def test_normals_of_the_cones_side_have_its_slope(meshes):
    mesh = meshes["cone"]
    corners, normals = (values[side_of("cone", mesh)] for values in (triangles_of(mesh), mesh.corner_normals))
    assert len(corners) == 360
    base_radius, height = (1 - CONE_BASE_Z**2) ** 0.5, 1 - CONE_BASE_Z
    steepness = np.hypot(base_radius, height)
    np.testing.assert_allclose(normals[..., 2], base_radius / steepness, rtol=0, atol=1e-8)
    at_the_apex = np.linalg.norm(corners - [0, 0, 1], axis=-1) < 1e-9
    np.testing.assert_array_equal(at_the_apex.sum(axis=1), 1)
    away = np.where(at_the_apex[..., None], corners.sum(axis=1, keepdims=True), corners) * [1, 1, 0]
    away /= np.linalg.norm(away, axis=-1, keepdims=True)  # at the apex: along the middle of the facet
    np.testing.assert_allclose(normals[..., :2], (away * height / steepness)[..., :2], rtol=0, atol=1e-6)
