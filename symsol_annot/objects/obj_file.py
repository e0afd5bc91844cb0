"""Meshes from OBJ files, checked for what rendering relies on.

The subset of OBJ read here: `v`, `vn`, `usemtl` and `f` with convex polygons; other statements (`#`, `o`, `g`, `s`,
`mtllib`, `vt`) are passed over. A face without `vn` is flat. In an object of format version 1, faces before the first
`usemtl` belong to the body; in one of version 2, whose parts are told by their materials, they are refused.
"""

import io
import math
from array import array
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import numpy as np

from symsol_annot.errors import ObjectError
from symsol_annot.objects.mesh import BODY_ID, Mesh
from symsol_annot.system.reading import read_bytes
from symsol_annot.system.text.toml import shown

MATERIALS = ("body", "marking")  # of an object of format version 1
BOUNDING_RADIUS_TOLERANCE = 1e-6
MAX_MESH_BYTES = 2**26
MAX_TRIANGLES = MAX_POINTS = 250_000  # points: vertices, and normals; a shipped mesh has up to 2,900 triangles
_MAX_LINES, _MAX_LINE = 3_000_000, 2**20  # characters of a line: a polygon of 100,000 corners
_LARGEST = 1e30  # of a coordinate: its fourth power is a number yet
_MAX_DIGITS = 18  # of an index
_NO_PART = 0  # before the first 'usemtl', where there is no part of which that could be
_FLAT = -1  # in place of a normal's index
_IGNORED = {"o", "g", "s", "mtllib", "vt", "l", "p"}


def read_mesh(path: Path) -> Mesh:
    """Read a mesh.obj and check that it is closed, faces outwards and fits the unit sphere.

    Raises:
        ObjectError: the file is missing or broken; the message names the line or the edge.
    """
    return parse_mesh(read_object_file(path, MAX_MESH_BYTES), path)


def parse_mesh(data: bytes, path: Path, materials: tuple[str, ...] | None = None) -> Mesh:
    """Return the mesh that a mesh.obj's bytes describe, checked as `read_mesh` does.

    Args:
        data: of the file.
        path: where they come from, for error messages.
        materials: those of the parts, in the order of the parts' ids, the first of id 1; None in format version 1.

    Raises:
        ObjectError: they are broken.
    """
    mesh = _ObjParser(path, materials).parse(data)
    _check_bounding_sphere(path, mesh)
    _check_closed(path, mesh)
    return mesh


def read_object_file(path: Path, limit: int) -> bytes:
    """Return the bytes of one of the files that make an object.

    Raises:
        ObjectError: it is missing, unreadable, no regular file, or larger than `limit`.
    """
    try:
        return read_bytes(path, limit)
    except FileNotFoundError:
        raise ObjectError(f"{path}: no such file; an object is a folder with object.toml and mesh.obj") from None
    except OSError as error:
        raise ObjectError(f"{path}: cannot be read: {error.strerror or error}") from None


class _ObjParser:
    """Collects the statements of one OBJ file; every fault names its line."""

    def __init__(self, path: Path, materials: tuple[str, ...] | None) -> None:
        self._path = path
        self._line = 0
        self._ids = {material: number for number, material in enumerate(materials or MATERIALS, start=BODY_ID)}
        self._is_first_version = materials is None
        self._vertices, self._normals = array("d"), array("d")  # three numbers each
        self._part = BODY_ID if self._is_first_version else _NO_PART
        self._corners, self._corner_normals = array("q"), array("q")  # three indices per triangle
        self._parts = bytearray()
        self._lines = array("q")  # where each triangle stands

    def parse(self, data: bytes) -> Mesh:
        """Return the mesh that the file describes."""
        lines = self._lines_of(data)
        for self._line, line in enumerate(lines, start=1):
            words = line.split("#", 1)[0].split()
            if words:
                self._statement(words[0], words[1:])
        if not self._corners:
            raise ObjectError(f"{self._path}: no faces ('f' lines) found")
        return self._mesh()

    def _lines_of(self, data: bytes) -> Iterator[str]:
        file = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8-sig")
        try:
            for _ in range(_MAX_LINES):
                line = file.readline(_MAX_LINE)
                if not line:
                    return
                if len(line) == _MAX_LINE:
                    raise self._too_many(f"characters in line {self._line + 1}", _MAX_LINE)
                yield line
        except UnicodeDecodeError as error:
            raise ObjectError(f"{self._path}: cannot be read: {error}") from None
        raise self._too_many("lines", _MAX_LINES)

    def _fault(self, what: str) -> ObjectError:
        return ObjectError(f"{self._path}, line {self._line}: {what}")

    def _too_many(self, what: str, limit: int) -> ObjectError:
        return ObjectError(f"{self._path}: more than {limit:,} {what}; an object's mesh has no use for so many")

    def _statement(self, keyword: str, words: list[str]) -> None:
        if keyword == "v":
            self._vertices.extend(self._numbers(words, "a vertex", self._vertices))
        elif keyword == "vn":
            self._normals.extend(self._normal(words))
        elif keyword == "usemtl":
            self._part = self._part_of(" ".join(words))
        elif keyword == "f":
            self._face(words)
        elif keyword not in _IGNORED:
            raise self._fault(f"unknown statement {shown(keyword)}")

    def _part_of(self, material: str) -> int:
        if material in self._ids:
            return self._ids[material]
        if self._is_first_version:
            raise self._fault(f"expected 'usemtl body' or 'usemtl marking', found {shown(f'usemtl {material}')}")
        raise self._fault(
            f"no [[part]] of object.toml selects the material {shown(material)}, so that its faces would be in no part"
        )

    def _numbers(self, words: list[str], what: str, there: "array[float]") -> tuple[float, float, float]:
        try:
            x, y, z = map(float, words)
        except ValueError:
            x = y = z = math.nan
        if not (math.isfinite(x) and math.isfinite(y) and math.isfinite(z) and _is_plain(words)):
            raise self._fault(f"expected {what} as three finite numbers, found {shown(' '.join(words))}")
        if max(abs(x), abs(y), abs(z)) > _LARGEST:
            raise self._fault(f"expected {what} within {_LARGEST:g}, found {shown(' '.join(words))}")
        if len(there) >= 3 * MAX_POINTS:
            raise self._too_many("vertices or normals", MAX_POINTS)
        return x, y, z

    def _normal(self, words: list[str]) -> tuple[float, float, float]:
        x, y, z = self._numbers(words, "a normal", self._normals)
        if x == y == z == 0:
            raise self._fault("a normal has no direction: all three numbers are 0")
        length = math.sqrt(x * x + y * y + z * z)
        if length < 1.0 / _LARGEST:
            raise self._fault(f"expected a normal longer than {1.0 / _LARGEST:g}, found {shown(' '.join(words))}")
        return x / length, y / length, z / length

    def _face(self, words: list[str]) -> None:
        corners = [self._corner(word) for word in words]
        if len(corners) < 3:
            raise self._fault(f"a face needs at least 3 corners, found {len(corners)}")
        if self._part == _NO_PART:
            raise self._fault("a face is in no part, for no 'usemtl' above it says which material it has")
        if len(self._lines) + len(corners) - 2 > MAX_TRIANGLES:
            raise self._too_many("triangles", MAX_TRIANGLES)
        for second, third in pairwise(corners[1:]):
            for vertex, normal in (corners[0], second, third):
                self._corners.append(vertex)
                self._corner_normals.append(normal)
            self._parts.append(self._part)
            self._lines.append(self._line)

    def _corner(self, word: str) -> tuple[int, int]:
        parts = word.split("/")
        vertex = self._index(parts[0], len(self._vertices) // 3, "vertex")
        has_normal = len(parts) > 2 and parts[2]
        return vertex, self._index(parts[2], len(self._normals) // 3, "normal") if has_normal else _FLAT

    def _index(self, word: str, count: int, what: str) -> int:
        is_number = word.isascii() and word.isdecimal() and len(word) <= _MAX_DIGITS
        if not is_number or not 1 <= int(word) <= count:
            raise self._fault(f"{what} {shown(word)} does not exist; {count} are defined above this line, from 1")
        return int(word) - 1

    def _mesh(self) -> Mesh:
        vertices = np.array(self._vertices).reshape(-1, 3)
        triangles = np.array(self._corners, dtype=np.intp).reshape(-1, 3)
        a, b, c = (vertices[triangles[:, i]] for i in range(3))
        flat = np.cross(b - a, c - a)
        doubled_area = np.linalg.norm(flat, axis=1)
        if np.any(doubled_area < 1e-12):
            self._line = self._lines[int(np.argmin(doubled_area))]
            raise self._fault("a triangle of this face has no area")
        corner_normals = np.repeat((flat / doubled_area[:, None])[:, None], 3, axis=1)
        given = np.array(self._corner_normals, dtype=np.intp).reshape(-1, 3)
        corner_normals[given != _FLAT] = np.array(self._normals).reshape(-1, 3)[given[given != _FLAT]]
        return Mesh(vertices, triangles, corner_normals, np.frombuffer(self._parts, dtype=np.uint8).copy())


def _is_plain(words: list[str]) -> bool:
    """Tell whether numbers are written as OBJ has them: Python also reads 1_000, and other scripts' digits."""
    text = "".join(words)
    return text.isascii() and "_" not in text


def _check_bounding_sphere(path: Path, mesh: Mesh) -> None:
    radius = float(np.linalg.norm(mesh.vertices[mesh.triangles], axis=-1).max())
    if abs(radius - 1.0) > BOUNDING_RADIUS_TOLERANCE:
        raise ObjectError(
            f"{path}: the vertices reach {radius:.9g} from the origin, expected 1: "
            f"centre the bounding sphere at the origin and scale by {1.0 / radius:.9g}"
        )


def _check_closed(path: Path, mesh: Mesh) -> None:
    """Back faces are culled, so a hole or a face turned inside out would show as a gap in the body."""
    starts = mesh.triangles.ravel()
    ends = np.roll(mesh.triangles, -1, axis=1).ravel()
    edges, reverse = (first * len(mesh.vertices) + second for first, second in ((starts, ends), (ends, starts)))
    known, place, times = np.unique(edges, return_inverse=True, return_counts=True)
    is_paired = np.isin(reverse, known[times == 1])
    faulty = np.flatnonzero((times[place] != 1) | ~is_paired)
    if len(faulty):
        raise ObjectError(
            f"{path}: the surface is not closed at the edge between vertices {starts[faulty[0]] + 1} and "
            f"{ends[faulty[0]] + 1}: every edge needs exactly two faces, wound the same way"
        )
    a, b, c = (mesh.vertices[mesh.triangles[:, i]] for i in range(3))
    if float(np.einsum("ij,ij->", a, np.cross(b, c))) <= 0:
        raise ObjectError(f"{path}: the faces look inwards; wind them counter-clockwise seen from outside")
