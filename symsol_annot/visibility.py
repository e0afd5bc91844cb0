"""How much of a marking shows, from geometry alone: bounds on what the renderer would count.

On a convex body a triangle is drawn where it faces the camera: nothing but the body's own front can hide it. A
rasteriser moves each projected vertex by at most a known distance (its sub-pixel grid, float32), and draws a sample
where its centre is inside the moved triangle. So samples that are deeper inside the outline of the marking's front than
that distance are certainly counted, and samples that are farther outside are certainly not. docs/annotation.md derives
the bounds.
"""

import math

import numpy as np
import numpy.typing as npt

from symsol_annot.lattice import Segments, count_inside, is_inside, samples_near
from symsol_annot.mesh import Mesh
from symsol_annot.scene import Camera, RenderSettings
from symsol_annot.so3 import Rotations

Counts = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

# By how much a rasteriser moves a projected vertex: rounding to its sub-pixel grid or, for Cycles, casting rays beside
# the centres, in samples; and float32 arithmetic, as a share of the lattice's width.
_ROUNDING = {"workbench": 1.0 / 512.0, "eevee": 1.0 / 512.0, "cycles": 1.0 / 64.0}
_FLOAT32 = 1e-6
_CONVEX = 2e-7  # radii that a vertex may lie outside a plane: what float32 makes of coordinates


def is_convex(mesh: Mesh) -> bool:
    """Tell whether a closed mesh bounds a convex body: no vertex lies outside the plane of any face."""
    normals, offsets = _planes(mesh)
    return bool((normals @ mesh.vertices.T <= offsets[:, None] + _CONVEX).all())


class MarkingVisibility:
    """Bounds on the samples of a convex body's marking.

    Args:
        mesh: of a convex body.
        camera: what it is seen through.
        settings: the lattice of samples.
    """

    def __init__(self, mesh: Mesh, camera: Camera, settings: RenderSettings) -> None:
        self._camera, self._scale = camera, settings.samples_per_axis
        self._focal = self._scale * camera.focal_px
        self._shift = vertex_shift(camera, settings)
        used, local = np.unique(mesh.triangles[mesh.is_marking], return_inverse=True)
        self._vertices, self._triangles = mesh.vertices[used], local.reshape(-1, 3)
        self._body_planes = _planes(mesh)
        self._edges, self._sides = _edges_and_sides(self._triangles)
        a, b, c = np.moveaxis(self._vertices[self._triangles], 1, 0)
        normals = np.cross(b - a, c - a)  # twice the area long
        self._planes = normals, (normals * a).sum(axis=1)
        self._two_shortest = np.sort(np.linalg.norm([b - a, c - b, a - c], axis=-1), axis=0)[:2].sum(axis=0)
        self._edge_lengths = np.linalg.norm(np.diff(self._vertices[self._edges], axis=1)[:, 0], axis=-1)
        self._middle = (self._vertices.min(axis=0) + self._vertices.max(axis=0)) / 2.0
        self._radius = np.linalg.norm(self._vertices - self._middle, axis=1).max()

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
        depth = R_m2c[:, 2] @ self._middle + self._camera.distance
        near, far = (depth - self._radius)[:, None], (depth + self._radius)[:, None]
        slack = self._facing_slack(near, far)
        lower = self._surely(facing, near, far)
        upper = np.where((facing > -slack).any(axis=1), np.iinfo(np.int64).max, 0)
        (open_,) = np.nonzero((upper > 0) & (lower < enough))
        if len(open_):
            lower[open_], upper[open_] = self._count(R_m2c[open_], facing[open_], slack[open_])
        return lower, upper

    def _facing(self, R_m2c: Rotations) -> Floats:
        """Return twice a triangle's area times its plane's distance to the camera, positive in front: (n, T).

        The projected area is that times the focal length squared, over the product of the three corners' depths.
        """
        normals, offsets = self._planes
        camera = -self._camera.distance * R_m2c[:, 2]  # in model coordinates: R^T (0, 0, -distance)
        return camera @ normals.T - offsets

    def _facing_slack(self, near: Floats, far: Floats) -> Floats:
        """Return by how much moved vertices can change each triangle's facing: (n, T)."""
        lengths = np.sqrt(2.0) * self._longest(near) * self._two_shortest
        return _area_slack(lengths, self._shift) * far**3 / self._focal**2

    def _longest(self, near: Floats) -> Floats:
        """Return the most samples that a model length of 1 can span at a depth of at least `near`, anywhere in view."""
        return self._focal / near * self._camera.distance / np.sqrt(self._camera.distance**2 - 1.0)

    def _surely(self, facing: Floats, near: Floats, far: Floats) -> Counts:
        """Return a lower bound (n,) from the area and the outline of what faces the camera, without projecting it.

        A region with an outline of length P in B edges holds more than A - P - B / 3 samples (Steinhaus, 1947, for each
        of its loops), of which at most 1.1 P + B are near the outline.
        """
        in_front = facing > 0
        is_outline = self._is_outline(in_front)
        area = np.where(in_front, facing, 0.0).sum(axis=1) * self._focal**2 / (2.0 * far[:, 0] ** 3)
        outline = is_outline @ self._edge_lengths * self._longest(near)[:, 0]
        surely = area - 2.1 * outline - 4.0 / 3.0 * is_outline.sum(axis=1)
        return np.maximum(np.floor(surely), 0.0).astype(np.int64)

    def _is_outline(self, in_front: Flags) -> Flags:
        """Tell which edges (n, E) have a front triangle (n, T) on one side only."""
        in_front = np.pad(in_front, [(0, 0), (0, 1)])  # beyond the marking nothing is its front
        return in_front[:, self._sides[:, 0]] ^ in_front[:, self._sides[:, 1]]

    def _count(self, R_m2c: Rotations, facing: Floats, slack: Floats) -> tuple[Counts, Counts]:
        """Return close bounds: the samples inside the front's outline, less or plus what moved vertices can change.

        That is near the outline, or near a triangle seen so close to edge-on that it may be drawn the wrong way round.
        Such a triangle lies behind the front but where that ends, at the silhouette.
        """
        n, points = len(R_m2c), self._project(R_m2c)
        outline = self._outline(points, facing > 0)
        count, near = count_inside(outline, n), samples_near(outline, self._shift)
        is_less = is_inside(near, outline)
        turned = samples_near(*self._slivers(points, np.abs(facing) <= slack))
        turned = turned[~is_inside(turned, outline)]
        is_behind = self._is_within_silhouette(R_m2c[turned.owner], turned.centres, 2.0 * self._shift)
        less, more = near[is_less].owner, (near[~is_less] | turned[~is_behind]).owner
        return count - np.bincount(less, minlength=n), count + np.bincount(more, minlength=n)

    def _is_within_silhouette(self, R_m2c: Rotations, centres: Floats, margin: float) -> Flags:
        """Tell which points (k, 2) of the lattice are inside the body's silhouette by a margin along u and v.

        The silhouette is convex, so a square is in it where the rays through its four corners meet the body.
        """
        corners = centres[:, None] + margin * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
        middle = self._scale * np.array([self._camera.width, self._camera.height]) / 2.0
        rays = np.pad((corners - middle) / self._focal, [(0, 0), (0, 0), (0, 1)], constant_values=1.0) @ R_m2c
        normals, offsets = self._body_planes
        gap = offsets + self._camera.distance * R_m2c[:, None, 2] @ normals.T  # (k, 1, planes), camera to plane
        speed = rays @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = gap / speed
        enter = np.where(speed < 0, steps, -np.inf).max(axis=2)
        leave = np.where(speed > 0, steps, np.inf).min(axis=2)
        return np.asarray((enter < leave).all(axis=1))

    def _outline(self, points: Floats, in_front: Flags) -> Segments:
        """Return the outlines of the front triangles (n, T), running upwards on the right of them."""
        image, edge = np.nonzero(self._is_outline(in_front))
        forward = in_front[image, np.minimum(self._sides[edge, 0], in_front.shape[1] - 1)]
        forward &= self._sides[edge, 0] < in_front.shape[1]
        start, end = np.where(forward, self._edges[edge].T, self._edges[edge, ::-1].T)
        return Segments(image, points[image, start], points[image, end])

    def _slivers(self, points: Floats, perhaps: Flags) -> tuple[Segments, Floats]:
        """Return the longest sides of the triangles that may be drawn the wrong way round, and how far they reach."""
        image, triangle = np.nonzero(perhaps)
        corners = points[image[:, None], self._triangles[triangle]]
        sides = np.roll(corners, -1, axis=1) - corners
        lengths = np.linalg.norm(sides, axis=-1)
        area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        is_sliver = area <= _area_slack(np.sort(np.abs(sides).sum(axis=-1), axis=1)[:, :2].sum(axis=1), self._shift)
        image, corners, lengths, area = image[is_sliver], corners[is_sliver], lengths[is_sliver], area[is_sliver]
        rows, longest = np.arange(len(image)), lengths.argmax(axis=1)
        height = area / np.maximum(lengths[rows, longest], np.finfo(float).tiny)
        ends = corners[rows, longest], corners[rows, (longest + 1) % 3]
        return Segments(image, *ends), self._shift + height

    def _project(self, R_m2c: Rotations) -> Floats:
        """Return all vertices on the lattice of samples, a sample's centre at half-integers: (n, V, 2)."""
        return self._scale * self._camera.project(self._vertices @ np.swapaxes(R_m2c, -1, -2))


def vertex_shift(camera: Camera, settings: RenderSettings) -> float:
    """Return by how many samples, along u or v, a renderer can move a projected vertex."""
    return _ROUNDING[settings.engine] + _FLOAT32 * settings.samples_per_axis * max(camera.width, camera.height)


def _area_slack(lengths: Floats, shift: float) -> Floats:
    """Return how much moved vertices change twice a triangle's area, from |f|_1 + |g|_1 of two of its sides."""
    return 2.0 * shift * lengths + 8.0 * shift**2


def _planes(mesh: Mesh) -> tuple[Floats, Floats]:
    """Return the planes of a mesh's faces, each about once: outward normals (p, 3) and offsets (p,) from the origin."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles], 1, 0)
    normals = np.cross(b - a, c - a)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    offsets = (normals * a).sum(axis=1)
    _, first = np.unique(np.column_stack([normals, offsets]).round(6), axis=0, return_index=True)
    return normals[first], offsets[first]


def _edges_and_sides(triangles: npt.NDArray[np.int64]) -> tuple[npt.NDArray[np.int64], npt.NDArray[np.int64]]:
    """Return the edges (E, 2) and the triangles on their two sides (E, 2): the one that has it forward, and the other.

    Where there is none, the number is that of the triangles.
    """
    directed = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)])
    edges, number = np.unique(np.sort(directed, axis=1), axis=0, return_inverse=True)
    sides = np.full((len(edges), 2), len(triangles))
    is_backward = (directed[:, 0] > directed[:, 1]).astype(int)
    sides[number.reshape(-1), is_backward] = np.tile(np.arange(len(triangles)), 3)
    return edges, sides
