"""OBJ files as exporters write them, and other mesh files, are read as the surface that they draw."""

import numpy as np
import pytest
from made_solids import SOLIDS, surface_of

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.find import find_group
from symsol_annot.objects.mesh_files.exported_obj import ExportedObj
from symsol_annot.objects.mesh_files.reading import read_surface

CUBE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
POINT = b"""ply
format ascii 1.0
element vertex 1
property float x
property float y
property float z
end_header
0 0 0
"""
FACES = ["1 4 3 2", "5 6 7 8", "1 2 6 5", "2 3 7 6", "3 4 8 7", "4 1 5 8"]
FACE_LINES = "".join(f"f {face}\n" for face in FACES)


def area(read):
    a, b, c = (read.vertices[read.triangles[:, k]] for k in range(3))
    return np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2


def read_obj(text):
    return ExportedObj(text if isinstance(text, bytes) else text.encode(), "cube.obj")


@pytest.mark.parametrize(
    "text",
    [
        b"\xef\xbb\xbf" + (CUBE + FACE_LINES).encode(),
        (CUBE + FACE_LINES).encode() + b"# gr\xfc\xdfe\n",
        (CUBE + FACE_LINES).replace("\n", "\r\n"),
        CUBE + "".join("f " + " ".join(str(int(i) - 9) for i in face.split()) + "\n" for face in FACES),
        CUBE.replace("\n", " 0.5 0.25 1\n") + FACE_LINES,
        "".join(f"v {2 * int(x)} {2 * int(y)} {2 * int(z)} 2\n" for _, x, y, z in map(str.split, CUBE.splitlines()))
        + FACE_LINES,
        CUBE + FACE_LINES.replace("f 1 4 3 2", "f 1 4 \\\n3 2"),
        CUBE + FACE_LINES.replace("f 1 4 3 2", "f 1/1 4/2/3 3//1 2"),
        "mtllib a.mtl\no x\ncstype bezier\n" + CUBE + "s off\nusemtl\n" + FACE_LINES + "l 1 2\n",
    ],
    ids=["mark", "latin-1", "crlf", "negative", "colours", "weights", "continued", "corners", "others"],
)
def test_a_cube_is_read_however_it_is_written(text):
    assert area(read_obj(text)) == pytest.approx(6)


def test_materials_of_any_name_are_parts():
    lines = "".join(f"usemtl paint {k % 2}\nf {face}\n" for k, face in enumerate(FACES))
    read = read_obj(CUBE + lines)
    assert read.materials == ("paint 0", "paint 1")
    assert np.bincount(read.material_of).tolist() == [6, 6]


@pytest.mark.parametrize("turn", range(7))
def test_a_polygon_that_is_not_convex_is_cut_as_it_is(turn):
    outline = [(0, 0), (4, 0), (4, 3), (2, 1), (0, 3), (0, 2), (0, 1)]  # a notch, and corners on a straight edge
    outline = outline[turn:] + outline[:turn]
    text = "".join(f"v {x} 1 {y}\n" for x, y in outline) + "f " + " ".join(map(str, range(1, 8)))
    read = ExportedObj(text.encode(), "notch.obj")
    assert area(read) == pytest.approx(8)
    a, b, c = (read.vertices[read.triangles[:, k]] for k in range(3))
    assert (np.cross(b - a, c - a)[:, 1] <= 1e-12).all()  # none is turned over


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("v 0 0\n", "line 1: expected a vertex as three finite numbers"),
        ("v 0 0 nan\n", "line 1: expected a vertex"),
        ("v 0 0 0 0\n", "line 1: a vertex has the weight 0"),
        (CUBE + "f 1 2 9\n", "line 9: vertex '9' does not exist; 8 are defined"),
        (CUBE + "f 1 2 -9\n", "line 9: vertex '-9' does not exist"),
        (CUBE + "f 1 2 0\n", "line 9: vertex '0' does not exist"),
        (CUBE + "f 1 two 3\n", "line 9: vertex 'two' does not exist"),
        ("v 0 0 0\nv 1 1 0\nv 1 0 0\nv 0 1 0\nv 0 3 0\nf 1 2 3 4 5\n", "line 6: this face crosses itself"),
    ],
)
def test_a_broken_statement_is_named_with_its_line(text, what):
    with pytest.raises(ObjectError, match=f"part.obj, {what}"):
        ExportedObj(text.encode(), "part.obj")


@pytest.mark.parametrize("ending", ["stl", "ply", "off", "glb"])
@pytest.mark.parametrize("name", ["nut", "box", "cup 64"])
def test_a_mesh_file_has_the_group_of_the_solid_in_it(tmp_path, ending, name):
    trimesh = pytest.importorskip("trimesh")
    (vertices, triangles), group = SOLIDS[name]
    path = tmp_path / f"part.{ending}"
    path.write_bytes(_bytes(trimesh.Trimesh(37.5 * vertices + 5, triangles, process=False).export(file_type=ending)))
    assert find_group(read_surface(path)).group.name == group


def _bytes(data):
    return data.encode() if isinstance(data, str) else data


@pytest.mark.parametrize(
    ("name", "data", "what"),
    [
        ("part.step", b"", "expected a mesh file that ends in obj, stl, ply, off, glb"),
        ("part.stl", b"no mesh", "cannot be read as STL|has no triangles"),
        ("part.ply", POINT, "has no triangles"),
        ("part.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\n", "has no triangles"),
        ("part.obj", b"v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n", "no triangle with an area"),
        ("part.obj", b"v 0 0 0\nv 0 0 0\nv 0 0 0\nf 1 2 3\n", "all in one place"),
    ],
)
def test_what_is_no_mesh_is_refused_with_its_path(tmp_path, name, data, what):
    path = tmp_path / name
    path.write_bytes(data)
    with pytest.raises(ObjectError, match=what) as caught:
        read_surface(path)
    assert str(caught.value).startswith(str(path))


def test_a_missing_file_and_a_folder_are_refused(tmp_path):
    with pytest.raises(ObjectError, match="no such file"):
        read_surface(tmp_path / "none.obj")
    (tmp_path / "folder.stl").mkdir()
    with pytest.raises(ObjectError, match="cannot be read"):
        read_surface(tmp_path / "folder.stl")


def test_triangles_that_are_there_twice_do_not_move_the_group():
    vertices, triangles = SOLIDS["prism 5"][0]
    twice = vertices, np.concatenate([triangles, triangles[:3]])
    assert find_group(surface_of(twice)).group.name == "D5"
