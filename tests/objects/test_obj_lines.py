"""OBJ files with a wrong line: refused by its number, in bounded time and memory."""

import time
import tracemalloc

import numpy as np
import pytest
from obj_texts import CORNERS, CUBE, TETRAHEDRON, H, replaced

from symsol_annot.errors import ObjectError

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
def test_a_vertex_is_three_finite_numbers(obj_fault_of, new):
    text, line = replaced(TETRAHEDRON, FIRST_CORNER, new)
    numbers = new[1:].strip()
    assert obj_fault_of(text) == f"line {line}: expected a vertex as three finite numbers, found '{numbers}'"


@pytest.mark.parametrize("new", ["vn 0 0 x", "vn nan 0 1", "vn 0 0 -inf", "vn 0 1", "vn 0 0 1 0"])
def test_a_normal_is_three_finite_numbers(obj_fault_of, new):
    text, line = replaced(CUBE, "vn 0 0 7", new)
    assert obj_fault_of(text) == f"line {line}: expected a normal as three finite numbers, found '{new[3:]}'"


def test_a_normal_of_length_0_is_refused(obj_fault_of):
    text, line = replaced(CUBE, "vn 0 0 7", "vn 0 0 0")
    assert f"line {line}: " in obj_fault_of(text)


@pytest.mark.parametrize("new", ["vertex 0 0 1", "F 2 4 3", "curv 0 1 1 2", "V 0 0 1", "<html>"])
def test_an_unknown_statement_is_refused(obj_fault_of, new):
    text, line = replaced(TETRAHEDRON, "f 2 4 3", new)
    assert obj_fault_of(text) == f"line {line}: unknown statement {new.split()[0]!r}"


@pytest.mark.parametrize("new", ["usemtl paint", "usemtl", "usemtl Marking", "usemtl body marking"])
def test_a_material_is_body_or_marking(obj_fault_of, new):
    text, line = replaced(CUBE, "usemtl marking", new)
    found = new if new != "usemtl" else "usemtl "
    assert obj_fault_of(text) == f"line {line}: expected 'usemtl body' or 'usemtl marking', found '{found}'"


@pytest.mark.parametrize(("new", "count"), [("f 2 4", 2), ("f 2", 1), ("f", 0)])
def test_a_face_has_at_least_3_corners(obj_fault_of, new, count):
    text, line = replaced(TETRAHEDRON, "f 2 4 3", new)
    assert obj_fault_of(text) == f"line {line}: a face needs at least 3 corners, found {count}"


@pytest.mark.parametrize(
    "index", ["5", "0", "-1", "1.0", "x", "+1", "²", "999999999999999999999", "٣", "1_0", "1e0", "0x1"]
)
def test_a_face_names_vertices_that_exist(obj_fault_of, index):
    text, line = replaced(TETRAHEDRON, "f 2 4 3", f"f 2 4 {index}")
    assert obj_fault_of(text) == f"line {line}: vertex {index!r} does not exist; 4 are defined above this line, from 1"


@pytest.mark.parametrize("index", ["3", "0", "-1", "n"])
def test_a_face_names_normals_that_exist(obj_fault_of, index):
    text, line = replaced(CUBE, "f 5//1 6//1 7//1 8//1", f"f 5//1 6//1 7//{index} 8//1")
    assert obj_fault_of(text) == f"line {line}: normal {index!r} does not exist; 2 are defined above this line, from 1"


def test_a_vertex_is_defined_above_the_face_that_uses_it(obj_fault_of):
    lines = TETRAHEDRON.splitlines()
    text = "\n".join([*lines[:3], lines[4], lines[3], *lines[5:]])
    assert obj_fault_of(text) == "line 4: vertex '4' does not exist; 3 are defined above this line, from 1"


def test_comments_and_blank_lines_count_as_lines(obj_fault_of):
    assert obj_fault_of("# one\n\n# three\nv 0 0 x\n").startswith("line 4: ")


@pytest.mark.parametrize("new", ["v 1e308 0 0", "v 0 -1e31 0", "v 1e300 1e300 1e300"])
def test_a_vertex_whose_square_is_no_number_is_refused(obj_fault_of, new):
    text, line = replaced(TETRAHEDRON, FIRST_CORNER, new)
    assert obj_fault_of(text) == f"line {line}: expected a vertex within 1e+30, found '{new[2:]}'"


@pytest.mark.parametrize("new", ["vn 1e-200 0 0", "vn 5e-324 0 0"])
def test_a_normal_whose_direction_is_lost_in_rounding_is_refused(obj_fault_of, new):
    text, line = replaced(CUBE, "vn 0 0 7", new)
    assert obj_fault_of(text) == f"line {line}: expected a normal longer than 1e-30, found '{new[3:]}'"


@pytest.mark.parametrize("length", [1e-29, 1e-8, 1e15, 1e30])
def test_a_normal_of_any_length_within_that_is_the_same_direction(read_obj, length):
    np.testing.assert_array_equal(
        read_obj(CUBE.replace("vn 0 0 7", f"vn 0 0 {length!r}")).corner_normals, read_obj(CUBE).corner_normals
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
def test_a_mesh_without_end_is_one_short_error_in_time(obj_fault_of, text, said):
    start = time.process_time()
    message = obj_fault_of(text)
    assert time.process_time() - start < 10.0
    assert message.startswith(said)
    assert len(message) < 500


def test_words_without_end_take_no_more_memory_than_a_line_may(read_obj):
    """60 MB of short words, as a list of them 2 GB."""
    tracemalloc.start()
    try:
        with pytest.raises(ObjectError, match="more than 1,048,576 characters in line 1"):
            read_obj("f" + " 1" * 30_000_000)
        assert tracemalloc.get_traced_memory()[1] < 2**29
    finally:
        tracemalloc.stop()


def test_a_mesh_of_fifty_thousand_triangles_is_read_in_time(read_obj):
    start = time.process_time()
    mesh = read_obj(sphere(115))
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


def test_line_ends_of_other_scripts_end_no_line(obj_fault_of):
    assert obj_fault_of(f"# a comment\u2028v 1 2 3\n{TETRAHEDRON}v 0 0 x\n").startswith("line 10: ")


def test_a_byte_order_mark_is_passed_over(read_obj):
    np.testing.assert_array_equal(read_obj(b"\xef\xbb\xbf" + TETRAHEDRON.encode()).vertices, CORNERS)
