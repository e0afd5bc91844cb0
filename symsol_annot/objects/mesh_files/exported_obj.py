"""OBJ files as exporters write them: any materials, negative indices, colours, places in textures, polygons.

Beyond what a `mesh.obj` of this package holds, these are read: a byte order mark, comments that are no UTF-8, lines
continued by a backslash, `v x y z w`, `v x y z r g b`, indices from the end, materials of any name, and polygons that
are not convex. Statements about curves are passed over.
"""

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError
from symsol_annot.system.text.toml import shown

_DEFAULT_MATERIAL = "default"
_FEWEST_OF_WEIGHTED, _FEWEST_WITH_COLOUR = 4, 6
_NO_UV = (np.nan, np.nan)
_CROSSED = "this face crosses itself, so it has no inside; divide it"


class ExportedObj:
    """The statements of one OBJ file.

    Args:
        data: its bytes.
        path: where they come from, for error messages.

    Attributes:
        vertices: (V, 3) f8.
        triangles: (T, 3) indices of vertices.
        material_of: (T,) indices of `materials`.
        materials: the names of those that faces have, in their order.
        libraries: the files of materials that it names.
        vertex_colours: (V, 3) u8 in sRGB; None unless each vertex has a colour.
        corner_uv: (T, 3, 2) where each triangle's corners are in a texture; no number where the file does not say.

    Raises:
        ObjectError: a statement is broken; the message names its line.
    """

    def __init__(self, data: bytes, path: str) -> None:
        self._path, self._line = path, 0
        self._points: list[tuple[float, float, float]] = []
        self._colours: list[list[float]] = []
        self._uv: list[tuple[float, float]] = [_NO_UV]  # the first is of corners that name none
        self._faces: list[tuple[list[int], list[int], int, int]] = []  # corners, their places, material, line
        self._names: dict[str, int] = {}
        self._material = _DEFAULT_MATERIAL
        self.libraries: list[str] = []
        self._read(data)
        self.vertices: npt.NDArray[np.float64] = np.array(self._points, dtype=np.float64).reshape(-1, 3)
        triangles: list[tuple[int, int, int]] = []
        uv: list[tuple[int, int, int]] = []
        material_of: list[int] = []
        for corners, places, material, line in self._faces:
            self._line = line
            for a, b, c in self._triangles(corners):
                triangles.append((corners[a], corners[b], corners[c]))
                uv.append((places[a], places[b], places[c]))
                material_of.append(material)
        self.triangles = np.array(triangles, dtype=np.intp).reshape(-1, 3)
        self.material_of = np.array(material_of, dtype=np.intp)
        self.materials = tuple(self._names)
        self.vertex_colours = self._read_colours()
        self.corner_uv: npt.NDArray[np.float64] = np.array(self._uv)[np.array(uv, dtype=np.intp).reshape(-1, 3)]

    def _read(self, data: bytes) -> None:
        text = data.decode("latin-1").removeprefix("\xef\xbb\xbf")
        statement, begun = "", 0
        for number, line in enumerate(text.splitlines(), start=1):
            content = line.split("#", 1)[0].rstrip()
            begun = begun or number
            if content.endswith("\\"):
                statement += content[:-1] + " "
                continue
            self._line, words = begun, (statement + content).split()
            statement, begun = "", 0
            if words:
                self._statement(words)

    def _statement(self, words: list[str]) -> None:
        if words[0] == "v":
            self._points.append(self._vertex(words[1:]))
        elif words[0] == "vt":
            self._uv.append(_uv_of(words[1:]))
        elif words[0] == "f":
            corners = [self._index(word) for word in words[1:]]
            kept = [place for place, corner in enumerate(corners) if corner != corners[place - 1]]
            if len(kept) >= 3:
                material = self._names.setdefault(self._material, len(self._names))
                places = [self._uv_index(words[1 + place]) for place in kept]
                self._faces.append(([corners[place] for place in kept], places, material, self._line))
        elif words[0] == "usemtl":
            self._material = " ".join(words[1:]) or _DEFAULT_MATERIAL
        elif words[0] == "mtllib" and len(words) > 1:
            self.libraries.append(" ".join(words[1:]))

    def _fault(self, what: str) -> ObjectError:
        return ObjectError(f"{self._path}, line {self._line}: {what}")

    def _vertex(self, words: list[str]) -> tuple[float, float, float]:
        try:
            numbers = [float(word) for word in words]
        except ValueError:
            numbers = []
        if len(numbers) not in {3, 4, 6, 7} or not np.isfinite(numbers).all():
            raise self._fault(
                f"expected a vertex as three finite numbers, four with a weight, or six or seven with a colour, "
                f"found {shown(' '.join(words))}"
            )
        weight = numbers[3] if len(numbers) == _FEWEST_OF_WEIGHTED else 1.0
        if weight == 0:
            raise self._fault("a vertex has the weight 0, so it lies at no place; give it 1")
        if len(numbers) >= _FEWEST_WITH_COLOUR:
            self._colours.append(numbers[-3:])
        x, y, z = (number / weight for number in numbers[:3])
        return x, y, z

    def _read_colours(self) -> npt.NDArray[np.uint8] | None:
        """Return the vertices' colours (V, 3), which are from 0 to 1, or to 255 where one is beyond 1."""
        if not self._points or len(self._colours) < len(self._points):
            return None
        colours = np.array(self._colours)
        scale = 255.0 if colours.max() <= 1.0 else 1.0
        return np.clip(np.round(colours * scale), 0, 255).astype(np.uint8)

    def _uv_index(self, word: str) -> int:
        """Return the place in the texture that a corner names; 0, which is none, where it names none that is there."""
        second, count = word.split("/")[1:2], len(self._uv) - 1
        try:
            number = int(second[0]) if second else 0
        except ValueError:
            number = 0
        index = number if number > 0 else count + 1 + number
        return index if number != 0 and 1 <= index <= count else 0

    def _index(self, word: str) -> int:
        first, count = word.split("/", 1)[0], len(self._points)
        try:
            number = int(first)
        except ValueError:
            number = 0
        index = number - 1 if number > 0 else count + number
        if number == 0 or not 0 <= index < count:
            raise self._fault(f"vertex {shown(first)} does not exist; {count} are defined above this line")
        return index

    def _triangles(self, corners: list[int]) -> list[tuple[int, int, int]]:
        """Cut a polygon into triangles, by its ears, as seen along its normal: the numbers of its corners, from 0."""
        if len(corners) == 3:
            return [(0, 1, 2)]
        points = self.vertices[corners]
        following = np.roll(points, -1, axis=0)
        normal = np.cross(points - points[0], following - points[0]).sum(axis=0)
        length = float(np.linalg.norm(normal))
        if length == 0:
            if np.linalg.matrix_rank(points - points[0]) > 1:
                raise self._fault(_CROSSED)
            return []
        normal /= length
        across = np.cross(normal, np.eye(3)[int(np.abs(normal).argmin())])
        flat = np.stack([points @ across, points @ np.cross(normal, across)], axis=1)
        return _ears(flat, self._fault)


def _uv_of(words: list[str]) -> tuple[float, float]:
    try:
        u, v = (float(word) for word in words[:2])
    except ValueError:
        return _NO_UV
    return u, v


def _ears(flat: npt.NDArray[np.float64], fault: Callable[[str], ObjectError]) -> list[tuple[int, int, int]]:
    """Return the triangles of a simple polygon (n, 2), counter-clockwise."""
    if _crosses_itself(flat):
        raise fault(_CROSSED)
    left = list(range(len(flat)))
    triangles = []
    while len(left) > 3:
        for place in range(len(left)):
            a, b, c = left[place - 1], left[place], left[(place + 1) % len(left)]
            if _turn(flat[a], flat[b], flat[c]) > 0 and not _holds_one(flat, (a, b, c), left):
                triangles.append((a, b, c))
                del left[place]
                break
        else:
            straight = [p for p in range(len(left)) if _is_straight(flat, left, p)]
            if not straight:
                raise fault(_CROSSED)
            del left[straight[0]]
    a, b, c = left
    return [*triangles, (a, b, c)]


def _crosses_itself(flat: npt.NDArray[np.float64]) -> bool:
    """Tell whether two edges of a polygon (n, 2) cross, other than at their ends."""
    start, end = flat, np.roll(flat, -1, axis=0)
    edge = end - start

    def sides(points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return on which side of each edge (row) points (column) are."""
        to = points[None] - start[:, None]
        return np.asarray(np.sign(edge[:, None, 0] * to[..., 1] - edge[:, None, 1] * to[..., 0]))

    apart = sides(start) * sides(end) < 0
    return bool((apart & apart.T).any())


def _turn(a: npt.NDArray[np.float64], b: npt.NDArray[np.float64], c: npt.NDArray[np.float64]) -> float:
    return float((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))


def _is_straight(flat: npt.NDArray[np.float64], left: list[int], place: int) -> bool:
    a, b, c = flat[left[place - 1]], flat[left[place]], flat[left[(place + 1) % len(left)]]
    size = float(np.square(c - a).sum() + np.square(b - a).sum())
    return abs(_turn(a, b, c)) <= 1e-9 * size


def _holds_one(flat: npt.NDArray[np.float64], corners: tuple[int, int, int], left: list[int]) -> bool:
    """Tell whether another of the polygon's corners lies in a triangle or on its border."""
    others = [index for index in left if index not in corners]
    points = flat[others]
    is_inside = np.ones(len(points), dtype=bool)
    for start, end in ((0, 1), (1, 2), (2, 0)):
        a, b = flat[corners[start]], flat[corners[end]]
        is_inside &= (b[0] - a[0]) * (points[:, 1] - a[1]) - (b[1] - a[1]) * (points[:, 0] - a[0]) >= 0
    is_same = (points[:, None] == flat[list(corners)]).all(axis=-1).any(axis=1)
    return bool((is_inside & ~is_same).any())
