"""What the meshes of the built-in objects are put together from: faces, turned profiles, cut polygons."""

from collections.abc import Iterable, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

FACETS = 360  # of a round body: its surface is then invariant under turns by 1 degree
UP = np.array([0.0, 0.0, 1.0])


class MeshBuilder:
    """Gathers faces; equal vertices and equal normals are written once."""

    def __init__(self) -> None:
        self._vertices = _Numbered()
        self._normals = _Numbered()
        self._faces: dict[str, list[str]] = {"body": [], "marking": []}  # the materials in the order of the file

    def add(self, corners: Iterable[Points], normals: Iterable[Points], material: str = "body") -> None:
        """Add a face: its corners counter-clockwise seen from outside, and a normal a corner."""
        words = [
            f"{self._vertices.number(corner)}//{self._normals.number(normal)}"
            for corner, normal in zip(corners, normals, strict=True)
        ]
        self._faces.setdefault(material, []).append("f " + " ".join(words))

    def add_flat(self, corners: Points, normal: Points, material: str = "body") -> None:
        """Add a flat face of corners (k, 3) that run around it either way."""
        doubled = np.cross(corners[1:-1] - corners[0], corners[2:] - corners[0]).sum(axis=0)
        self.add(corners if doubled @ normal > 0 else corners[::-1], [normal] * len(corners), material)

    def text(self, title: str) -> str:
        """Return the text of the OBJ file."""
        lines = [f"# {title}; built by symsol_annot_assets.build"]
        lines += [f"v {coordinates}" for coordinates in self._vertices.texts]
        lines += [f"vn {coordinates}" for coordinates in self._normals.texts]
        for material, faces in self._faces.items():
            lines += [f"usemtl {material}", *faces] if faces else []
        return "\n".join(lines) + "\n"


class _Numbered:
    """Points as texts, each numbered once, from 1."""

    def __init__(self) -> None:
        self.texts: dict[str, int] = {}
        self._by_bytes: dict[bytes, int] = {}  # of points that came before: most corners come six times

    def number(self, point: Points) -> int:
        """Return a point's number, after adding it where it is new."""
        data = np.asarray(point, dtype=np.float64).tobytes()
        if data not in self._by_bytes:
            coordinates = " ".join(f"{x:.9f}" for x in np.round(point, 9) + 0.0)  # + 0.0: no "-0.000000000"
            self._by_bytes[data] = self.texts.setdefault(coordinates, len(self.texts) + 1)
        return self._by_bytes[data]


def radial(step: float) -> Points:
    """Return the horizontal unit vector at a number of facets, not always whole, from the x axis.

    Between whole numbers it points to the chord, so that it is the analytic normal of a point on a facet.
    """
    whole, part = int(np.floor(step)), step - np.floor(step)
    at = [np.array([np.cos(a), np.sin(a), 0.0]) for a in 2.0 * np.pi * np.array([whole, whole + 1]) / FACETS]
    chord: Points = (1.0 - part) * at[0] + part * at[1]
    return chord / np.linalg.norm(chord)


def triangulate(polygon: Points) -> list[Points]:
    """Cut a simple polygon (n, 2), counter-clockwise, into n - 2 triangles (3, 2): the fattest ear first."""
    remaining = list(polygon)
    triangles = []
    while len(remaining) > 3:
        ears = [
            np.array([remaining[i - 1], remaining[i], remaining[(i + 1) % len(remaining)]])
            for i in range(len(remaining))
        ]
        fatness = [_fatness(ear) if not _holds_another(ear, remaining) else -1.0 for ear in ears]
        best = int(np.argmax(fatness))
        triangles.append(ears[best])
        del remaining[best]
    return [*triangles, np.array(remaining)]


def _cross(a: Points, b: Points) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def _fatness(triangle: Points) -> float:
    """Return area over the square of the longest side; negative where the corner is no ear."""
    sides = np.roll(triangle, -1, axis=0) - triangle
    return _cross(sides[0], sides[1]) / float(np.square(sides).sum(axis=1).max())


def _holds_another(triangle: Points, points: list[Points]) -> bool:
    a, b, c = triangle
    return any(
        all(_cross(end - start, point - start) >= -1e-12 for start, end in ((a, b), (b, c), (c, a)))
        for point in points
        if not any(np.array_equal(point, corner) for corner in triangle)
    )


def add_turned(mesh: MeshBuilder, profile: Sequence[tuple[float, float]], material: str = "body") -> None:
    """Add what a profile sweeps when it is turned about z in FACETS steps.

    Args:
        mesh: gathers the faces.
        profile: points (radius, z), with the body on the left of the way from each to the next.
        material: of the faces.
    """
    for (r0, z0), (r1, z1) in pairwise(profile):
        along = np.array([z1 - z0, r0 - r1]) / np.hypot(r1 - r0, z1 - z0)  # of the normal: from the axis, and up
        for k in range(FACETS):
            ways = [radial(k), radial((k + 1) % FACETS)]
            low, high = ([r * way + z * UP for way in ways] for r, z in ((r0, z0), (r1, z1)))
            normals = [along[0] * way + along[1] * UP for way in ways]
            if r0 > 0:
                mesh.add([low[0], low[1], high[1]], [normals[0], normals[1], normals[1]], material)
            if r1 > 0:
                mesh.add([low[0], high[1], high[0]], [normals[0], normals[1], normals[0]], material)


def hexagon(circumradius: float) -> Points:
    """Return the corners (6, 3) of a hexagon about z, the first on the x axis."""
    return np.array([circumradius * radial(k) for k in range(0, FACETS, FACETS // 6)])


def add_between(mesh: MeshBuilder, corners: Points, radius: float, normal: Points, material: str = "body") -> None:
    """Add the flat face between a hexagon's corners (6, 3) and a circle about z of FACETS steps in its plane."""
    sixth = FACETS // 6
    for number, corner in enumerate(corners):
        following = corners[(number + 1) % 6]
        circle = [radius * radial((number * sixth + k) % FACETS) + corner[2] * UP for k in range(sixth + 1)]
        half = sixth // 2
        for k in range(sixth):
            mesh.add_flat(np.array([corner if k < half else following, circle[k], circle[k + 1]]), normal, material)
        mesh.add_flat(np.array([corner, following, circle[half]]), normal, material)


def add_hexagonal_side(
    mesh: MeshBuilder, circumradius: float, z: tuple[float, float], sign: int, material: str
) -> None:
    """Add the six rectangles over a hexagon, from one height to another, that look outwards (1) or inwards (-1)."""
    corners = hexagon(circumradius)
    for first, second in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        outwards = (first + second) / np.linalg.norm(first + second)
        rectangle = np.array([first + z[0] * UP, second + z[0] * UP, second + z[1] * UP, first + z[1] * UP])
        mesh.add_flat(rectangle, sign * outwards, material)
