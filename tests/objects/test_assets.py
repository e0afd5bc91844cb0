"""The built-in objects: built by the script, symmetric under all of their groups, with a marking that is flush.

Bodies are compared with the half-spaces and formulas of oracle.py, which share nothing with the script.
"""

import shutil
from pathlib import Path

import numpy as np
import pytest
from oracle import CONE_BASE_Z, CYLINDER_RADIUS, CYLINDER_TOP, DISC_RADIUS, DISC_Z, half_spaces, on_marking
from scipy.optimize import linprog
from scipy.spatial import ConvexHull, cKDTree
from scipy.spatial.transform import Rotation
from symsol_annot_assets import build

from symsol_annot.objects.spec import load_object

ASSETS = Path(build.__file__).parent
GROUPS = {"tet": "T", "tetX": "T", "cube": "O", "icosa": "I", "cone": "C360", "cyl": "D360", "cylO": "D360"}
UNMARKED_TWIN = {"tetX": "tet", "cylO": "cyl"}
ROUND = ("cone", "cyl", "cylO")
FLAT = ("tet", "tetX", "cube", "icosa")
FILES = [f"{name}/{file}" for name in GROUPS for file in ("object.toml", "mesh.obj")]
every_object = pytest.mark.parametrize("name", GROUPS)
every_marked_object = pytest.mark.parametrize("name", UNMARKED_TWIN)


@pytest.fixture(scope="module")
def built():
    """What the script builds: path in the folder of the folders to text."""
    return {f"{name}/{file}": text for name in build.OBJECTS for file, text in build.files_of(name).items()}


@pytest.fixture(scope="module")
def meshes():
    return {name: load_object(name).mesh for name in GROUPS}


@pytest.fixture
def run_build(monkeypatch, built):
    """Run the script's command line; what it builds is built once a module, since that takes seconds."""

    def run(*arguments):
        texts = {name: {file: built[f"{name}/{file}"] for file in ("object.toml", "mesh.obj")} for name in GROUPS}
        monkeypatch.setattr(build, "files_of", texts.__getitem__)
        monkeypatch.setattr("sys.argv", ["build", *map(str, arguments)])
        return build.main()

    return run


def group_of(name):
    """All elements of the body's group, as scipy builds it."""
    return Rotation.create_group(GROUPS[name], axis="Z").as_matrix()


def stabiliser_of(name):
    """The elements that a marking's description leaves: the turns about the marked face; the identity."""
    group = group_of(name)
    fixed = [1, 1, 1] if name == "tetX" else [1, 0, DISC_Z]  # the way from the centre to the marking
    return np.abs(group @ fixed - fixed).max(axis=1) < 1e-9


def triangles_of(mesh):
    return mesh.vertices[mesh.triangles]


def geometric_normals(triangles):
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


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


def height_above(name, points):
    """How far outside of the body's nearest half-space points lie (0 on its surface), and which one it is."""
    normals, offsets = half_spaces(name)
    heights = points @ normals.T - offsets
    return heights.max(axis=-1), heights.argmax(axis=-1)


def boundary_edges(triangles, chosen):
    """The edges (start, end) of the chosen triangles that no other chosen one shares."""
    edges = {(t[i], t[(i + 1) % 3]) for t in triangles[chosen].tolist() for i in range(3)}
    return [(start, end) for start, end in edges if (end, start) not in edges]


# --- the script ---


def test_the_committed_folders_are_those_of_the_script():
    assert {path.parent.name for path in ASSETS.glob("*/*.*") if path.suffix in (".toml", ".obj")} == set(GROUPS)
    assert set(build.OBJECTS) == set(GROUPS)


@pytest.mark.parametrize("file", FILES)
def test_a_committed_file_is_byte_for_byte_what_the_script_builds(built, file):
    assert (ASSETS / file).read_bytes().decode("utf-8") == built[file]


def test_the_script_writes_what_its_check_then_accepts(run_build, built, tmp_path, capsys):
    assert run_build("--out", tmp_path) == 0
    assert sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")) == sorted(FILES)
    assert all((tmp_path / file).read_bytes() == built[file].encode() for file in FILES)
    assert run_build("--check", "--out", tmp_path) == 0
    assert capsys.readouterr() == ("", "")


def test_the_check_accepts_the_committed_folders_by_default(run_build, capsys):
    assert run_build("--check") == 0
    assert capsys.readouterr() == ("", "")


def change_a_digit(path):
    data = path.read_bytes()
    index = data.rindex(b"1")
    path.write_bytes(data[:index] + b"2" + data[index + 1 :])


def end_lines_as_windows_does(path):
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))


@pytest.mark.parametrize("file", ["tet/mesh.obj", "cylO/mesh.obj", "tetX/object.toml"])
@pytest.mark.parametrize("tamper", [change_a_digit, end_lines_as_windows_does, Path.unlink])
def test_the_check_names_a_tampered_file_and_no_other_and_mends_nothing(run_build, tmp_path, capsys, file, tamper):
    copy = Path(shutil.copytree(ASSETS, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__")))
    tamper(copy / file)
    before = {path: path.read_bytes() for path in copy.rglob("*.*")}
    assert run_build("--check", "--out", copy) == 1
    assert capsys.readouterr().err == f"{copy / file} is not what symsol_annot_assets.build builds\n"
    assert {path: path.read_bytes() for path in copy.rglob("*.*")} == before


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


# --- cutting polygons ---


def shoelace(polygon):
    x, y = np.asarray(polygon).T
    return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [3, 4, 7, 20])
def test_the_triangles_of_a_polygon_cover_it_once(seed, count):
    rng = np.random.default_rng(seed)
    turns = (np.arange(count) + rng.uniform(0, 0.8, count)) * 2 * np.pi / count
    star = rng.uniform(0.4, 1, count)[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    triangles = build.triangulate(star)
    assert len(triangles) == count - 2
    assert min(shoelace(triangle) for triangle in triangles) > 0
    assert sum(shoelace(triangle) for triangle in triangles) == pytest.approx(shoelace(star))
    assert {tuple(corner) for triangle in triangles for corner in triangle} == {tuple(corner) for corner in star}
