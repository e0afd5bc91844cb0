"""Mesh files as programs export them, by trimesh: any format, in millimetres, off centre, turned, with looks."""

import io

import numpy as np
from made_solids import CUP, box, joined, lathe, torus
from PIL import Image

TURN = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
TURN = TURN * np.sign(np.linalg.det(TURN))
COLOURS = np.array([[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 0], [255, 0, 255], [0, 255, 255]], np.uint8)


def moved(solid):
    """A solid in millimetres, far off centre, turned."""
    vertices, triangles = solid
    return 37.5 * vertices @ TURN.T + [120.0, -40.0, 15.0], triangles


def mesh_bytes(solid, ending, **looks):
    """The bytes of a solid's file; looks are as trimesh takes them: face_colors, vertex_colors, visual."""
    import trimesh

    file_type = "stl_ascii" if ending == "ascii" else ending
    data = trimesh.Trimesh(*solid, process=False, **looks).export(file_type=file_type)
    return data.encode() if isinstance(data, str) else data


def cuboid():
    """A box of three different sides."""
    return box(1.0, 1.4, 0.7)


def side_of(solid):
    """The number (T,) of the side of a box, 0 to 5, that each triangle is on."""
    corners = solid[0][solid[1]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    axis = np.abs(normals).argmax(axis=1)
    return 2 * axis + (np.take_along_axis(normals, axis[:, None], axis=1)[:, 0] > 0)


def mug(facets=24):
    """A cup and a handle that reaches into its wall: two closed shells."""
    return joined(cup_of(facets), handle_of())


def cup_of(facets=24):
    return lathe(CUP, facets)


def handle_of():
    points, faces = torus(12, 6)
    return points[:, [0, 2, 1]] * 0.4 + [0.75, 0, 0], faces[:, ::-1]


def split_corners(solid):
    """The same triangles, each with vertices of its own."""
    vertices, triangles = solid
    return vertices[triangles].reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)


def textured_box(ending="glb", noise=False):
    """A box whose sides are painted by one texture of six squares, each side in one of them."""
    import trimesh

    solid = cuboid()
    side = side_of(solid)
    vertices, triangles = split_corners(solid)
    corners = np.array([[0.2, 0.2], [0.8, 0.2], [0.5, 0.8]])
    uv = (np.repeat(side, 3)[:, None] * [1, 0] + np.tile(corners, (len(side), 1))) / [6, 1]
    pixels = np.repeat(COLOURS[None], 16, axis=0).repeat(16, axis=1)
    if noise:
        pixels = np.clip(pixels.astype(int) + np.random.default_rng(0).integers(-4, 5, pixels.shape), 0, 255)
    image = Image.fromarray(pixels.astype(np.uint8))
    material = trimesh.visual.material.PBRMaterial(baseColorTexture=image, name="paint")
    visual = trimesh.visual.TextureVisuals(uv=uv, material=material)
    return mesh_bytes((vertices, triangles), ending, visual=visual)


def png_of(pixels):
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def obj_lines(solid, materials=None, places=None):
    """The text of an OBJ file: its materials by name, per triangle, and the places of corners in a texture."""
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in solid[0].tolist()]
    if places is not None:
        lines += [f"vt {u!r} {v!r}" for u, v in places.reshape(-1, 2).tolist()]
    for index, corners in enumerate((solid[1] + 1).tolist()):
        lines += [f"usemtl {materials[index]}"] if materials is not None else []
        words = [f"{c}/{3 * index + k + 1}" if places is not None else str(c) for k, c in enumerate(corners)]
        lines.append("f " + " ".join(words))
    return "\n".join(lines) + "\n"
