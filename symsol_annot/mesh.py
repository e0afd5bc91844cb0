"""Triangle meshes of objects: reading the OBJ files, and checking what rendering relies on.

The subset of OBJ read here: `v`, `vn`, `usemtl body|marking` and `f` with convex polygons; other
statements (`#`, `o`, `g`, `s`, `mtllib`, `vt`) are passed over. A face without `vn` is flat.
"""

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError

MATERIALS = ("body", "marking")
BOUNDING_RADIUS_TOLERANCE = 1e-6
_IGNORED = {"o", "g", "s", "mtllib", "vt", "l", "p"}


@dataclass(frozen=True, eq=False)
class Mesh:
    """A closed triangle mesh in model coordinates; the bounding sphere has radius 1 around the origin.

    Attributes:
        vertices: (V, 3) f8.
        triangles: (T, 3) indices of vertices, counter-clockwise seen from outside.
        corner_normals: (T, 3, 3) f8 unit normals, one a corner of a triangle.
        is_marking: (T,) bool, which triangles carry the marking.
    """

    vertices: npt.NDArray[np.float64]
    triangles: npt.NDArray[np.intp]
    corner_normals: npt.NDArray[np.float64]
    is_marking: npt.NDArray[np.bool_]

    @property
    def marking_vertices(self) -> npt.NDArray[np.float64]:
        """The (M, 3) vertices that the marking's triangles use."""
        return self.vertices[np.unique(self.triangles[self.is_marking])]


def read_mesh(path: Path) -> Mesh:
    """Read a mesh.obj and check that it is closed, faces outwards and fits the unit sphere.

    Raises:
        ObjectError: the file is missing or broken; the message names the line or the edge.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise ObjectError(f"{path}: no such file; an object is a folder with object.toml and mesh.obj") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ObjectError(f"{path}: cannot be read: {error}") from None
    mesh = _ObjParser(path).parse(text)
    _check_bounding_sphere(path, mesh)
    _check_closed(path, mesh)
    return mesh


class _ObjParser:
    """Collects the statements of one OBJ file; every fault names its line."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._line = 0
        self._vertices: list[list[float]] = []
        self._normals: list[list[float]] = []
        self._material = "body"
        self._corners: list[list[tuple[int, int | None]]] = []  # a triangle: three (vertex, normal or None)
        self._is_marking: list[bool] = []
        self._lines: list[int] = []  # where each triangle stands

    def parse(self, text: str) -> Mesh:
        """Return the mesh that the text describes."""
        for self._line, line in enumerate(text.splitlines(), start=1):
            words = line.split("#", 1)[0].split()
            if words:
                self._statement(words[0], words[1:])
        if not self._corners:
            raise ObjectError(f"{self._path}: no faces ('f' lines) found")
        return self._mesh()

    def _fault(self, what: str) -> ObjectError:
        return ObjectError(f"{self._path}, line {self._line}: {what}")

    def _statement(self, keyword: str, words: list[str]) -> None:
        if keyword == "v":
            self._vertices.append(self._numbers(words, "a vertex"))
        elif keyword == "vn":
            self._normals.append(self._numbers(words, "a normal"))
            if not any(self._normals[-1]):
                raise self._fault("a normal has no direction: all three numbers are 0")
        elif keyword == "usemtl":
            if len(words) != 1 or words[0] not in MATERIALS:
                raise self._fault(f"expected 'usemtl body' or 'usemtl marking', found 'usemtl {' '.join(words)}'")
            self._material = words[0]
        elif keyword == "f":
            self._face(words)
        elif keyword not in _IGNORED:
            raise self._fault(f"unknown statement {keyword!r}")

    def _numbers(self, words: list[str], what: str) -> list[float]:
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            numbers = []
        if len(numbers) != 3 or not np.all(np.isfinite(numbers)):
            raise self._fault(f"expected {what} as three finite numbers, found '{' '.join(words)}'")
        return numbers

    def _face(self, words: list[str]) -> None:
        corners = [self._corner(word) for word in words]
        if len(corners) < 3:
            raise self._fault(f"a face needs at least 3 corners, found {len(corners)}")
        for second, third in pairwise(corners[1:]):
            self._corners.append([corners[0], second, third])
            self._is_marking.append(self._material == "marking")
            self._lines.append(self._line)

    def _corner(self, word: str) -> tuple[int, int | None]:
        parts = word.split("/")
        vertex = self._index(parts[0], len(self._vertices), "vertex")
        normal = self._index(parts[2], len(self._normals), "normal") if len(parts) > 2 and parts[2] else None
        return vertex, normal

    def _index(self, word: str, count: int, what: str) -> int:
        if not word.isdecimal() or not 1 <= int(word) <= count:
            raise self._fault(f"{what} {word!r} does not exist; {count} are defined above this line, from 1")
        return int(word) - 1

    def _mesh(self) -> Mesh:
        vertices = np.array(self._vertices)
        triangles = np.array([[vertex for vertex, _ in corners] for corners in self._corners], dtype=np.intp)
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        flat = np.cross(b - a, c - a)
        doubled_area = np.linalg.norm(flat, axis=1)
        if np.any(doubled_area < 1e-12):
            self._line = self._lines[int(np.argmin(doubled_area))]
            raise self._fault("a triangle of this face has no area")
        corner_normals = np.repeat((flat / doubled_area[:, None])[:, None], 3, axis=1)
        for row, corners in enumerate(self._corners):
            for column, (_, normal) in enumerate(corners):
                if normal is not None:
                    given = np.array(self._normals[normal])
                    corner_normals[row, column] = given / np.linalg.norm(given)
        return Mesh(vertices, triangles, corner_normals, np.array(self._is_marking))


def _check_bounding_sphere(path: Path, mesh: Mesh) -> None:
    radius = float(np.linalg.norm(mesh.vertices[mesh.triangles], axis=-1).max())
    if abs(radius - 1.0) > BOUNDING_RADIUS_TOLERANCE:
        raise ObjectError(
            f"{path}: the vertices reach {radius:.9g} from the origin, expected 1: "
            f"centre the bounding sphere at the origin and scale by {1.0 / radius:.9g}"
        )


def _check_closed(path: Path, mesh: Mesh) -> None:
    """Back faces are culled, so a hole or a face turned inside out would show as a gap in the body."""
    edges = Counter((int(triangle[i]), int(triangle[(i + 1) % 3])) for triangle in mesh.triangles for i in range(3))
    for (start, end), count in edges.items():
        if count != 1 or edges.get((end, start), 0) != 1:
            raise ObjectError(
                f"{path}: the surface is not closed at the edge between vertices {start + 1} and {end + 1}: "
                "every edge needs exactly two faces, wound the same way"
            )
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    if float(np.einsum("ij,ij->", a, np.cross(b, c))) <= 0:
        raise ObjectError(f"{path}: the faces look inwards; wind them counter-clockwise seen from outside")
