"""Build the folders of the built-in objects: object.toml and mesh.obj.

    python -m symsol_annot_assets.build            # write them
    python -m symsol_annot_assets.build --check    # say whether what is there is what this script builds

Coordinates are written with 9 decimals, so that the last bit of a platform's cosine does not show.
"""

import argparse
import sys
from collections.abc import Callable, Iterable
from itertools import combinations
from pathlib import Path

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]

FACETS = 360  # of a round body: its surface is then invariant under turns by 1 degree
CYLINDER_LENGTH_OVER_WIDTH = 1.15
CYLINDER_RADIUS = 1.0 / np.hypot(1.0, CYLINDER_LENGTH_OVER_WIDTH)
CYLINDER_TOP = CYLINDER_LENGTH_OVER_WIDTH * CYLINDER_RADIUS
CONE_BASE_Z = -0.6  # the base circle lies on the unit sphere at this height, the apex at z = 1
DISC_RADIUS = 0.2 * CYLINDER_RADIUS  # along the surface: the disc is a fifth of the cylinder wide
DISC_CENTRE_Z = 0.55
DISC_CORNERS = 96
UP = np.array([0.0, 0.0, 1.0])


class MeshBuilder:
    """Gathers faces; equal vertices and equal normals are written once."""

    def __init__(self) -> None:
        self._vertices: dict[str, int] = {}
        self._normals: dict[str, int] = {}
        self._faces: dict[str, list[str]] = {"body": [], "marking": []}

    def add(self, corners: Iterable[Points], normals: Iterable[Points], material: str = "body") -> None:
        """Add a face: its corners counter-clockwise seen from outside, and a normal a corner."""
        words = [
            f"{_number(self._vertices, corner)}//{_number(self._normals, normal)}"
            for corner, normal in zip(corners, normals, strict=True)
        ]
        self._faces[material].append("f " + " ".join(words))

    def text(self, title: str) -> str:
        """Return the text of the OBJ file."""
        lines = [f"# {title}; built by symsol_annot_assets.build"]
        lines += [f"v {coordinates}" for coordinates in self._vertices]
        lines += [f"vn {coordinates}" for coordinates in self._normals]
        for material, faces in self._faces.items():
            lines += [f"usemtl {material}", *faces] if faces else []
        return "\n".join(lines) + "\n"


def _number(table: dict[str, int], point: Points) -> int:
    """Return a point's number in the table, from 1, after adding it where it is new."""
    coordinates = " ".join(f"{x:.9f}" for x in np.round(point, 9) + 0.0)  # + 0.0: no "-0.000000000"
    return table.setdefault(coordinates, len(table) + 1)


def regular_solid(vertices: Points, marked_face_normal: Points | None = None) -> MeshBuilder:
    """Return the convex hull of `vertices` (n, 3), flat shaded; its faces are the supporting planes of 3 or more."""
    mesh = MeshBuilder()
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    found: set[frozenset[int]] = set()
    for triple in combinations(range(len(vertices)), 3):
        a, b, c = vertices[list(triple)]
        normal = np.cross(b - a, c - a)
        normal /= np.linalg.norm(normal) * np.sign(normal @ a or 1.0)
        on_plane = frozenset(np.flatnonzero(np.abs(vertices @ normal - normal @ a) < 1e-9).tolist())
        if on_plane in found or np.any(vertices @ normal > normal @ a + 1e-9):
            continue
        found.add(on_plane)
        corners = _counter_clockwise(vertices[sorted(on_plane)], normal)
        marked = marked_face_normal is not None and bool(normal @ marked_face_normal > 1 - 1e-9)
        for second in range(1, len(corners) - 1):
            mesh.add(corners[[0, second, second + 1]], [normal] * 3, "marking" if marked else "body")
    return mesh


def _counter_clockwise(points: Points, normal: Points) -> Points:
    centre = points.mean(axis=0)
    x = points[0] - centre
    angles = np.arctan2((points - centre) @ np.cross(normal, x), (points - centre) @ x)
    return points[np.argsort(angles)]


def radial(step: float) -> Points:
    """Return the horizontal unit vector at a number of facets, not always whole, from the x axis.

    Between whole numbers it points to the chord, so that it is the analytic normal of a point on a facet.
    """
    whole, part = int(np.floor(step)), step - np.floor(step)
    at = [np.array([np.cos(a), np.sin(a), 0.0]) for a in 2.0 * np.pi * np.array([whole, whole + 1]) / FACETS]
    chord: Points = (1.0 - part) * at[0] + part * at[1]
    return chord / np.linalg.norm(chord)


def cone() -> MeshBuilder:
    """Return the cone: apex (0, 0, 1), base circle on the unit sphere."""
    mesh = MeshBuilder()
    base_radius, height = np.sqrt(1.0 - CONE_BASE_Z**2), 1.0 - CONE_BASE_Z
    rim = [base_radius * radial(k) + CONE_BASE_Z * UP for k in range(FACETS)]

    def normal(step: float) -> Points:
        return (height * radial(step) + base_radius * UP) / np.hypot(height, base_radius)

    for k in range(FACETS):
        following = (k + 1) % FACETS
        mesh.add([rim[k], rim[following], UP], [normal(k), normal(following), normal(k + 0.5)])
        mesh.add([CONE_BASE_Z * UP, rim[following], rim[k]], [-UP] * 3)
    return mesh


def cylinder(*, disc: bool) -> MeshBuilder:
    """Return the cylinder about z, a prism of 360 facets, with or without a disc cut out of its side."""
    mesh = MeshBuilder()
    for k in range(-FACETS // 2, FACETS // 2):
        regions = _facet_regions(k) if disc else {"body": [_rectangle(0.0, 1.0)]}
        for material, polygons in regions.items():
            for polygon in polygons:
                for triangle in triangulate(polygon):
                    corners, normals = zip(*(_on_facet(k, part, z) for part, z in triangle), strict=True)
                    mesh.add(corners, normals, material)
        for z in (-CYLINDER_TOP, CYLINDER_TOP):
            rim = [CYLINDER_RADIUS * radial(step) + z * UP for step in (k, k + 1)]
            cap = np.sign(z) * UP
            mesh.add([z * UP, *(rim if z > 0 else rim[::-1])], [cap] * 3)
    return mesh


def _on_facet(k: int, part: float, z: float) -> tuple[Points, Points]:
    """Return the point and the normal at a part (0 to 1) of the way across facet k, at height z."""
    edges = [CYLINDER_RADIUS * radial(k), CYLINDER_RADIUS * radial(k + 1)]
    return (1.0 - part) * edges[0] + part * edges[1] + z * UP, radial(k + part)


def _rectangle(left: float, right: float) -> Points:
    return np.array([[left, -CYLINDER_TOP], [right, -CYLINDER_TOP], [right, CYLINDER_TOP], [left, CYLINDER_TOP]])


def _facet_regions(k: int) -> dict[str, list[Points]]:
    """Cut facet k along the disc: polygons in (part of the way across, z), counter-clockwise.

    The disc is a circle of DISC_RADIUS around (0, DISC_CENTRE_Z) on the unrolled prism. Neighbouring facets
    share the points where the circle crosses their edge, so the cut leaves no crack.
    """
    facet_width = 2.0 * CYLINDER_RADIUS * np.sin(np.pi / FACETS)
    radius = DISC_RADIUS / facet_width  # in facets
    if k + 1 <= -radius or k >= radius:
        return {"body": [_rectangle(0.0, 1.0)]}
    on_circle = radius * np.cos(2.0 * np.pi * np.arange(DISC_CORNERS // 2 + 1) / DISC_CORNERS)
    inside = on_circle[(on_circle > k + 1e-6) & (on_circle < k + 1 - 1e-6)]
    steps = np.unique([max(k, -radius), min(k + 1, radius), *inside])
    half = facet_width * np.sqrt(np.maximum(radius**2 - steps**2, 0.0))
    upper = np.stack([steps - k, DISC_CENTRE_Z + half], axis=1)
    lower = np.stack([steps - k, DISC_CENTRE_Z - half], axis=1)
    corners = _rectangle(0.0, 1.0)
    if k < -radius:  # the disc's left end lies in this facet
        body = [np.concatenate([corners[:2], lower[::-1], upper[1:], corners[2:]])]
        return {"body": body, "marking": [np.concatenate([lower, upper[:0:-1]])]}
    if k + 1 > radius:  # its right end
        body = [np.concatenate([corners[:1], corners[1:], upper[:-1], lower[::-1]])]
        return {"body": body, "marking": [np.concatenate([lower, upper[-2::-1]])]}
    body = [np.concatenate([upper, corners[2:]]), np.concatenate([corners[:2], lower[::-1]])]
    return {"body": body, "marking": [np.concatenate([lower, upper[::-1]])]}


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


def _tetrahedron_corners() -> Points:
    return np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]], dtype=float)


def _cube_corners() -> Points:
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)


def _icosahedron_corners() -> Points:
    phi = (1.0 + np.sqrt(5.0)) / 2.0
    rectangle = np.array([[0, y, z * phi] for y in (-1, 1) for z in (-1, 1)])
    return np.concatenate([np.roll(rectangle, shift, axis=1) for shift in range(3)])


def _marking_table(tolerance_px: float, stabiliser: str) -> str:
    return (
        f"[marking]\ntolerance_px = {tolerance_px}\nany_part_fixes_rotation = true\n\n"
        f"[marking.stabiliser]\n{stabiliser}"
    )


MARKED_FACE = -np.ones(3) / np.sqrt(3.0)  # the face opposite the corner (1, 1, 1)

OBJECTS: dict[str, tuple[str, Callable[[], MeshBuilder], str, str | None]] = {
    "tet": ("regular tetrahedron", lambda: regular_solid(_tetrahedron_corners()), 'kind = "tetrahedral"', None),
    "cube": ("cube", lambda: regular_solid(_cube_corners()), 'kind = "octahedral"', None),
    "icosa": ("regular icosahedron", lambda: regular_solid(_icosahedron_corners()), 'kind = "icosahedral"', None),
    "cone": ("cone", cone, f'kind = "cyclic"\norder = {FACETS}\naxis = [0, 0, 1]', None),
    "cyl": ("cylinder", lambda: cylinder(disc=False), f'kind = "dihedral"\norder = {FACETS}', None),
    "tetX": (
        "regular tetrahedron with one face coloured",
        lambda: regular_solid(_tetrahedron_corners(), MARKED_FACE),
        'kind = "tetrahedral"',
        # A face seen edge-on draws a handful of pixels; 5 is the thesis's tolerance (section 5.1.2).
        _marking_table(tolerance_px=5, stabiliser='kind = "cyclic"\norder = 3\naxis = [1, 1, 1]'),
    ),
    "cylO": (
        "cylinder with a disc on its side, near one end",
        lambda: cylinder(disc=True),
        f'kind = "dihedral"\norder = {FACETS}',
        # Less than one of the 4 samples of a pixel: hidden means not a trace.
        _marking_table(tolerance_px=0.125, stabiliser='kind = "cyclic"\norder = 1'),
    ),
}  # fmt: skip


def files_of(name: str) -> dict[str, str]:
    """Return the files of one object's folder: name to text."""
    title, build, group, marking = OBJECTS[name]
    marking_table = f"\n{marking}\n" if marking else ""
    toml = (
        f'format_version = 1\nname = "{name}"\ntitle = "{title}"\n\n[body.group]\n{group}\n{marking_table}\n'
        '[provenance]\nbuilt_by = "symsol_annot_assets.build"\n'
        'after = "SYMSOL (Murphy et al., 2021) and T. Bertens, master\'s thesis, TU Eindhoven"\nlicence = "CC-BY-4.0"\n'
    )
    return {"object.toml": toml, "mesh.obj": build().text(title)}


def main() -> int:
    """Write the folders, or with --check compare them; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    parser.add_argument("--out", type=Path, default=Path(__file__).resolve().parent, help="the folder of the folders")
    arguments = parser.parse_args()
    stale = []
    for name in OBJECTS:
        for file, text in files_of(name).items():
            path = arguments.out / name / file
            if arguments.check:
                if not path.is_file() or path.read_bytes() != text.encode():
                    stale.append(str(path))
            else:
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_bytes(text.encode())
    for path_text in stale:
        print(f"{path_text} is not what symsol_annot_assets.build builds", file=sys.stderr)
    return 1 if stale else 0


if __name__ == "__main__":
    sys.exit(main())
