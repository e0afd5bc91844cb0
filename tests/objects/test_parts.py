"""Objects of format version 2: their parts, and the stabiliser that is derived from them."""

import numpy as np
import pytest
from object_folders import edited
from parted_objects import TOML, add_box, mug, painted, parted_toml, prism

from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.parts import MAX_PARTS, default_colour
from symsol_annot.objects.spec import read_object

D8 = 'kind = "dihedral"\norder = 8'
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)


def test_parts_have_ids_in_their_order_and_those_that_break_the_group_are_found(write):
    spec = read_object(write(TOML, mug()))
    check_object(spec)
    assert [part.name for part in spec.parts] == ["body", "handle"]
    assert spec.parts[0].colour == default_colour(0)
    assert spec.parts[1].colour == (0.1, 0.5, 0.2)
    assert spec.has_general_rule
    assert spec.mesh.breaking == (2,)
    assert np.bincount(spec.mesh.part_ids).tolist() == [0, 8 * 2 + 2 * 6, 12]
    half_turn = np.diag([1.0, -1.0, -1.0])
    np.testing.assert_allclose(spec.stabiliser, [np.eye(3), half_turn], atol=1e-12)
    assert spec.cosets.shape == (8, 2)
    assert spec.tolerance_px == 0.125


def test_a_part_that_keeps_the_group_breaks_nothing(write):
    belt = painted(*((face, "belt") for face in range(8)))
    spec = read_object(write(parted_toml([("body", "clay", None), ("sides", "belt", None)], D8), belt))
    check_object(spec)
    assert spec.mesh.breaking == ()
    assert spec.marking is None
    assert len(spec.stabiliser) == 16


def test_a_part_that_keeps_the_group_and_hides_a_larger_one_is_refused(write):
    mesh = add_box(prism(), (-0.2, -0.2, 0.3), (0.2, 0.2, np.sqrt(1 - 0.08)), "knob")
    toml = parted_toml([("body", "clay", None), ("knob", "knob", None)], 'kind = "cyclic"\norder = 4')
    with pytest.raises(ObjectError, match=r"declares C4, .* without the part 'knob', .* has more: D8"):
        check_object(read_object(write(toml, str(mesh))))


@pytest.mark.parametrize(("faces", "order"), [((0,), 2), ((0, 4), 4), ((0, 2, 4, 6), 8), ((0, 1), 2), ((0, 1, 3), 1)])
def test_the_stabiliser_is_derived_from_painted_faces(write, faces, order):
    parts = [("body", "clay", None), ("dots", "paint", RED)]
    spec = read_object(write(parted_toml(parts, D8), painted(*((face, "paint") for face in faces))))
    check_object(spec)
    assert len(spec.stabiliser) == order
    np.testing.assert_allclose(spec.mesh.vertices[spec.mesh.triangles].shape[1:], (3, 3))


def test_parts_of_different_colours_each_break_the_group(write):
    parts = [("body", "clay", None), ("left", "red", RED), ("right", "blue", BLUE)]
    spec = read_object(write(parted_toml(parts, D8), painted((0, "red"), (4, "blue"))))
    assert spec.mesh.breaking == (2, 3)
    assert len(spec.stabiliser) == 2


def test_parts_that_the_eye_cannot_tell_apart_are_refused(fault_of):
    parts = [("body", "clay", None), ("left", "a", RED), ("right", "b", RED)]
    message, path = fault_of(parted_toml(parts, D8), painted((0, "a"), (4, "b")))
    assert message.startswith(f"{path}, line 12: part.2.name: 'right' looks like 'left'")
    assert message.endswith("Make them one part, or give them different colours")


FAULTS = {
    "selects nothing": ('select = { material = "grip" }', 'select = { material = "x" }', "usemtl grip"),
    "same faces": ('select = { material = "grip" }', 'select = { material = "clay" }', "selects the same faces"),
    "same name": ('name = "handle"', 'name = "body"', "has the name 'body', as part 0 does"),
    "unknown key": ("colour = [0.1, 0.5, 0.2]", "color = [0.1, 0.5, 0.2]", "is not a field of an object.toml"),
    "no colour": ("colour = [0.1, 0.5, 0.2]", "colour = [0.1, 0.5, 2]", "expected three numbers from 0 to 1"),
    "no part of that name": ('of = ["body"]', 'of = ["bodi"]', "expected names of parts (body, handle)"),
    "no tolerance": ("tolerance_px = 0.125", "tolerance_px = 0", "expected a positive number of pixels"),
    "find": ("order = 8", 'order = 8\ngroup = "find"', "is not read: state kind, order and axis"),
    "no material": ('select = { material = "grip" }', "select = { material = 5 }", "expected a string, found 5"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_a_fault_of_a_part_names_what_and_where(write, name):
    old, new, expected = FAULTS[name]
    text, line = edited(TOML, old, new)
    folder = write(text, mug())
    with pytest.raises(ObjectError) as caught:
        read_object(folder)
    message = str(caught.value)
    if name == "selects nothing":  # the mesh is read first, and its material is nobody's
        assert "no [[part]] of object.toml selects the material 'grip'" in message
        return
    assert message.startswith(f"{folder / 'object.toml'}, line {line + ('group' in new)}: "), message
    assert expected in message


def test_paint_in_the_colour_of_what_it_is_on_is_refused(fault_of):
    parts = [("body", "clay", (0.5, 0.5, 0.5)), ("dot", "paint", (0.5, 0.505, 0.5))]
    message, path = fault_of(parted_toml(parts, D8), painted((0, "paint")))
    assert message.startswith(f"{path}, line ")
    assert "part.1.colour: 'dot' is painted on 'body' in its colour" in message


def test_a_part_without_faces_is_refused(fault_of):
    parts = [("body", "clay", None), ("handle", "grip", None), ("lid", "lid", None)]
    message, path = fault_of(parted_toml(parts, D8), mug())
    assert message == f"{path}, line 12: part.2.select.material: selects nothing: no face has the material 'lid'"


def test_a_shell_that_is_inside_out_is_refused(fault_of):
    lines = mug().splitlines()
    start = lines.index("usemtl grip") + 1
    turned = [" ".join(["f", *line.split()[:0:-1]]) for line in lines[start:]]
    message, path = fault_of(TOML, "\n".join([*lines[:start], *turned]))
    assert message.startswith(f"{path}, line 10: part.1.name: the faces of 'handle' look inwards")


def test_faces_before_the_first_material_are_in_no_part(fault_of):
    mesh = mug().replace("usemtl clay\n", "", 1)
    message, _ = fault_of(TOML, mesh)
    assert "a face is in no part, for no 'usemtl' above it says which material it has" in message


def test_more_parts_than_ids_are_refused(fault_of):
    parts = [(f"p{k}", f"m{k}", None) for k in range(MAX_PARTS + 1)]
    message, _ = fault_of(parted_toml(parts, D8), mug())
    assert f"expected 1 to {MAX_PARTS} tables [[part]]" in message


def test_default_colours_differ():
    colours = [default_colour(number) for number in range(MAX_PARTS)]
    assert len(set(colours)) == len(colours)


def test_a_body_without_the_group_is_refused_and_parts_that_grow_out_of_it_are_explained(write):
    folder = write(edited(TOML, "order = 8", "order = 16")[0], mug())
    with pytest.raises(ObjectError, match=r"not invariant under symmetry: .* has to be a closed surface of its own"):
        check_object(read_object(folder))
