"""What an object declares is held against its mesh: too small groups, hidden ones, parts that fix too little."""

import numpy as np
import pytest
from made_solids import CAN, SOLIDS, box, joined, lathe, moved, turned
from object_folders import toml_of
from parted_objects import parted_toml

from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.spec import read_object
from symsol_annot.rotations.so3 import rotations_about

CYCLIC, DIHEDRAL = 'kind = "cyclic"\norder = {}', 'kind = "dihedral"\norder = {}'
TRIVIAL = CYCLIC.format(1)
BANDED = [(0, -0.6), (0.8, -0.6), (0.8, -0.2), (0.8, 0.2), (0.8, 0.6), (0, 0.6)]
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)


def obj_of(solid, material_of=None, materials=("body", "marking")):
    """Return a solid as an OBJ whose farthest vertex is on the unit sphere; the origin stays where it is."""
    vertices, triangles = solid
    vertices = vertices / np.linalg.norm(vertices, axis=1).max()
    material_of = np.zeros(len(triangles), dtype=int) if material_of is None else np.asarray(material_of)
    lines = [f"v {x:.12f} {y:.12f} {z:.12f}" for x, y, z in vertices]
    for number, material in enumerate(materials):
        chosen = triangles[material_of == number] + 1
        lines += [f"usemtl {material}"] * (len(chosen) > 0)
        lines += [f"f {a} {b} {c}" for a, b, c in chosen.tolist()]
    return "\n".join(lines) + "\n"


def dotted(*facets, of=64, profile=BANDED, phase=0.0):
    """Return a can with faces of its middle band marked, turned about its axis by a phase, as an OBJ."""
    vertices, triangles = lathe(profile, of)
    centres = vertices[triangles].mean(axis=1)
    facet = np.floor(np.arctan2(centres[:, 1], centres[:, 0]) / (2 * np.pi / of)).astype(int) % of
    is_band = (np.abs(centres[:, 2]) < 0.2) & (np.hypot(centres[:, 0], centres[:, 1]) > 0.75)
    R = rotations_about((0, 0, 1), phase)
    return obj_of((vertices @ R.T, triangles), is_band & np.isin(facet, facets))


def ball(facets=360):
    angles = np.linspace(-np.pi / 2, np.pi / 2, facets // 2 + 1)[1:-1]
    return lathe([(0, -1), *zip(np.cos(angles), np.sin(angles), strict=True), (0, 1)], facets)


def centred(solid):
    return solid[0] - (solid[0].max(axis=0) + solid[0].min(axis=0)) / 2, solid[1]


@pytest.mark.parametrize(
    ("group", "solid"),
    [
        (DIHEDRAL.format(6), SOLIDS["nut"][0]),
        (CYCLIC.format(6), SOLIDS["bolt"][0]),
        (CYCLIC.format(64), SOLIDS["cup 64"][0]),
        (CYCLIC.format(360), SOLIDS["cup 360"][0]),
        (DIHEDRAL.format(36), SOLIDS["spindle 36"][0]),
        (DIHEDRAL.format(2), centred(SOLIDS["box"][0])),
        (DIHEDRAL.format(360), lathe(CAN, 720)),
        ('kind = "icosahedral"', SOLIDS["icosahedron"][0]),
    ],
    ids=["nut", "bolt", "cup of 64", "cup", "spindle", "box", "can of 720 by degrees", "icosahedron"],
)
def test_a_group_that_is_all_that_the_mesh_has_is_accepted_and_named(write, group, solid):
    checked = check_object(read_object(write(toml_of(group), obj_of(solid))))
    assert checked.group.split()[0].rstrip(",") in {"D6", "C6", "C64", "C360", "D36", "D2", "D720", "I"}
    assert checked.residual < 1e-6
    assert checked.notes


@pytest.mark.parametrize(
    ("group", "solid", "expected"),
    [
        (CYCLIC.format(6), SOLIDS["nut"][0], r"declares C6, 6 rotations, but the surface has 12: D6 about \(0, 0, 1\)"),
        (CYCLIC.format(2), centred(SOLIDS["box"][0]), r"declares C2, 2 rotations, but the surface has 4: D2"),
        (TRIVIAL, SOLIDS["mug in two shells"][0], r"without .* faces, 9\d% .* has more: C360, nearly circle"),
        (
            CYCLIC.format(2) + "\naxis = [1, 0, 0]",
            turned(SOLIDS["mug in one shell"][0], rotations_about((0, 0, 1), np.radians(-3))),
            r"without 40 faces .* circle with half",
        ),
        (
            CYCLIC.format(6),
            SOLIDS["screw with a socket"][0],
            r"without 12 faces in 1 patch, 9\d% .* more: C360, nearly",
        ),
        (DIHEDRAL.format(360), ball(), r"is a ball within .* any rotation leaves it as it is"),
        (DIHEDRAL.format(180), ball(180), r"is a ball within .* any rotation leaves it as it is"),
        (DIHEDRAL.format(360), lathe(CAN, 64), r"not invariant .* has D64 .* or circle with half turns within 0\.00"),
        (DIHEDRAL.format(45), lathe(CAN, 90), r"declares D45, 90 rotations, but the surface has 180: D90"),
        (CYCLIC.format(360), lathe(CAN, 360), r"declares C360, 360 rotations, but the surface has 720: D360"),
        ('kind = "tetrahedral"', centred(SOLIDS["cube"][0]), r"declares T, 12 rotations, but the surface has 24: O"),
        (CYCLIC.format(5), SOLIDS["icosahedron"][0], r"not invariant|has 60: I"),
        (DIHEDRAL.format(180), lathe(CAN, 360), r"but the surface has 720: D360"),
    ],
    ids=[
        *("nut", "box", "mug of two shells", "mug", "screw", "ball", "ball of 180", "can of 64", "half of 90"),
        *("can without its flip", "cube as tetrahedron", "icosahedron", "circle by two degrees"),
    ],
)
def test_a_group_that_is_too_small_is_refused_with_the_true_one_named(write, group, solid, expected):
    folder = write(toml_of(group), obj_of(solid))
    with pytest.raises(ObjectError, match=expected) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: ")


@pytest.mark.parametrize(
    ("facets", "stabiliser"),
    [((0,), CYCLIC.format(2)), ((0, 32), DIHEDRAL.format(2))],
    ids=["one dot", "two dots opposite"],
)
def test_a_marking_of_which_any_part_fixes_the_rotation_is_accepted(write, facets, stabiliser):
    axis = "\naxis = [1, 0, 0]" * ("cyclic" in stabiliser)
    mesh = dotted(*facets, phase=-np.pi / 64)  # half turns are about x: the dots are centred on it
    check_object(read_object(write(toml_of(DIHEDRAL.format(64), stabiliser + axis), mesh)))


@pytest.mark.parametrize(
    ("facets", "angle"),
    [
        ((0, 16), 90),
        ((0, 16, 32), 90),
        (tuple(range(40)), 5.625),
        (tuple(range(8)), 5.625),  # a camera near the axis sees its middle alone
        ((0, 8, 16, 24), 45),
        ((0, 1, 12, 13), 67.5),
    ],
    ids=[
        *("two dots 90 degrees apart", "three dots", "a long stripe", "a short stripe"),
        *("four dots on one side", "two wide dots"),
    ],
)
def test_a_marking_of_which_a_part_alone_fixes_less_is_refused(write, facets, angle):
    middle = np.pi / 64 * (max(facets) + 1)
    axis = f"\naxis = [{float(np.cos(middle))!r}, {float(np.sin(middle))!r}, 0]"
    folder = write(toml_of(DIHEDRAL.format(64), CYCLIC.format(2) + axis), dotted(*facets))
    with pytest.raises(ObjectError, match=r"any_part_fixes_rotation is not true .* a turn by [\d.]+ degrees") as caught:
        check_object(read_object(folder))
    turn = float(str(caught.value).split("a turn by ")[1].split()[0])
    assert turn % angle == pytest.approx(0.0, abs=0.01) or turn == pytest.approx(180.0)


def test_what_a_body_that_is_not_convex_may_hide_is_said_not_to_be_looked_for(write):
    profile = [(0, -0.6), (0.8, -0.6), (0.8, -0.2), (0.8, 0.2), (0.8, 0.6), (0.7, 0.6), (0.7, -0.5), (0, -0.5)]
    checked = check_object(read_object(write(toml_of(CYCLIC.format(64), TRIVIAL), dotted(0, profile=profile))))
    assert any("not convex" in what for what in checked.notes)


def test_a_round_body_of_facets_is_accepted_within_a_stated_offset(write):
    mesh = obj_of(lathe(CAN, 64), materials=("clay",))
    toml = parted_toml([("body", "clay", None)], DIHEDRAL.format(360))
    with pytest.raises(ObjectError, match=r"write `max_offset = 0\.00068` into \[symmetry\]"):
        check_object(read_object(write(toml, mesh)))
    assert check_object(read_object(write(toml.replace("order = 360", "order = 360\nmax_offset = 8e-4"), mesh))).group


def test_parts_that_the_declared_group_swaps_are_refused(write):
    """A double cone of two colours: the half turns of its shape carry one colour onto the other."""
    vertices, triangles = lathe([(0, -1), (0.6, 0), (0, 1)], 12)
    is_top = vertices[triangles].mean(axis=1)[:, 2] > 0
    mesh = obj_of((vertices, triangles), is_top, ("clay", "glaze"))
    toml = parted_toml([("bottom", "clay", RED), ("top", "glaze", BLUE)], DIHEDRAL.format(12))
    toml = toml.replace("[symmetry]", '[symmetry]\nof = ["bottom", "top"]')
    with pytest.raises(ObjectError, match="not invariant under symmetry"):
        check_object(read_object(write(toml, mesh)))
    check_object(read_object(write(toml.replace(DIHEDRAL.format(12), CYCLIC.format(12)), mesh)))


def test_a_group_of_several_parts_is_refused_where_one_hides_a_larger_one(write):
    body, lid = lathe(CAN, 12), moved(box(0.5, 0.5, 0.2), [-0.25, -0.25, 0.95])
    mesh = obj_of(joined(body, lid), [0] * len(body[1]) + [1] * len(lid[1]), ("clay", "lid"))
    toml = parted_toml([("body", "clay", RED), ("lid", "lid", BLUE)], CYCLIC.format(4))
    toml = toml.replace("[symmetry]", '[symmetry]\nof = ["body", "lid"]')
    with pytest.raises(ObjectError, match=r"declares C4, .* without the part 'lid', .* has more: D12"):
        check_object(read_object(write(toml, mesh)))


def test_a_mesh_of_one_surface_may_declare_the_larger_group_of_what_it_hides(write):
    """A mug of one shell: each part may break the circle, so that images are compared as a whole."""
    mug = turned(SOLIDS["mug in one shell"][0], rotations_about((0, 0, 1), np.radians(-3)))
    toml = parted_toml([("body", "clay", None)], DIHEDRAL.format(360)).replace("[symmetry]", "[symmetry]\nof = []")
    spec = read_object(write(toml, obj_of(mug, materials=("clay",))))
    assert check_object(spec).group.startswith("C2 about (1, 0, 0)")
    assert (spec.mesh.breaking, len(spec.stabiliser), len(spec.symmetry_group)) == ((1,), 2, 720)
    folder = write(toml.replace("dihedral", "cyclic"), obj_of(mug, materials=("clay",)))
    with pytest.raises(ObjectError, match=r"declares C360, 360 rotations, but the surface has 2: C2 about \(1, 0, 0\)"):
        check_object(read_object(folder))


def test_a_group_that_another_tolerance_would_decide_otherwise_is_said_to_be_close(write):
    vertices, triangles = SOLIDS["prism 6"][0]
    nearly, farther = vertices * [1.0, 1.0 + 5e-5, 1.0], vertices * [1.0, 1.0 + 5e-4, 1.0]
    checked = check_object(read_object(write(toml_of(DIHEDRAL.format(2)), obj_of((farther, triangles)))))
    assert any(note.startswith("close to the tolerance: ") for note in checked.notes)
    with pytest.raises(ObjectError, match=r"not invariant under body\.group|has 12: D6"):
        check_object(read_object(write(toml_of(DIHEDRAL.format(2)), obj_of((nearly, triangles)))))
    checked = check_object(read_object(write(toml_of(DIHEDRAL.format(6)), obj_of((vertices, triangles)))))
    assert not any(note.startswith("close to") for note in checked.notes)


def test_normals_without_the_symmetries_of_the_surface_are_refused(write):
    """A prism one of whose sides is smoothed: of no other brightness by its shape, but by its normals."""
    solid = SOLIDS["prism 6"][0]
    lines = obj_of(solid).splitlines()
    face = next(index for index, line in enumerate(lines) if line.startswith("f "))
    a, b, c = lines[face].split()[1:]
    leaning = [f"vn {x} {y} {z}" for x, y, z in [(0.6, 0, 0.8), (0, 0.6, 0.8), (-0.6, 0, 0.8)]]
    lines[face : face + 1] = [*leaning, f"f {a}//1 {b}//2 {c}//3"]
    with pytest.raises(ObjectError, match=r"the shading of the surface .* at \(.*\) .* differs by \d+%"):
        check_object(read_object(write(toml_of(DIHEDRAL.format(6)), "\n".join(lines) + "\n")))


def test_the_steps_of_a_circle_have_to_be_the_turns_of_facets_that_show(write):
    screw = SOLIDS["screw of 64 facets with a socket"][0]
    vertices = screw[0] + [0.0, 0.0, 0.15]
    toml = parted_toml([("body", "clay", None)], "of = []\n" + CYCLIC.format(360))
    mesh = obj_of((vertices, screw[1]), materials=("clay",))
    with pytest.raises(
        ObjectError, match=r"declares C360, .* without 12 faces in 1 patch, .* has more: C64, nearly circle"
    ):
        check_object(read_object(write(toml, mesh)))
    assert check_object(read_object(write(toml.replace("order = 360", "order = 64"), mesh))).group.startswith("C2")
