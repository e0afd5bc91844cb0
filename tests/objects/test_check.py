"""Geometry must have the symmetry that an object.toml declares."""

import numpy as np
import pytest
from object_folders import ASSETS, MESH, UNMARKED_MESH, H, every_builtin, toml_of

from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.spec import load_object, read_object


def test_a_marking_too_fine_to_be_checked_is_refused_with_how_fine_it_may_be(write):
    folder = write(toml_of(*2 * ['kind = "cyclic"\norder = 3600']), finely_marked(3600))
    with pytest.raises(ObjectError, match=r"has 3,598 triangles, too many .* 3,600 rotations; simplify it to 1,864"):
        check_object(read_object(folder))


def prism(facets, axis="z", material_of_caps="body"):
    """A prism about an axis in the unit sphere, its caps regular polygons."""
    turns = np.arange(facets) * 2 * np.pi / facets
    x, y = 0.8 * np.cos(turns), 0.8 * np.sin(turns)
    vertices = np.concatenate([np.stack([x, y, np.full(facets, z)], axis=1) for z in (-0.6, 0.6)])
    if axis == "x":
        vertices = np.roll(vertices, 1, axis=1)
    lines = [f"v {x:.12f} {y:.12f} {z:.12f}" for x, y, z in vertices]
    for k in range(facets):
        following = (k + 1) % facets
        lines.append(f"f {k + 1} {following + 1} {following + 1 + facets} {k + 1 + facets}")
    lines.append(f"usemtl {material_of_caps}")
    lines.append("f " + " ".join(str(k + 1) for k in reversed(range(facets))))
    lines.append("f " + " ".join(str(k + 1 + facets) for k in range(facets)))
    return "\n".join(lines) + "\n"


def finely_marked(facets):
    """A cone whose base is marked: facets - 2 triangles of marking."""
    turns = np.arange(facets) * 2 * np.pi / facets
    lines = [f"v {0.8 * np.cos(t):.12f} {0.8 * np.sin(t):.12f} -0.6" for t in turns] + ["v 0 0 1"]
    lines += [f"f {k + 1} {(k + 1) % facets + 1} {facets + 1}" for k in range(facets)]
    return "\n".join([*lines, "usemtl marking", "f " + " ".join(str(k) for k in range(facets, 0, -1))]) + "\n"


CUBE_FACES = {
    "bottom": "f 1 4 3 2",
    "top": "f 5 6 7 8",
    "front": "f 1 2 6 5",
    "right": "f 2 3 7 6",
    "back": "f 3 4 8 7",
    "left": "f 4 1 5 8",
}


def cube(*marked):
    corners = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    lines = [f"v {x * H} {y * H} {z * H}" for z in (-1, 1) for x, y in corners]
    lines += [face for name, face in CUBE_FACES.items() if name not in marked]
    lines += ["usemtl marking", *(CUBE_FACES[name] for name in marked)] if marked else []
    return "\n".join(lines) + "\n"


OCTAHEDRAL, DIHEDRAL_360 = 'kind = "octahedral"', 'kind = "dihedral"\norder = 360'
QUARTER_TURNS, PRISM_4 = 'kind = "cyclic"\norder = 4', 'kind = "dihedral"\norder = 4'


@every_builtin
def test_the_check_accepts_every_builtin_object(name):
    check_object(load_object(name), compares_builtin=True)


@pytest.mark.parametrize(
    ("mesh", "group"),
    [
        (prism(360), DIHEDRAL_360),
        (prism(720), DIHEDRAL_360),
        (prism(90), 'kind = "dihedral"\norder = 90'),
        (cube(), OCTAHEDRAL),
        (UNMARKED_MESH, 'kind = "tetrahedral"'),
    ],
    ids=[
        "prism 360",
        "prism 720",
        "prism 90",
        "cube",
        "tetrahedron",
    ],
)
def test_the_check_accepts_a_group_that_the_surface_has(write, mesh, group):
    check_object(read_object(write(toml_of(group), mesh)))


@pytest.mark.parametrize(
    ("mesh", "group"),
    [
        (cube(), 'kind = "icosahedral"'),
        (cube(), 'kind = "dihedral"\norder = 8'),
        (cube(), 'kind = "cyclic"\norder = 3\naxis = [1, 1, 0]'),
        (UNMARKED_MESH, OCTAHEDRAL),
        (prism(90), DIHEDRAL_360),
        (prism(180), 'kind = "cyclic"\norder = 360'),
        (prism(90), OCTAHEDRAL),
        (prism(90, axis="x"), 'kind = "dihedral"\norder = 90'),
    ],
    ids=[
        "cube as icosahedron",
        "cube as octagon",
        "cube about a wrong axis",
        "tetrahedron as cube",
        "90 facets as 360",
        "180 facets as 360",
        "prism as cube",
        "prism about another axis",
    ],
)
def test_the_check_refuses_a_group_that_the_surface_lacks(write, mesh, group):
    folder = write(toml_of(group), mesh)
    with pytest.raises(ObjectError) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: the surface of 'mug' is not invariant under body.group: ")


def test_the_check_refuses_a_flip_that_the_cone_lacks(write):
    mesh = (ASSETS / "cone" / "mesh.obj").read_text(encoding="utf-8")
    with pytest.raises(ObjectError, match="is not invariant under body"):
        check_object(read_object(write(toml_of(DIHEDRAL_360), mesh)))


@pytest.mark.parametrize(
    ("mesh", "group", "stabiliser"),
    [
        (cube("top"), OCTAHEDRAL, QUARTER_TURNS),
        (cube("top", "bottom"), OCTAHEDRAL, PRISM_4),
        (cube(*CUBE_FACES), OCTAHEDRAL, OCTAHEDRAL),
        (prism(360, material_of_caps="marking"), DIHEDRAL_360, DIHEDRAL_360),
    ],
    ids=["a face", "two opposite faces", "all faces", "both caps of a cylinder"],
)
def test_the_check_accepts_the_stabiliser_that_the_marking_has(write, mesh, group, stabiliser):
    check_object(read_object(write(toml_of(group, stabiliser), mesh)))


@pytest.mark.parametrize(
    ("mesh", "group", "stabiliser"),
    [
        (MESH, 'kind = "tetrahedral"', 'kind = "cyclic"\norder = 1'),
        (cube("top"), OCTAHEDRAL, 'kind = "cyclic"\norder = 2'),
        (cube("top", "bottom"), OCTAHEDRAL, QUARTER_TURNS),
        (prism(360, material_of_caps="marking"), DIHEDRAL_360, 'kind = "cyclic"\norder = 360'),
    ],
    ids=["tetrahedron's face", "cube's face", "two opposite faces", "both caps"],
)
def test_the_check_refuses_a_stabiliser_that_is_declared_too_small(write, mesh, group, stabiliser):
    folder = write(toml_of(group, stabiliser), mesh)
    with pytest.raises(ObjectError) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: ")
    assert str(caught.value).endswith("the stabiliser is larger than declared")


@pytest.mark.parametrize(
    ("mesh", "group", "stabiliser"),
    [
        (MESH, 'kind = "tetrahedral"', 'kind = "tetrahedral"'),
        (MESH, 'kind = "tetrahedral"', 'kind = "cyclic"\norder = 3\naxis = [-1, 1, 1]'),
        (cube("top"), OCTAHEDRAL, PRISM_4),
        (cube("top"), OCTAHEDRAL, f"{QUARTER_TURNS}\naxis = [1, 0, 0]"),
    ],
    ids=["all of the tetrahedron's", "another face's", "with the flip", "about another axis"],
)
def test_the_check_refuses_a_stabiliser_that_moves_the_marking(write, mesh, group, stabiliser):
    folder = write(toml_of(group, stabiliser), mesh)
    with pytest.raises(ObjectError) as caught:
        check_object(read_object(folder))
    assert str(caught.value).startswith(f"{folder}: marking.stabiliser moves the marking of 'mug' ")
