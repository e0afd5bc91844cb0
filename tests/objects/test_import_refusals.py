"""What cannot be an object is refused with one clear error that names the file and says what to do."""

import struct

import numpy as np
import pytest
from exported_meshes import COLOURS, cuboid, mesh_bytes, obj_lines, side_of, split_corners
from made_solids import SOLIDS, box, joined, lathe, prism

from symsol_annot.errors import ObjectError
from symsol_annot.objects.importing.importing import ImportOptions, import_mesh

pytest.importorskip("trimesh")

VERTICES, TRIANGLES = prism(6)
BALL_ERROR = r"up to 0.0069 of the radius off one, 6.9 times the 0.001 that is allowed; .* --round-within 0.007 takes"
BALL = [(np.sin(a) if 0 < k < 24 else 0, -np.cos(a)) for k, a in enumerate(np.linspace(0, np.pi, 25))]


def without_a_face():
    return mesh_bytes((VERTICES, TRIANGLES[1:]), "stl")


def sheet():
    return mesh_bytes(([[0, 0, 0], [1, 0, 0], [0, 1, 0.0]], [[0, 1, 2]]), "stl")


def crossing_itself():
    """A prism of which one end's middle is pulled through the other end."""
    vertices = np.concatenate([VERTICES, [[0.0, 0.0, -2.0]]])
    is_end = (VERTICES[TRIANGLES][:, :, 2] > 0).all(axis=1)
    rim = [k for k in range(len(VERTICES)) if VERTICES[k, 2] > 0]
    rim.sort(key=lambda k: np.arctan2(VERTICES[k, 1], VERTICES[k, 0]))
    fan = [[rim[k], rim[(k + 1) % 6], 12] for k in range(6)]
    return mesh_bytes((vertices, np.concatenate([TRIANGLES[~is_end], fan])), "stl")


def one_sided():
    """A closed surface with one side: the projective plane's six vertices, ten triangles."""
    faces = "124 235 341 452 513 136 246 356 416 526"
    corners = [[int(c) - 1 for c in face] for face in faces.split()]
    return mesh_bytes((np.random.default_rng(1).normal(size=(6, 3)), corners), "ply")


def scene_of_two():
    return mesh_bytes(joined(cuboid(), (cuboid()[0] + 50.0, cuboid()[1])), "stl")


def without_size():
    return obj_lines((np.ones((4, 3)), np.array([[0, 1, 2], [0, 2, 3]])))


def point_cloud():
    axes = b"".join(b"property float %s\n" % axis for axis in (b"x", b"y", b"z"))
    return b"ply\nformat ascii 1.0\nelement vertex 1\n" + axes + b"end_header\n0 0 0\n"


def five_million():
    return b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\nelement face 5000000\n"


def a_quarter_million_and_more():
    return bytes(80) + struct.pack("<I", 250_001) + bytes(50 * 250_001)


def not_numbers():
    vertices = VERTICES.copy()
    vertices[3, 1] = np.nan
    return mesh_bytes((vertices, TRIANGLES), "ply")


def two_colours_per_face():
    colours = np.tile(COLOURS[:3], (12, 1))
    return mesh_bytes(split_corners(cuboid()), "ply", vertex_colors=colours)


def two_parts_of_the_same_faces():
    vertices, triangles = cuboid()
    return obj_lines((vertices, np.concatenate([triangles, triangles])), ["a"] * 12 + ["b"] * 12)


def many_colours():
    vertices, triangles = SOLIDS["snub cube"][0]
    many = joined(*[(vertices * (1 + 0.001 * k), triangles) for k in range(8)])
    colours = np.arange(3 * len(many[1])).reshape(-1, 3).astype(np.uint8)
    return mesh_bytes(many, "ply", face_colors=colours)


BAD = [
    ("part.stl", without_a_face, {}, r"the surface is not closed: 3 edges .* Blender"),
    ("part.stl", sheet, {}, "the surface is not closed: 3 edges .*Solidify"),
    ("part.stl", crossing_itself, {}, "the surface crosses itself: .*Remesh"),
    ("part.ply", one_sided, {}, "has one side only|not closed"),
    ("part.stl", scene_of_two, {}, "2 objects that do not touch each other, of 12, 12 faces; .* By Loose Parts"),
    ("part.obj", without_size, {}, "has no size: all its vertices are in one place"),
    ("part.ply", point_cloud, {}, "has no triangles: a point cloud"),
    ("part.ply", five_million, {}, "5,000,000 triangles, at most 250,000 are read; simplify .*Decimate"),
    ("part.stl", a_quarter_million_and_more, {}, "250,001 triangles, at most 250,000 are read; simplify"),
    ("part.ply", not_numbers, {}, "vertices that are no numbers|cannot be read"),
    ("part.ply", two_colours_per_face, {}, "12 of its 12 faces have several colours .* --parts none"),
    (
        "part.obj",
        two_parts_of_the_same_faces,
        {},
        "triangles of two parts are in one place: parts cannot select the same",
    ),
    ("part.ply", many_colours, {}, "has 256 colours, and an object at most 255 parts; .* --parts none"),
    ("part.stl", lambda: b"no mesh at all", {}, "cannot be read as STL|has no triangles"),
    ("part.glb", lambda: b"glTF\2\0\0\0", {}, "cannot be read as GLB"),
    ("part.step", lambda: b"", {}, "expected a mesh file that ends in obj, stl"),
    ("part.stl", lambda: mesh_bytes(prism(6), "stl"), {"body": "dot"}, "has no part 'dot' .* its parts are 'body'"),
    ("part.stl", lambda: mesh_bytes(lathe(BALL, 32), "stl"), {}, BALL_ERROR),
]


@pytest.mark.parametrize(("name", "data", "options", "what"), BAD, ids=[f"{n}-{k}" for k, (n, *_) in enumerate(BAD)])
def test_it_is_refused_with_the_file_and_what_to_do(tmp_path, name, data, options, what):
    path = tmp_path / name
    made = data()
    path.write_bytes(made.encode() if isinstance(made, str) else made)
    with pytest.raises(ObjectError, match=what) as caught:
        import_mesh(path, "part", ImportOptions(**options))
    assert str(caught.value).startswith(f"{path}: ")
    assert [one.name for one in tmp_path.iterdir()] == [name]


def test_a_texture_that_is_not_there_is_named(tmp_path):
    solid = cuboid()
    (tmp_path / "part.mtl").write_text("newmtl paint\nmap_Kd paint.png\n")
    text = obj_lines(solid, places=np.zeros((12, 3, 2)))
    (tmp_path / "part.obj").write_text("mtllib part.mtl\nusemtl paint\n" + text)
    with pytest.raises(
        ObjectError, match=r"the texture 'paint.png', which tells its parts, is not beside it.*--parts none"
    ):
        import_mesh(tmp_path / "part.obj", "part", ImportOptions())
    assert import_mesh(tmp_path / "part.obj", "part", ImportOptions(parts="none")).draft.part_names == ("body",)


def test_a_file_is_not_looked_for_outside_the_mesh_s_folder(tmp_path):
    (tmp_path / "secret.png").write_bytes(b"x")
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "part.mtl").write_text("newmtl paint\nmap_Kd ../secret.png\n")
    text = obj_lines(cuboid(), ["paint"] * 12)
    (tmp_path / "in" / "part.obj").write_text("mtllib part.mtl\n" + text)
    with pytest.raises(ObjectError, match=r"the texture '\.\./secret.png'.*is not beside it"):
        import_mesh(tmp_path / "in" / "part.obj", "part", ImportOptions())


def test_a_side_that_is_glued_to_another_solid_s_side_is_no_crossing(tmp_path):
    stacked = joined(box(1.0, 1.0, 1.0), (box(0.5, 0.5, 0.5)[0] + [0.25, 0.25, 1.0], box(0.5, 0.5, 0.5)[1]))
    (tmp_path / "part.stl").write_bytes(mesh_bytes(stacked, "stl"))
    made = import_mesh(tmp_path / "part.stl", "part", ImportOptions(parts="component"))
    assert made.draft.part_names == ("body", "component-2")
    assert len(side_of(stacked)) == 24
