"""How much of a marking shows, from geometry alone: bounds on what the renderer would count.

On a convex body a triangle is drawn where it faces the camera: nothing but the body's own front can hide it. A
rasteriser moves each projected vertex by at most a known distance (its sub-pixel grid, float32), and draws a sample
where its centre is inside the moved triangle. So samples that are deeper inside a triangle than that distance are
certainly counted, and samples that are farther outside are certainly not. docs/annotation.md derives the bounds.
"""

import math

import numpy as np
import numpy.typing as npt

from symsol_annot.mesh import Mesh
from symsol_annot.scene import Camera, RenderSettings
from symsol_annot.so3 import Rotations

Counts = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# By how many samples a projected vertex can be off: half a step of a rasteriser's 1/256 sub-pixel grid and as much
# again for float32; Cycles casts rays up to 0.005 samples beside the centres.
VERTEX_SHIFT = {"workbench": 1.0 / 256.0, "eevee": 1.0 / 256.0, "cycles": 1.0 / 64.0}
_QUICK_TRIANGLES = 6
_CONVEX = 2e-7  # radii that a vertex may lie outside a plane: what float32 makes of coordinates


def is_convex(mesh: Mesh) -> bool:
    """Tell whether a closed mesh bounds a convex body: no vertex lies outside the plane of any face."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return bool((normals @ mesh.vertices.T <= (normals * a).sum(axis=1)[:, None] + _CONVEX).all())


class MarkingVisibility:
    """Bounds on the samples of a convex body's marking.

    Args:
        mesh: of a convex body.
        camera: what it is seen through.
        settings: the lattice of samples.
    """

    def __init__(self, mesh: Mesh, camera: Camera, settings: RenderSettings) -> None:
        self._camera, self._scale = camera, settings.samples_per_axis
        self._shift = VERTEX_SHIFT[settings.engine]
        triangles = mesh.triangles[mesh.is_marking]
        used, local = np.unique(triangles, return_inverse=True)
        self._vertices, self._triangles = mesh.vertices[used], local.reshape(-1, 3)
        corners = self._vertices[self._triangles]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # twice the area long
        self._planes = normals, (normals * corners[:, 0]).sum(axis=1)
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
        nearest, farthest = camera.distance - 1.0, camera.distance + 1.0
        focal = self._scale * camera.focal_px
        longest = 2.0 * np.sqrt(2.0) * focal / nearest * np.sort(edges, axis=1)[:, 1:].sum(axis=1)  # in any view
        slack = 2.0 * self._shift * longest + 8.0 * self._shift**2
        self._surely_back = -slack * farthest**3 / focal**2

    def areas(self, R_m2c: Rotations, tolerance_px: float) -> Floats:
        """Return an area (n,) in pixels under each rotation (n, 3, 3), or NaN where geometry does not decide.

        It is on the same side of the tolerance as the area that a renderer counts, and 0 where that is 0.
        """
        per_pixel = self._scale**2
        enough = math.ceil(tolerance_px * per_pixel)
        lower, upper = self.bounds(R_m2c, enough)
        is_decided = (lower >= enough) | (upper == 0) | ((lower > 0) & (upper < enough))
        return np.where(is_decided, lower / per_pixel, np.nan)

    def bounds(self, R_m2c: Rotations, enough: int) -> tuple[Counts, Counts]:
        """Return lower and upper bounds on the marking's samples under each of n rotations.

        Args:
            R_m2c: (n, 3, 3).
            enough: bounds that are both at least `enough` need not be close.

        Returns:
            (n,) and (n,); the renderer's count lies between them.
        """
        facing = self._facing(R_m2c)
        lower, upper = np.zeros((2, len(R_m2c)), dtype=np.int64)
        (seen,) = np.nonzero((facing > self._surely_back).any(axis=1))
        upper[seen] = np.iinfo(np.int64).max
        lower[seen] = self._count_quickly(R_m2c[seen], facing[seen])
        (open_,) = np.nonzero((upper > 0) & (lower < enough))
        if len(open_):
            lower[open_], upper[open_] = self._count(R_m2c[open_], facing[open_] > self._surely_back)
        return lower, upper

    def _facing(self, R_m2c: Rotations) -> Floats:
        """Return twice a triangle's area times its plane's distance to the camera, positive in front: (n, T).

        The projected area is that times the focal length squared, over the product of the three corners' depths.
        """
        normals, offsets = self._planes
        camera = -self._camera.distance * R_m2c[:, 2]  # in model coordinates: R^T (0, 0, -distance)
        return camera @ normals.T - offsets

    def _count_quickly(self, R_m2c: Rotations, facing: Floats) -> Counts:
        """Return a lower bound from the few triangles that face the camera most."""
        few = min(_QUICK_TRIANGLES, facing.shape[1])
        best = np.argpartition(-facing, few - 1, axis=1)[:, :few]
        corners = self._project(R_m2c[:, None], self._vertices[self._triangles[best]])
        return _surely_inside(corners, self._shift)

    def _count(self, R_m2c: Rotations, perhaps: Flags) -> tuple[Counts, Counts]:
        """Return close bounds, by going through the rows of the triangles that may be drawn (n, T)."""
        image, triangle = np.nonzero(perhaps)
        corners = self._project(R_m2c[image], self._vertices[self._triangles[triangle]])
        low, high = _count_rows(corners, self._shift)
        n = len(R_m2c)
        return np.bincount(image, low, n).astype(np.int64), np.bincount(image, high, n).astype(np.int64)

    def _project(self, R_m2c: Rotations, corners: Floats) -> Floats:
        """Return corners (..., 3, 3) on the lattice of samples, a sample's centre at half-integers: (..., 3, 2)."""
        return self._scale * self._camera.project(corners @ np.swapaxes(R_m2c, -1, -2))


def _signed_area(corners: Floats, vertex_shift: float) -> tuple[Floats, Floats]:
    """Return twice the area, positive where a triangle faces the camera, and how much moved vertices can change it."""
    a, b, c = corners[..., 0, :], corners[..., 1, :], corners[..., 2, :]
    first, second = b - a, c - a
    area = first[..., 1] * second[..., 0] - first[..., 0] * second[..., 1]  # rows run downwards
    lengths = np.abs(first[..., 0]) + np.abs(first[..., 1]) + np.abs(second[..., 0]) + np.abs(second[..., 1])
    return area, 2.0 * vertex_shift * lengths + 8.0 * vertex_shift**2


def _edges(corners: Floats, vertex_shift: float) -> list[tuple[Floats, Floats, Floats, Floats]]:
    """Return the three edges as (x, y, offset, shift): x u + y v >= offset inside a triangle that faces the camera.

    Moved vertices move an edge's offset by at most the shift.
    """
    edges = []
    for k in range(3):
        here, there = corners[..., k, :], corners[..., (k + 1) % 3, :]
        x, y = there[..., 1] - here[..., 1], here[..., 0] - there[..., 0]
        edges.append((x, y, x * here[..., 0] + y * here[..., 1], vertex_shift * (np.abs(x) + np.abs(y))))
    return edges


def _surely_inside(corners: Floats, vertex_shift: float) -> Counts:
    """Return a cheap lower bound for the samples in triangles (n, k, 3, 2): (n,).

    A triangle surely holds the sample nearest to its middle where that is deep enough inside. And a convex region of
    area A and perimeter P holds more than A - P / 2 points of a unit lattice (Nosarzewska, 1948).
    """
    area, slack = _signed_area(corners, vertex_shift)
    u, v = np.moveaxis(np.floor(corners.mean(axis=-2)) + 0.5, -1, 0)
    is_inside, perimeter = area > slack, np.zeros(area.shape)
    for x, y, offset, shift in _edges(corners, vertex_shift):
        is_inside &= x * u + y * v - offset > shift
        perimeter += np.hypot(x, y)
    at_least = np.floor(area / 2.0 - (np.sqrt(2.0) * vertex_shift + 0.5) * perimeter) + 1.0
    return np.where(area > slack, np.maximum(is_inside, at_least), 0.0).sum(axis=-1).astype(np.int64)


def _count_rows(corners: Floats, vertex_shift: float) -> tuple[Counts, Counts]:
    """Return the samples that are surely, and those that are possibly, in each of k triangles (k, 3, 2).

    A triangle that may face away surely holds none, and one that surely does possibly none.
    """
    area, slack = _signed_area(corners, vertex_shift)
    low, high = corners.min(axis=1) - vertex_shift, corners.max(axis=1) + vertex_shift
    first, last = np.ceil(low - 0.5), np.floor(high - 0.5)  # columns and rows that hold sample centres
    (spanning,) = np.nonzero((area > -slack) & (last >= first).all(axis=1))
    rows = (last - first)[spanning, 1].astype(np.int64) + 1
    triangle = np.repeat(spanning, rows)
    v = first[triangle, 1] + 0.5 + np.arange(len(triangle)) - np.repeat(np.cumsum(rows) - rows, rows)
    edges = _edges(corners[triangle], vertex_shift)
    left, right, count = low[triangle, 0], high[triangle, 0], len(corners)
    surely = np.where((area > slack)[triangle], _samples_between(edges, v, left, right, inwards=True), 0)
    possibly = _samples_between(edges, v, left, right, inwards=False)
    return np.bincount(triangle, surely, count), np.bincount(triangle, possibly, count)


def _samples_between(
    edges: list[tuple[Floats, Floats, Floats, Floats]], v: Floats, left: Floats, right: Floats, *, inwards: bool
) -> Floats:
    """Return how many sample centres of a row v (k,), from left to right, are inside all edges moved by their shift."""
    is_off = np.zeros(v.shape, dtype=bool)
    for x, y, offset, shift in edges:
        rest = (offset + shift if inwards else offset - shift) - y * v
        with np.errstate(divide="ignore", invalid="ignore"):
            crossing = rest / x
        left = np.where(x > 0, np.maximum(left, crossing), left)
        right = np.where(x < 0, np.minimum(right, crossing), right)
        is_off |= (x == 0) & (rest > 0)
    count = np.floor(right - 0.5) - np.ceil(left - 0.5) + 1.0
    return np.where(is_off, 0.0, np.maximum(count, 0.0))
