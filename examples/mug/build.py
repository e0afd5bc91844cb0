"""Build the mesh of this folder's mug: a cup turned about z in 360 steps, and a handle that reaches into its wall.

    python examples/mug/build.py            # write mesh.obj
    symsol-annot render --object examples/mug --train 0 --test 100 --out mugs

The two are closed surfaces of their own, with a material each, which object.toml makes the parts "body" and "handle".
Coordinates are written with 9 decimals, so that the last bit of a platform's cosine does not show.
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

FACETS = 360  # of the cup: its surface is then invariant under turns by 1 degree
RADIUS, WALL, FLOOR, HALF = 0.60, 0.10, 0.12, 0.62  # of the cup; half its height
TUBE, BEND, STRAIGHT = 0.07, 0.30, 0.08  # of the handle: its own radius, that of its bend, how far it runs out first
TUBE_FACETS, BEND_STEPS = 24, 32


class Mesh:
    """Gathers the lines of an OBJ file; equal points are written once."""

    def __init__(self) -> None:
        self._vertices: dict[str, int] = {}
        self._normals: dict[str, int] = {}
        self._faces: list[str] = []

    def material(self, name: str) -> None:
        """Give the faces from here on a material."""
        self._faces.append(f"usemtl {name}")

    def face(self, corners: list[Points], normals: list[Points], scale: float) -> None:
        """Add a triangle, counter-clockwise seen from outside, with a normal per corner."""
        words = [
            f"{_number(self._vertices, scale * corner)}//{_number(self._normals, normal / np.linalg.norm(normal))}"
            for corner, normal in zip(corners, normals, strict=True)
        ]
        self._faces.append("f " + " ".join(words))

    def text(self) -> str:
        """Return the text of the OBJ file."""
        vertices, normals = ([f"{key} {xyz}" for xyz in table] for key, table in self._tables())
        return "\n".join(["# a mug; built by examples/mug/build.py", *vertices, *normals, *self._faces]) + "\n"

    def _tables(self) -> list[tuple[str, dict[str, int]]]:
        return [("v", self._vertices), ("vn", self._normals)]


def _number(table: dict[str, int], point: Points) -> int:
    coordinates = " ".join(f"{x:.9f}" for x in np.round(point, 9) + 0.0)  # + 0.0: no "-0.000000000"
    return table.setdefault(coordinates, len(table) + 1)


def add_cup(mesh: Mesh, scale: float) -> None:
    """Add the cup: a profile in (radius, z), from the middle of its underside to the middle of its floor, turned."""
    inner = RADIUS - WALL
    profile = [(0.0, -HALF), (RADIUS, -HALF), (RADIUS, HALF), (inner, HALF), (inner, FLOOR - HALF), (0.0, FLOOR - HALF)]
    angles = 2.0 * np.pi * np.arange(FACETS + 1) / FACETS
    around = np.stack([np.cos(angles), np.sin(angles), np.zeros_like(angles)], axis=1)
    around[-1] = around[0]
    up = np.array([0.0, 0.0, 1.0])
    for (r0, z0), (r1, z1) in pairwise(profile):
        for k in range(FACETS):
            low = [r0 * around[k] + z0 * up, r0 * around[k + 1] + z0 * up]
            high = [r1 * around[k] + z1 * up, r1 * around[k + 1] + z1 * up]
            normals = [(z1 - z0) * around[k + side] - (r1 - r0) * up for side in (0, 1)]
            if r0 > 0:
                mesh.face([low[0], low[1], high[1]], [normals[0], normals[1], normals[1]], scale)
            if r1 > 0:
                mesh.face([low[0], high[1], high[0]], [normals[0], normals[1], normals[0]], scale)


def add_handle(mesh: Mesh, scale: float) -> None:
    """Add the handle: a tube that leaves the middle of the wall, bends, and comes back into it."""
    start = RADIUS - WALL / 2.0
    turns = np.pi * np.arange(BEND_STEPS + 1) / BEND_STEPS
    bend = [(start + STRAIGHT + BEND * np.sin(a), -BEND * np.cos(a), np.sin(a), -np.cos(a)) for a in turns]
    path = [(start, -BEND, 0.0, -1.0), *bend, (start, BEND, 0.0, 1.0)]  # x, z, and the way outwards in that plane
    angles = 2.0 * np.pi * np.arange(TUBE_FACETS) / TUBE_FACETS
    rings, outwards = [], []
    for x, z, out_x, out_z in path:
        out, middle = np.array([out_x, 0.0, out_z]), np.array([x, 0.0, z])
        normals = [np.cos(a) * out + np.sin(a) * np.array([0.0, 1.0, 0.0]) for a in angles]
        rings.append([middle + TUBE * normal for normal in normals])
        outwards.append(normals)
    for i in range(len(rings) - 1):
        for k in range(TUBE_FACETS):
            n = (k + 1) % TUBE_FACETS
            a, b, c, d = rings[i][k], rings[i + 1][k], rings[i + 1][n], rings[i][n]
            na, nb, nc, nd = outwards[i][k], outwards[i + 1][k], outwards[i + 1][n], outwards[i][n]
            mesh.face([a, c, b], [na, nc, nb], scale)
            mesh.face([a, d, c], [na, nd, nc], scale)
    inwards = np.array([-1.0, 0.0, 0.0])
    for ring in (rings[0], rings[-1][::-1]):
        for k in range(1, TUBE_FACETS - 1):
            mesh.face([ring[0], ring[k + 1], ring[k]], [inwards] * 3, scale)


def build() -> str:
    """Return the text of mesh.obj, of a mug that touches the unit sphere."""
    reach = max(RADIUS - WALL / 2.0 + STRAIGHT + BEND + TUBE, np.hypot(RADIUS, HALF))
    mesh = Mesh()
    mesh.material("cup")
    add_cup(mesh, 1.0 / reach)
    mesh.material("handle")
    add_handle(mesh, 1.0 / reach)
    return mesh.text()


if __name__ == "__main__":
    (Path(__file__).parent / "mesh.obj").write_bytes(build().encode())
