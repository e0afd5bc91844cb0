"""OBJ files whose lines are right and whose surface is not: open, turned inside out, flat, of another radius."""

import pytest
from obj_texts import CORNERS, FACES, TETRAHEDRON, replaced


@pytest.mark.parametrize("text", ["", "# nothing\n", "\n".join(TETRAHEDRON.splitlines()[:4])])
def test_a_mesh_without_faces_is_refused(obj_fault_of, text):
    assert obj_fault_of(text) == "no faces ('f' lines) found"


@pytest.mark.parametrize("face", FACES)
def test_a_mesh_with_a_hole_is_refused_with_an_edge_of_the_hole(obj_fault_of, face):
    text, _ = replaced(TETRAHEDRON, face, "# gone")
    message = obj_fault_of(text)
    assert message.startswith("the surface is not closed at the edge between vertices ")
    start, end = message.split("vertices ")[1].split(":")[0].split(" and ")
    assert {start, end} < set(face.split()[1:])


def test_a_face_that_is_there_twice_is_refused(obj_fault_of):
    assert obj_fault_of(TETRAHEDRON + FACES[0]).startswith("the surface is not closed at the edge between vertices ")


def test_one_face_turned_inside_out_is_refused(obj_fault_of):
    text, _ = replaced(TETRAHEDRON, "f 2 4 3", "f 2 3 4")
    assert obj_fault_of(text).startswith("the surface is not closed at the edge between vertices ")


def test_a_crack_between_equal_but_separate_vertices_is_refused(obj_fault_of):
    lines = TETRAHEDRON.splitlines()
    text = "\n".join([*lines[:4], lines[0], *lines[4:7], "f 5 2 3"])
    assert obj_fault_of(text).startswith("the surface is not closed at the edge between vertices ")


def test_a_mesh_turned_inside_out_is_refused(obj_fault_of):
    inwards = TETRAHEDRON
    for face in FACES:
        inwards, _ = replaced(inwards, face, "f " + " ".join(reversed(face.split()[1:])))
    assert obj_fault_of(inwards) == "the faces look inwards; wind them counter-clockwise seen from outside"


@pytest.mark.parametrize("new", ["f 2 4 4", "f 2 2 2"])
def test_a_triangle_that_names_a_vertex_twice_has_no_area(obj_fault_of, new):
    text, _ = replaced(TETRAHEDRON, "f 1 3 4", new)
    assert "has no area" in obj_fault_of(text)


def split_edge(text):
    """Put a vertex on the middle of the edge 2-3, as corner of a sliver without area: line 10 of the text."""
    lines = text.splitlines()
    middle = " ".join(repr((a + b) / 2) for a, b in zip(CORNERS[1], CORNERS[2], strict=True))
    return "\n".join([*lines[:4], f"v {middle}", *lines[4:], "f 2 5 3"])


def test_a_triangle_of_three_vertices_on_a_line_has_no_area(obj_fault_of):
    assert "has no area" in obj_fault_of(split_edge(TETRAHEDRON))


def test_a_triangle_without_area_is_named_by_its_line(obj_fault_of):
    assert "line 10" in obj_fault_of(split_edge(TETRAHEDRON))


def scaled(factor):
    lines = [f"v {factor * x!r} {factor * y!r} {factor * z!r}" for x, y, z in CORNERS]
    return "\n".join([*lines, *FACES])


@pytest.mark.parametrize("radius", [0.5, 0.99999, 1.00001, 3.0])
def test_a_bounding_sphere_of_another_radius_is_refused_with_the_scale_that_mends_it(read_obj, obj_fault_of, radius):
    message = obj_fault_of(scaled(radius))
    assert message.startswith(f"the vertices reach {radius:.9g} from the origin, expected 1: ")
    scale = float(message.rsplit(" by ", 1)[1])
    assert read_obj(scaled(radius * scale)).vertices.shape == (4, 3)


def test_a_bounding_sphere_may_be_off_by_rounding(read_obj):
    assert read_obj(scaled(1 + 5e-7)).vertices.shape == (4, 3)


def test_a_vertex_that_no_face_uses_does_not_set_the_bounding_sphere(obj_fault_of):
    lines = scaled(0.5).splitlines()
    text = "\n".join([*lines[:4], "v 0 0 1", *lines[4:]])
    assert obj_fault_of(text).startswith("the vertices reach 0.5 from the origin")
