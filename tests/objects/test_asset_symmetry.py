"""The built-in objects: symmetric under all of their groups, with a marking that is flush.

Bodies are compared with the half-spaces and formulas of oracle.py, which share nothing with the script.
"""

import numpy as np
import pytest
from asset_geometry import (
    GROUPS,
    UNMARKED_TWIN,
    boundary_edges,
    every_marked_object,
    every_object,
    height_above,
    triangles_of,
)
from oracle import CYLINDER_RADIUS, CYLINDER_TOP, DISC_RADIUS, DISC_Z, on_marking
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation

from symsol_annot.objects.spec import load_object


def group_of(name):
    """All elements of the body's group, as scipy builds it."""
    return Rotation.create_group(GROUPS[name], axis="Z").as_matrix()


def stabiliser_of(name):
    """The elements that a marking's description leaves: the turns about the marked face; the identity."""
    group = group_of(name)
    fixed = [1, 1, 1] if name == "tetX" else [1, 0, DISC_Z]  # the way from the centre to the marking
    return np.abs(group @ fixed - fixed).max(axis=1) < 1e-9


def areas_of(triangles):
    return np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1) / 2


def volume_of(triangles):
    return np.linalg.det(triangles).sum() / 6


def area_centroid(triangles):
    return areas_of(triangles) @ triangles.mean(axis=1) / areas_of(triangles).sum()


def points_on(triangles, count, seed=0):
    """Points spread over triangles by area."""
    rng = np.random.default_rng(seed)
    areas = areas_of(triangles)
    chosen = triangles[rng.choice(len(triangles), count, p=areas / areas.sum())]
    return np.einsum("pc,pci->pi", rng.dirichlet(np.ones(3), count), chosen)


# --- symmetry ---


@pytest.mark.parametrize("name", ["tet", "cube", "icosa", "cone", "cyl"])
def test_vertices_of_an_unmarked_body_are_mapped_onto_each_other_by_every_element(meshes, name):
    vertices = meshes[name].vertices
    turned = np.einsum("gij,vj->gvi", group_of(name), vertices)
    assert cKDTree(vertices).query(turned, p=np.inf)[0].max() < 1e-6


@every_object
def test_every_element_maps_the_surface_onto_the_surface(meshes, name):
    points = points_on(triangles_of(meshes[name]), 60)
    for elements in np.array_split(group_of(name), 12):
        height, _ = height_above(name, np.einsum("gij,pj->gpi", elements, points))
        assert np.abs(height).max() < 1e-6


@every_object
def test_the_surface_is_all_of_the_bodys(meshes, name):
    triangles = triangles_of(meshes[name])
    hull = ConvexHull(meshes[name].vertices)
    assert np.abs(height_above(name, triangles.reshape(-1, 3))[0]).max() < 1e-7
    assert areas_of(triangles).sum() == pytest.approx(hull.area, rel=1e-7)
    assert volume_of(triangles) == pytest.approx(hull.volume, rel=1e-7)


def test_the_half_spaces_notice_a_surface_that_is_turned_by_half_a_facet(meshes):
    half_a_degree = Rotation.from_rotvec([0, 0, np.radians(0.5)]).as_matrix()
    height, _ = height_above("cyl", points_on(triangles_of(meshes["cyl"]), 60) @ half_a_degree.T)
    assert np.abs(height).max() > 1e-6


@every_marked_object
def test_the_marking_is_mapped_onto_itself_by_its_stabiliser(meshes, name):
    stabiliser = group_of(name)[stabiliser_of(name)]
    marking = triangles_of(meshes[name])[meshes[name].is_marking]
    for element in stabiliser:
        turned = points_on(marking, 500) @ element.T
        assert on_marking(name, turned, height_above(name, turned)[1]).all()


@every_marked_object
def test_every_other_element_moves_the_marking(meshes, name):
    others = group_of(name)[~stabiliser_of(name)]
    marking = triangles_of(meshes[name])[meshes[name].is_marking]
    centroid = area_centroid(marking)
    assert np.linalg.norm(others @ centroid - centroid, axis=1).min() > 0.01
    turned = np.einsum("gij,pj->gpi", others, points_on(marking, 500))
    kept = [on_marking(name, points, height_above(name, points)[1]) for points in turned]
    assert not np.all(kept, axis=1).any()


@every_marked_object
def test_the_declared_stabiliser_is_what_keeps_the_markings_centroid(meshes, name):
    spec = load_object(name)
    centroid = area_centroid(triangles_of(spec.mesh)[spec.mesh.is_marking])
    group = group_of(name)
    kept = group[np.linalg.norm(group @ centroid - centroid, axis=1) < 1e-6]
    assert len(spec.stabiliser) == len(kept) == {"tetX": 3, "cylO": 1}[name]
    assert cKDTree(kept.reshape(-1, 9)).query(spec.stabiliser.reshape(-1, 9))[0].max() < 1e-9


# --- the marking ---


@every_marked_object
def test_the_marking_is_flush_with_the_unmarked_body(meshes, name):
    twin = ConvexHull(meshes[UNMARKED_TWIN[name]].vertices)
    normals, offsets = twin.equations[:, :3], twin.equations[:, 3]
    heights = meshes[name].vertices @ normals.T + offsets
    assert np.abs(heights.max(axis=1)).max() < 1e-7


@every_marked_object
def test_marking_a_body_changes_neither_its_surface_nor_its_volume(meshes, name):
    marked, plain = triangles_of(meshes[name]), triangles_of(meshes[UNMARKED_TWIN[name]])
    assert areas_of(marked).sum() == pytest.approx(areas_of(plain).sum(), rel=1e-7)
    assert volume_of(marked) == pytest.approx(volume_of(plain), rel=1e-7)
    corners = meshes[UNMARKED_TWIN[name]].vertices
    assert cKDTree(meshes[name].vertices).query(corners)[0].max() < 1e-8


@every_marked_object
def test_what_is_marked_is_the_oracles_marking(meshes, name):
    mesh = meshes[name]
    marking, body = triangles_of(mesh)[mesh.is_marking], triangles_of(mesh)[~mesh.is_marking]
    inside, outside = points_on(marking, 2000), points_on(body, 20000)
    assert on_marking(name, inside, height_above(name, inside)[1]).all()
    wrong = outside[on_marking(name, outside, height_above(name, outside)[1])]
    if name == "cylO":  # the disc's edge is a polygon inside of the circle
        wrong = wrong[np.hypot(*(unrolled(wrong) - [0, DISC_Z]).T) < 0.998 * DISC_RADIUS]
    assert len(wrong) == 0


def test_the_tetrahedrons_marking_is_one_whole_face(meshes):
    mesh = meshes["tetX"]
    marking = triangles_of(mesh)[mesh.is_marking]
    assert marking.shape == (1, 3, 3)
    corners = np.array([[1, -1, -1], [-1, 1, -1], [-1, -1, 1]]) / 3**0.5
    assert cKDTree(marking[0]).query(corners)[0].max() < 1e-8
    assert areas_of(marking).sum() == pytest.approx(areas_of(triangles_of(mesh)).sum() / 4)


def unrolled(points):
    """Points of the cylinder's side as (arc along the prism from its x axis, z)."""
    degrees = np.degrees(np.arctan2(points[:, 1], points[:, 0]))
    middle = np.floor(degrees + 1e-7) + 0.5
    chord, apothem = 2 * CYLINDER_RADIUS * np.sin(np.radians(0.5)), CYLINDER_RADIUS * np.cos(np.radians(0.5))
    return np.stack([middle * chord + apothem * np.tan(np.radians(degrees - middle)), points[:, 2]], axis=1)


def test_the_cylinders_marking_is_a_disc_a_fifth_of_the_cylinder_wide(meshes):
    mesh = meshes["cylO"]
    size = np.ptp(unrolled(mesh.marking_vertices), axis=0)
    diameter = 2 * np.linalg.norm(mesh.vertices[:, :2], axis=1).max()
    np.testing.assert_allclose(size, diameter / 5, rtol=1e-6)


def test_the_cylinders_marking_has_the_area_of_a_disc(meshes):
    mesh = meshes["cylO"]
    radius = 0.2 * np.linalg.norm(mesh.vertices[:, :2], axis=1).max()
    area = areas_of(triangles_of(mesh)[mesh.is_marking]).sum()
    assert area == pytest.approx(np.pi * radius**2, rel=1e-3)


def test_the_edge_of_the_cylinders_marking_is_a_circle(meshes):
    mesh = meshes["cylO"]
    edge = np.unique(boundary_edges(mesh.triangles, mesh.is_marking))
    assert len(edge) >= 96
    distance = np.hypot(*(unrolled(mesh.vertices[edge]) - [0, DISC_Z]).T)
    np.testing.assert_allclose(distance, DISC_RADIUS, rtol=0, atol=1e-7)


def test_the_cylinders_marking_lies_on_the_side_near_one_end(meshes):
    z = meshes["cylO"].marking_vertices[:, 2]
    assert z.min() > 0
    assert z.max() < CYLINDER_TOP - 0.01
