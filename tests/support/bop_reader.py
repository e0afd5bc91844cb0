"""Reads a BOP dataset from BOP's page about its format alone (docs/bop_datasets_format.md of bop_toolkit)."""

import json
from itertools import product

import numpy as np
from PIL import Image


def read_json(path):
    return json.loads(path.read_text())


def read_ply(path):
    """Vertices (V, 3), normals (V, 3), colours (V, 3) and triangles (T, 3) of an ASCII PLY."""
    lines = path.read_text().splitlines()
    header = lines[: lines.index("end_header")]
    counts = {line.split()[1]: int(line.split()[2]) for line in header if line.startswith("element")}
    body = lines[len(header) + 1 :]
    assert len(body) == counts["vertex"] + counts["face"]
    vertices = np.array([line.split() for line in body[: counts["vertex"]]], dtype=float)
    faces = np.array([line.split() for line in body[counts["vertex"] :]], dtype=int)
    assert (faces[:, 0] == 3).all()
    return vertices[:, :3], vertices[:, 3:6], vertices[:, 6:], faces[:, 1:]


def pixels(path):
    with Image.open(path) as picture:
        return np.asarray(picture)


def silhouette(vertices, triangles, K, R, t, shape):
    """The pixels (H, W) whose centre, (u, v) = (column, row) in OpenCV's and BOP's way, a triangle covers."""
    u, v, depth = K @ (R @ vertices.T + t[:, None])
    corners = np.stack([u / depth, v / depth], axis=1)[triangles]
    points = np.array([(column, row) for row, column in product(*map(range, shape))], dtype=float)
    inside = np.zeros(len(points), bool)
    for a, b, c in corners:
        sides = [
            (q[0] - p[0]) * (points[:, 1] - p[1]) - (q[1] - p[1]) * (points[:, 0] - p[0])
            for p, q in ((a, b), (b, c), (c, a))
        ]
        inside |= np.all(np.array(sides) >= 0, axis=0) | np.all(np.array(sides) <= 0, axis=0)
    return inside.reshape(shape)


def symmetry_transformations(info, steps=360):
    """All rotations (n, 3, 3) that models_info.json states: a turn of the circle after a discrete symmetry."""
    listed = [np.eye(4), *(np.reshape(matrix, (4, 4)) for matrix in info.get("symmetries_discrete", []))]
    discrete = np.array(listed)[:, :3, :3]
    turns = [np.eye(3)]
    for circle in info.get("symmetries_continuous", []):
        assert circle["offset"] == [0, 0, 0]
        x, y, z = circle["axis"]
        cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
        turns = [
            np.eye(3) + np.sin(a) * cross + (1 - np.cos(a)) * cross @ cross
            for a in 2 * np.pi * np.arange(steps) / steps
        ]
    return np.array([turn @ R for R in discrete for turn in turns])
