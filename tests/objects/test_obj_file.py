"""Reading mesh.obj: what a good file says is what is read, and every fault is refused where it stands."""

import time
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from symsol_annot.errors import ObjectError
from symsol_annot.objects.obj_file import read_mesh

H = 1 / 3**0.5
CORNERS = [(H, H, H), (H, -H, -H), (-H, H, -H), (-H, -H, H)]
FACES = ["f 2 4 3", "f 1 3 4", "f 1 4 2", "f 1 2 3"]  # face k is opposite corner k
TETRAHEDRON = "\n".join([*(f"v {x!r} {y!r} {z!r}" for x, y, z in CORNERS), *FACES]) + "\n"
CUBE = f"""\
# a cube, as exporters write it
mtllib cube.mtl
o Cube

v -{H} -{H} -{H}
v {H} -{H} -{H}   # a comment behind a statement
v {H} {H} -{H}
v -{H} {H} -{H}
v -{H} -{H} {H}
v {H} -{H} {H}
v {H} {H} {H}
v -{H} {H} {H}
vt 0.5 0.5
vn 0 0 7
vn 1 1 1
s off
g sides
f 1/1 4/1 3/1 2/1
f 1 2 6 5
f 2/1/2 3 7//2 6
usemtl marking
f 5//1 6//1 7//1 8//1
usemtl body
f 3 4 8 7
f 4 1 5 8
"""


@pytest.fixture
def read(tmp_path):
    """Read a text as a mesh.obj."""

    def read_text(text):
        path = tmp_path / "mesh.obj"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return read_mesh(path)

    return read_text


@pytest.fixture
def fault_of(read, tmp_path):
    """Return the message that a text is refused with, less the file's path, which it must start with."""

    def message(text):
        with pytest.raises(ObjectError) as caught:
            read(text)
        path, where_and_what = str(tmp_path / "mesh.obj"), str(caught.value)
        assert where_and_what.startswith(path)
        return where_and_what.removeprefix(path).lstrip(":, ")

    return message


def replaced(text, old, new):
    """Replace one statement; also return the number of its line."""
    lines = text.splitlines()
    (index,) = [i for i, line in enumerate(lines) if line == old]
    lines[index] = new
    return "\n".join(lines) + "\n", index + 1


def signed_volume(mesh):
    return np.linalg.det(mesh.vertices[mesh.triangles]).sum() / 6


# --- good files ---


def test_vertices_and_triangles_are_those_of_the_file(read):
    mesh = read(TETRAHEDRON)
    np.testing.assert_array_equal(mesh.vertices, CORNERS)
    np.testing.assert_array_equal(mesh.triangles, [[1, 3, 2], [0, 2, 3], [0, 3, 1], [0, 1, 2]])
    assert mesh.vertices.dtype == np.float64


def test_a_convex_polygon_becomes_triangles_that_cover_it(read):
    mesh = read(CUBE)
    assert mesh.triangles.shape == (12, 3)
    assert signed_volume(mesh) == pytest.approx((2 * H) ** 3)
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    np.testing.assert_allclose(areas, (2 * H) ** 2 / 2)


def test_a_material_holds_until_the_next_and_is_the_body_at_first(read):
    mesh = read(CUBE)
    np.testing.assert_array_equal(mesh.is_marking, [False] * 6 + [True] * 2 + [False] * 4)
    assert mesh.is_marking.dtype == np.bool_
    np.testing.assert_array_equal(mesh.marking_vertices, mesh.vertices[4:8])


def test_a_mesh_without_marking_has_no_marking_vertices(read):
    assert read(TETRAHEDRON).marking_vertices.shape == (0, 3)


def test_a_face_without_normals_is_flat(read):
    mesh = read(TETRAHEDRON)
    np.testing.assert_allclose(mesh.corner_normals, -np.array(CORNERS)[:, None].repeat(3, axis=1), atol=1e-15)


def test_a_normal_is_that_of_its_corner_at_length_1(read):
    normals = read(CUBE).corner_normals
    np.testing.assert_allclose(normals[6:8], np.tile([0, 0, 1], (2, 3, 1)))
    diagonal, outward = np.full(3, H), [1, 0, 0]
    np.testing.assert_allclose(normals[4], [diagonal, outward, diagonal], atol=1e-15)  # of 2/1/2 3 7//2
    np.testing.assert_allclose(normals[5], [diagonal, diagonal, outward], atol=1e-15)  # of 2/1/2 7//2 6


def test_a_texture_index_changes_nothing(read):
    plain = read(CUBE)
    textured = read(CUBE.replace("f 1 2 6 5", "f 1/1 2/1 6/1/ 5/1/"))
    np.testing.assert_array_equal(plain.triangles, textured.triangles)
    np.testing.assert_array_equal(plain.corner_normals, textured.corner_normals)


def test_line_endings_change_nothing(read):
    unix, windows = read(CUBE), read(CUBE.replace("\n", "\r\n"))
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


# --- faults of one line ---

FIRST_CORNER = f"v {H!r} {H!r} {H!r}"


@pytest.mark.parametrize(
    "new",
    [
        "v 1 2 three",
        "v 0.5 nan 0.5",
        "v 0.5 inf 0.5",
        "v 1e999 0 0",
        "v 0.5 0.5",
        "v 0.5 0.5 0.5 1",
        "v",
        "v 0,5 0,5 0,5",
        "v 1_0 0 0",
        "v 0.5 0.5 0.5_0",
        "v \u0660.\u0665 0 0",
        "v 0.5 infinity 0.5",
        "v 0x1 0 0",
    ],
)
def test_a_vertex_is_three_finite_numbers(fault_of, new):
    text, line = replaced(TETRAHEDRON, FIRST_CORNER, new)
    numbers = new[1:].strip()
    assert fault_of(text) == f"line {line}: expected a vertex as three finite numbers, found '{numbers}'"


@pytest.mark.parametrize("new", ["vn 0 0 x", "vn nan 0 1", "vn 0 0 -inf", "vn 0 1", "vn 0 0 1 0"])
def test_a_normal_is_three_finite_numbers(fault_of, new):
    text, line = replaced(CUBE, "vn 0 0 7", new)
    assert fault_of(text) == f"line {line}: expected a normal as three finite numbers, found '{new[3:]}'"


def test_a_normal_of_length_0_is_refused(fault_of):
    text, line = replaced(CUBE, "vn 0 0 7", "vn 0 0 0")
    assert f"line {line}: " in fault_of(text)


@pytest.mark.parametrize("new", ["vertex 0 0 1", "F 2 4 3", "curv 0 1 1 2", "V 0 0 1", "<html>"])
def test_an_unknown_statement_is_refused(fault_of, new):
    text, line = replaced(TETRAHEDRON, "f 2 4 3", new)
    assert fault_of(text) == f"line {line}: unknown statement {new.split()[0]!r}"


@pytest.mark.parametrize("new", ["usemtl paint", "usemtl", "usemtl Marking", "usemtl body marking"])
def test_a_material_is_body_or_marking(fault_of, new):
    text, line = replaced(CUBE, "usemtl marking", new)
    found = new if new != "usemtl" else "usemtl "
    assert fault_of(text) == f"line {line}: expected 'usemtl body' or 'usemtl marking', found '{found}'"


@pytest.mark.parametrize(("new", "count"), [("f 2 4", 2), ("f 2", 1), ("f", 0)])
def test_a_face_has_at_least_3_corners(fault_of, new, count):
    text, line = replaced(TETRAHEDRON, "f 2 4 3", new)
    assert fault_of(text) == f"line {line}: a face needs at least 3 corners, found {count}"


@pytest.mark.parametrize(
    "index", ["5", "0", "-1", "1.0", "x", "+1", "²", "999999999999999999999", "٣", "1_0", "1e0", "0x1"]
)
def test_a_face_names_vertices_that_exist(fault_of, index):
    text, line = replaced(TETRAHEDRON, "f 2 4 3", f"f 2 4 {index}")
    assert fault_of(text) == f"line {line}: vertex {index!r} does not exist; 4 are defined above this line, from 1"


@pytest.mark.parametrize("index", ["3", "0", "-1", "n"])
def test_a_face_names_normals_that_exist(fault_of, index):
    text, line = replaced(CUBE, "f 5//1 6//1 7//1 8//1", f"f 5//1 6//1 7//{index} 8//1")
    assert fault_of(text) == f"line {line}: normal {index!r} does not exist; 2 are defined above this line, from 1"


def test_a_vertex_is_defined_above_the_face_that_uses_it(fault_of):
    lines = TETRAHEDRON.splitlines()
    text = "\n".join([*lines[:3], lines[4], lines[3], *lines[5:]])
    assert fault_of(text) == "line 4: vertex '4' does not exist; 3 are defined above this line, from 1"


def test_comments_and_blank_lines_count_as_lines(fault_of):
    assert fault_of("# one\n\n# three\nv 0 0 x\n").startswith("line 4: ")


@pytest.mark.parametrize("new", ["v 1e308 0 0", "v 0 -1e31 0", "v 1e300 1e300 1e300"])
def test_a_vertex_whose_square_is_no_number_is_refused(fault_of, new):
    text, line = replaced(TETRAHEDRON, FIRST_CORNER, new)
    assert fault_of(text) == f"line {line}: expected a vertex within 1e+30, found '{new[2:]}'"


@pytest.mark.parametrize("new", ["vn 1e-200 0 0", "vn 5e-324 0 0"])
def test_a_normal_whose_direction_is_lost_in_rounding_is_refused(fault_of, new):
    text, line = replaced(CUBE, "vn 0 0 7", new)
    assert fault_of(text) == f"line {line}: expected a normal longer than 1e-30, found '{new[3:]}'"


@pytest.mark.parametrize("length", [1e-29, 1e-8, 1e15, 1e30])
def test_a_normal_of_any_length_within_that_is_the_same_direction(read, length):
    np.testing.assert_array_equal(
        read(CUBE.replace("vn 0 0 7", f"vn 0 0 {length!r}")).corner_normals, read(CUBE).corner_normals
    )


# --- files that were made to do harm ---

POINTS, CORNER_LINES = "\n".join(TETRAHEDRON.splitlines()[:4]) + "\n", "f 1 2 3 4\n"
BOMBS = {
    "a line of 60 MB": (" " * 60_000_000, "more than 1,048,576 characters in line 1"),
    "a face of 10^6 corners": (POINTS + "f" + " 1" * 600_000, "more than 1,048,576 characters in line 5"),
    "a face of 500,000 corners": (POINTS + "f" + " 1" * 500_000, "more than 250,000 triangles"),
    "250,000 triangles and two": (POINTS + CORNER_LINES * 125_001, "more than 250,000 triangles"),
    "a quarter million of vertices": ("v 0.1 0.2 0.3\n" * 250_001, "more than 250,000 vertices or normals"),
    "a quarter million of normals": ("vn 0 0 1\n" * 250_001, "more than 250,000 vertices or normals"),
    "millions of lines": ("\n" * 3_000_001, "more than 3,000,000 lines"),
    "an index of 10^6 digits": (POINTS + f"f 1 2 {'9' * 1_000_000}", "line 5: vertex '9999"),
    "an index of zeros and one": (POINTS + f"f 1 2 {'0' * 1_000_000}3", "line 5: vertex '0000"),
    "a number of 10^6 digits": (f"v 1 2 {'9' * 1_000_000}", "line 1: expected a vertex as three finite numbers"),
    "a keyword of 10^6 letters": ("x" * 1_000_000, "line 1: unknown statement 'xxx"),
    "a material of 10^6 letters": (f"usemtl {'x' * 1_000_000}", "line 1: expected 'usemtl body'"),
    "NUL bytes": ("\0" * 1000 + TETRAHEDRON, "line 1: unknown statement '\\x00"),
}


@pytest.mark.parametrize(("text", "said"), BOMBS.values(), ids=BOMBS)
def test_a_mesh_without_end_is_one_short_error_in_time(fault_of, text, said):
    start = time.process_time()
    message = fault_of(text)
    assert time.process_time() - start < 10.0
    assert message.startswith(said)
    assert len(message) < 500


def test_words_without_end_take_no_more_memory_than_a_line_may(read):
    """60 MB of short words, as a list of them 2 GB."""
    tracemalloc.start()
    try:
        with pytest.raises(ObjectError, match="more than 1,048,576 characters in line 1"):
            read("f" + " 1" * 30_000_000)
        assert tracemalloc.get_traced_memory()[1] < 2**29
    finally:
        tracemalloc.stop()


def test_a_mesh_of_fifty_thousand_triangles_is_read_in_time(read):
    start = time.process_time()
    mesh = read(sphere(115))
    assert time.process_time() - start < 10.0
    assert len(mesh.triangles) == 4 * 115 * 114


def sphere(rows):
    """A sphere of meridians and parallels, its quadrilaterals not split."""
    columns = 2 * rows
    angles = np.arange(columns) * np.pi / rows
    lines = ["v 0 0 1", "v 0 0 -1"]
    for polar in np.arange(1, rows) * np.pi / rows:
        x, y, z = np.sin(polar) * np.cos(angles), np.sin(polar) * np.sin(angles), np.cos(polar)
        lines += [f"v {x[j]:.15f} {y[j]:.15f} {z:.15f}" for j in range(columns)]

    def at(row, column):
        return 3 + (row - 1) * columns + column % columns

    for j in range(columns):
        lines += [f"f 1 {at(1, j)} {at(1, j + 1)}", f"f 2 {at(rows - 1, j + 1)} {at(rows - 1, j)}"]
        lines += [f"f {at(i, j)} {at(i + 1, j)} {at(i + 1, j + 1)} {at(i, j + 1)}" for i in range(1, rows - 1)]
    return "\n".join(lines)


def test_line_ends_of_other_scripts_end_no_line(fault_of):
    assert fault_of(f"# a comment\u2028v 1 2 3\n{TETRAHEDRON}v 0 0 x\n").startswith("line 10: ")


def test_a_byte_order_mark_is_passed_over(read):
    np.testing.assert_array_equal(read(b"\xef\xbb\xbf" + TETRAHEDRON.encode()).vertices, CORNERS)


# --- faults of the whole ---


@pytest.mark.parametrize("text", ["", "# nothing\n", "\n".join(TETRAHEDRON.splitlines()[:4])])
def test_a_mesh_without_faces_is_refused(fault_of, text):
    assert fault_of(text) == "no faces ('f' lines) found"


@pytest.mark.parametrize("face", FACES)
def test_a_mesh_with_a_hole_is_refused_with_an_edge_of_the_hole(fault_of, face):
    text, _ = replaced(TETRAHEDRON, face, "# gone")
    message = fault_of(text)
    assert message.startswith("the surface is not closed at the edge between vertices ")
    start, end = message.split("vertices ")[1].split(":")[0].split(" and ")
    assert {start, end} < set(face.split()[1:])


def test_a_face_that_is_there_twice_is_refused(fault_of):
    assert fault_of(TETRAHEDRON + FACES[0]).startswith("the surface is not closed at the edge between vertices ")


def test_one_face_turned_inside_out_is_refused(fault_of):
    text, _ = replaced(TETRAHEDRON, "f 2 4 3", "f 2 3 4")
    assert fault_of(text).startswith("the surface is not closed at the edge between vertices ")


def test_a_crack_between_equal_but_separate_vertices_is_refused(fault_of):
    lines = TETRAHEDRON.splitlines()
    text = "\n".join([*lines[:4], lines[0], *lines[4:7], "f 5 2 3"])
    assert fault_of(text).startswith("the surface is not closed at the edge between vertices ")


def test_a_mesh_turned_inside_out_is_refused(fault_of):
    inwards = TETRAHEDRON
    for face in FACES:
        inwards, _ = replaced(inwards, face, "f " + " ".join(reversed(face.split()[1:])))
    assert fault_of(inwards) == "the faces look inwards; wind them counter-clockwise seen from outside"


@pytest.mark.parametrize("new", ["f 2 4 4", "f 2 2 2"])
def test_a_triangle_that_names_a_vertex_twice_has_no_area(fault_of, new):
    text, _ = replaced(TETRAHEDRON, "f 1 3 4", new)
    assert "has no area" in fault_of(text)


def split_edge(text):
    """Put a vertex on the middle of the edge 2-3, as corner of a sliver without area: line 10 of the text."""
    lines = text.splitlines()
    middle = " ".join(repr((a + b) / 2) for a, b in zip(CORNERS[1], CORNERS[2], strict=True))
    return "\n".join([*lines[:4], f"v {middle}", *lines[4:], "f 2 5 3"])


def test_a_triangle_of_three_vertices_on_a_line_has_no_area(fault_of):
    assert "has no area" in fault_of(split_edge(TETRAHEDRON))


def test_a_triangle_without_area_is_named_by_its_line(fault_of):
    assert "line 10" in fault_of(split_edge(TETRAHEDRON))


def scaled(factor):
    lines = [f"v {factor * x!r} {factor * y!r} {factor * z!r}" for x, y, z in CORNERS]
    return "\n".join([*lines, *FACES])


@pytest.mark.parametrize("radius", [0.5, 0.99999, 1.00001, 3.0])
def test_a_bounding_sphere_of_another_radius_is_refused_with_the_scale_that_mends_it(read, fault_of, radius):
    message = fault_of(scaled(radius))
    assert message.startswith(f"the vertices reach {radius:.9g} from the origin, expected 1: ")
    scale = float(message.rsplit(" by ", 1)[1])
    assert read(scaled(radius * scale)).vertices.shape == (4, 3)


def test_a_bounding_sphere_may_be_off_by_rounding(read):
    assert read(scaled(1 + 5e-7)).vertices.shape == (4, 3)


def test_a_vertex_that_no_face_uses_does_not_set_the_bounding_sphere(fault_of):
    lines = scaled(0.5).splitlines()
    text = "\n".join([*lines[:4], "v 0 0 1", *lines[4:]])
    assert fault_of(text).startswith("the vertices reach 0.5 from the origin")


# --- files that cannot be read ---


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ObjectError) as caught:
        read_mesh(tmp_path / "mesh.obj")
    expected = f"{tmp_path / 'mesh.obj'}: no such file; an object is a folder with object.toml and mesh.obj"
    assert str(caught.value) == expected


def test_a_file_that_is_not_utf_8_is_refused(fault_of):
    assert fault_of(b"# caf\xe9\n" + TETRAHEDRON.encode()).startswith("cannot be read: 'utf-8' codec")


def test_a_folder_in_the_place_of_the_file_is_refused(tmp_path):
    (tmp_path / "mesh.obj").mkdir()
    with pytest.raises(ObjectError, match=r"mesh\.obj: cannot be read: "):
        read_mesh(tmp_path / "mesh.obj")
