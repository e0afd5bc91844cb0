"""Meshes from OBJ files: good ones are read as written, and files that cannot be read are named."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from obj_texts import CORNERS, CUBE, FACES, TETRAHEDRON, H
from scipy.spatial.transform import Rotation

from symsol_annot.errors import ObjectError
from symsol_annot.objects.obj_file import read_mesh


def signed_volume(mesh):
    return np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6


# --- good files ---


def test_vertices_and_triangles_are_those_of_the_file(read_obj):
    mesh = read_obj(TETRAHEDRON)
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
    np.testing.assert_array_equal(mesh.triangles, [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]])
    assert mesh.vertices.dtype == np.float64


def test_a_convex_polygon_becomes_triangles_that_cover_it(read_obj):
    mesh = read_obj(CUBE)
    assert mesh.triangles.shape == (12, 3)
    assert signed_volume(mesh) == pytest.approx((2 * H) ** 3)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    np.testing.assert_allclose(areas, (2 * H) ** 2 / 2)


def test_a_material_holds_until_the_next_and_is_the_body_at_first(read_obj):
    mesh = read_obj(CUBE)
    np.testing.assert_array_equal(mesh.is_marking, [False] * 6 + [True] * 2 + [False] * 4)
    assert mesh.is_marking.dtype == np.bool_
    np.testing.assert_array_equal(mesh.marking_vertices, mesh.vertices[4:8])


def test_a_mesh_without_marking_has_no_marking_vertices(read_obj):
    assert read_obj(TETRAHEDRON).marking_vertices.shape == (0, 3)


def test_a_face_without_normals_is_flat(read_obj):
    mesh = read_obj(TETRAHEDRON)
    np.testing.assert_allclose(mesh.corner_normals, -np.array(CORNERS)[:, None].repeat(3, axis=1), atol=1e-15)


def test_a_normal_is_that_of_its_corner_at_length_1(read_obj):
    normals = read_obj(CUBE).corner_normals
    np.testing.assert_allclose(normals[6:8], np.tile([0, 0, 1], (2, 3, 1)))
    diagonal, outward = np.full(3, H), [1, 0, 0]
    np.testing.assert_allclose(normals[4], [diagonal, outward, diagonal], atol=1e-15)  # of 2/1/2 3 7//2
    np.testing.assert_allclose(normals[5], [diagonal, diagonal, outward], atol=1e-15)  # of 2/1/2 7//2 6


def test_a_texture_index_changes_nothing(read_obj):
    plain = read_obj(CUBE)
    textured = read_obj(CUBE.replace("f 1 2 6 5", "f 1/1 2/1 6/1/ 5/1/"))
    np.testing.assert_array_equal(plain.triangles, textured.triangles)
    np.testing.assert_array_equal(plain.corner_normals, textured.corner_normals)


def test_line_endings_change_nothing(read_obj):
    unix, windows = read_obj(CUBE), read_obj(CUBE.replace("\n", "\r\n"))
    np.testing.assert_array_equal(unix.vertices, windows.vertices)
    np.testing.assert_array_equal(unix.triangles, windows.triangles)


@given(quat=st.tuples(*[st.integers(-9, 9)] * 4).filter(any), order=st.permutations(FACES), turn=st.integers(0, 2))
@settings(deadline=None, max_examples=30)
def test_any_attitude_and_any_order_of_faces_and_corners_is_read_as_written(tmp_path_factory, quat, order, turn):
    vertices = Rotation.from_quat(quat).apply(CORNERS)
    corners = [face.split()[1:] for face in order]
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    lines += ["f " + " ".join(words[turn:] + words[:turn]) for words in corners]
    path = tmp_path_factory.mktemp("turned") / "mesh.obj"
    path.write_text("\n".join(lines), encoding="utf-8")
    mesh = read_mesh(path)
    np.testing.assert_array_equal(mesh.vertices, vertices)
    opposite = [FACES.index(face) for face in order]
    np.testing.assert_allclose(mesh.corner_normals[:, 0], -vertices[opposite], atol=1e-12)


# --- files that cannot be read ---


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ObjectError) as caught:
        read_mesh(tmp_path / "mesh.obj")
    expected = f"{tmp_path / 'mesh.obj'}: no such file; an object is a folder with object.toml and mesh.obj"
    assert str(caught.value) == expected


def test_a_file_that_is_not_utf_8_is_refused(obj_fault_of):
    assert obj_fault_of(b"# caf\xe9\n" + TETRAHEDRON.encode()).startswith("cannot be read: 'utf-8' codec")


def test_a_folder_in_the_place_of_the_file_is_refused(tmp_path):
    (tmp_path / "mesh.obj").mkdir()
    with pytest.raises(ObjectError, match=r"mesh\.obj: cannot be read: "):
        read_mesh(tmp_path / "mesh.obj")
