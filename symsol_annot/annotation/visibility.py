"""How much of a marking shows, from geometry alone: bounds on what the renderer would count.

On a convex body a triangle is drawn where it faces the camera: nothing but the body's own front can hide it. A
rasteriser moves each projected vertex by at most a known distance (its sub-pixel grid, float32), and draws a
lattice point where it is inside the moved triangle. So points that are deeper inside the outline of the marking's front
than that distance are certainly counted, and points that are farther outside are certainly not. docs/annotation.md
derives the bounds.
"""

import math
from collections.abc import Iterator

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.scanline import LatticePoints, Segments, count_inside, is_inside, points_near
from symsol_annot.objects.mesh import Mesh, face_planes
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import engine_named
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations

Counts = npt.NDArray[np.int64]
Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_PRODUCT = 1 << 18  # multiplications of one matrix product, beyond which OpenBLAS would start threads
_NEXT = [1, 2, 0]  # the corner after each of a triangle's three


class MarkingVisibility:
    """Bounds on the lattice points that show a convex body's marking.

    Args:
        mesh: of a convex body.
        camera: what it is seen through.
        settings: the lattice, and the engine that draws it.
    """

    def __init__(self, mesh: Mesh, camera: Camera, settings: RenderSettings) -> None:
        self._lattice, self._per_pixel = camera.lattice(settings.samples_per_axis), settings.points_per_pixel
        self._shift = vertex_shift(camera, settings)
        used, local = np.unique(mesh.triangles[mesh.is_marking], return_inverse=True)
        self._vertices, self._triangles = mesh.vertices[used], local.reshape(-1, 3)
        self._body_planes = face_planes(mesh)
        self._neighbours = _neighbours(self._triangles)
        corners = self._vertices[self._triangles.T]
        ends = corners[_NEXT]
        a, b, c = corners
        normals = np.cross(b - a, c - a)  # twice the area long
        self._planes = np.column_stack([normals, -(normals * a).sum(axis=1)])
        self._middles = corners.mean(axis=0).T
        lengths = np.linalg.norm(ends - corners, axis=-1)
        self._two_shortest = np.sort(lengths, axis=0)[:2].sum(axis=0)
        lines = np.concatenate([np.cross(ends, corners), corners - ends], axis=-1) / lengths[..., None]
        self._lines = lines.reshape(-1, 6)
        is_rim = self._neighbours == len(self._triangles)
        self._rim_length = lengths[is_rim].sum()
        self._rim_loops = _connected(self._triangles.T[is_rim], self._triangles.T[_NEXT][is_rim])
        self._middle = (self._vertices.min(axis=0) + self._vertices.max(axis=0)) / 2.0
        self._radius = np.linalg.norm(self._vertices - self._middle, axis=1).max()

    def areas(self, R_m2c: Rotations, tolerance_px: float) -> Floats:
        """Return an area (n,) in pixels under each rotation (n, 3, 3), or NaN where geometry does not decide.

        It is on the same side of the tolerance as the area that a renderer counts, and 0 where that is 0.
        """
        enough = math.ceil(tolerance_px * self._per_pixel)
        lower, upper = self.bounds(R_m2c, enough)
        is_decided = (lower >= enough) | (upper == 0) | ((lower > 0) & (upper < enough))
        return np.where(is_decided, lower / self._per_pixel, np.nan)

    def bounds(self, R_m2c: Rotations, enough: int) -> tuple[Counts, Counts]:
        """Return lower and upper bounds on the lattice points that show the marking under each of n rotations.

        Args:
            R_m2c: (n, 3, 3).
            enough: bounds that are both at least `enough` need not be close.

        Returns:
            (n,) and (n,); the renderer's count lies between them.
        """
        facing = self._facing(R_m2c)
        most, lower = facing.max(axis=0), self._by_area(R_m2c, facing)
        upper = np.where(most > 0, np.iinfo(np.int64).max, 0)
        (open_,) = np.nonzero((most > 0) & (lower < enough))
        for some in _in_products(open_, self._lines.size):
            lower[some] = np.maximum(lower[some], self._around_one_point(R_m2c[some], facing[:, some]))
        (open_,) = np.nonzero((lower < enough) | (most <= 0))
        turned, is_seen = self._turned(R_m2c[open_], facing[:, open_]), most[open_] > 0
        upper[open_] = np.bincount(turned.owner, minlength=len(open_))
        if len(seen := open_[is_seen]):
            lower[seen], upper[seen] = self._count(R_m2c[seen], facing[:, seen], turned.of_owners(is_seen))
        return lower, upper

    def _facing(self, R_m2c: Rotations) -> Floats:
        """Return twice a triangle's area times its plane's distance to the camera, positive in front: (T, n).

        The projected area is that times the focal length squared, over the product of the three corners' depths.
        """
        camera = -self._lattice.distance * R_m2c[:, 2]  # in model coordinates: R^T (0, 0, -distance)
        places = np.column_stack([camera, np.ones(len(camera))]).T
        parts = _in_products(np.arange(places.shape[1]), self._planes.size)
        return np.concatenate([self._planes @ places[:, part] for part in parts], axis=1)

    def _depths(self, R_m2c: Rotations) -> tuple[Floats, Floats]:
        """Return depths (n,) that no point of the marking is nearer than, and farther than."""
        depth = R_m2c[:, 2] @ self._middle + self._lattice.distance
        return depth - self._radius, depth + self._radius

    def _facing_slack(self, R_m2c: Rotations) -> Floats:
        """Return by how much moved vertices can change the facing of triangles: (T, n).

        Twice a projected area, of sides f and g, changes by at most 2 e (|f|_1 + |g|_1) + 8 e^2.
        """
        near, far = self._depths(R_m2c)
        scale = far**3 / self._lattice.focal_px**2
        by_length = 2.0 * self._shift * np.sqrt(2.0) * self._longest(near) * scale
        return self._two_shortest[:, None] * by_length + 8.0 * self._shift**2 * scale

    def _longest(self, near: Floats) -> Floats:
        """Return the most spacings that a model length of 1 can span anywhere in view, at a depth of `near` or more."""
        return self._lattice.focal_px / near * self._lattice.distance / np.sqrt(self._lattice.distance**2 - 1.0)

    def _by_area(self, R_m2c: Rotations, facing: Floats) -> Counts:
        """Return a lower bound (n,) where all of the marking faces the camera, and 0 elsewhere.

        The front's outline is then the marking's own rim. A lattice point is the middle of a unit cell. Where it is not
        counted for sure, it is outside the front or nearer than sqrt(2) e to the rim, so what of its cell is inside
        the front is nearer than r = sqrt(2) (1 / 2 + e). Points so near to k loops of length L cover 2 r L + k pi r^2
        at most.
        """
        near, far = self._depths(R_m2c)
        area = facing.sum(axis=0) * self._lattice.focal_px**2 / (2.0 * far**3)
        reach = np.sqrt(2.0) * (0.5 + self._shift)
        beside = 2.0 * reach * self._rim_length * self._longest(near) + self._rim_loops * np.pi * reach**2
        return np.where((facing > 0).all(axis=0), np.maximum(area - beside, 0.0), 0.0).astype(np.int64)

    def _around_one_point(self, R_m2c: Rotations, facing: Floats) -> Counts:
        """Return a lower bound (n,): the lattice points of a square in the front, around one amid it.

        A triangle of a side and that point has twice the area det(d, a - o, b - o) f^2 / (z_a z_b), from the Pluecker
        coordinates of ray and side. Over the side's length, that is how far its line is from the point. A square of
        half-side k reaches sqrt(2) k from its middle; from there to the outline there must be more than sqrt(2) e.
        """
        in_front, (near, far) = facing > 0, self._depths(R_m2c)
        heights = (self._lines @ self._rays_amid(R_m2c, facing)).reshape(*self._neighbours.shape, len(R_m2c))
        is_inside = ((heights > 0).all(axis=0) & in_front).any(axis=0)
        np.abs(heights, out=heights)
        heights[~self._is_outline(in_front)] = np.inf
        height = heights.min(axis=(0, 1)) * self._lattice.focal_px**2 / far**2 / self._longest(near)
        half_side = np.ceil(height / np.sqrt(2.0) - self._shift) - 1.0
        return np.where(is_inside & (half_side >= 0), (2.0 * half_side + 1.0) ** 2, 0.0).astype(np.int64)

    def _rays_amid(self, R_m2c: Rotations, facing: Floats) -> Floats:
        """Return Pluecker coordinates (6, n), in model coordinates, of rays through the points amid the front."""
        weights = np.maximum(facing, 0.0)
        middle = self._middles @ weights / weights.sum(axis=0)
        world = (R_m2c @ middle.T[:, :, None])[:, :, 0]
        x, y = self._slopes(np.floor(self._lattice.project(world)) + 0.5).T
        one, zero, distance = np.ones_like(x), np.zeros_like(x), self._lattice.distance
        rays = np.array([[x, y, one], [distance * y, -distance * x, zero]])  # direction d, moment o x d
        return (rays.transpose(2, 0, 1) @ R_m2c).reshape(-1, 6).T

    def _slopes(self, points: Floats) -> Floats:
        """Return x / z and y / z (..., 2) of the rays through points (..., 2) of the lattice."""
        centre = np.array([self._lattice.width, self._lattice.height]) / 2.0
        return (points - centre) / self._lattice.focal_px

    def _is_outline(self, in_front: Flags) -> Flags:
        """Tell which sides (3, T, n) of front triangles (T, n) have no front triangle beyond them."""
        is_other = np.concatenate([~in_front, np.ones_like(in_front[:1])])  # beyond the marking nothing is its front
        return in_front & is_other[self._neighbours]

    def _count(self, R_m2c: Rotations, facing: Floats, turned: LatticePoints) -> tuple[Counts, Counts]:
        """Return close bounds: the points inside the front's outline, less or plus what moved vertices can change.

        That is near the outline, or in a triangle seen from so little behind that it may be drawn.
        """
        n, points = len(R_m2c), self._project(R_m2c)
        outline = self._outline(points, facing > 0)
        count, near = count_inside(outline, n), points_near(outline, self._shift)
        is_less = is_inside(near, outline)
        less, more = near[is_less].owner, (near[~is_less] | turned[~is_inside(turned, outline)]).owner
        return count - np.bincount(less, minlength=n), count + np.bincount(more, minlength=n)

    def _turned(self, R_m2c: Rotations, facing: Floats) -> LatticePoints:
        """Return the points that triangles (T, n) may show that are seen from behind, but turn when vertices move."""
        slivers = (facing <= 0) & (facing >= -self._facing_slack(R_m2c))
        if not slivers.any():
            return LatticePoints.none()
        held = self._in_turned(R_m2c, slivers)
        return held[~self._is_within_silhouette(R_m2c[held.owner], held.uv, 2.0 * self._shift)]

    def _is_within_silhouette(self, R_m2c: Rotations, centres: Floats, margin: float) -> Flags:
        """Tell which points (k, 2) of the lattice are inside the body's silhouette by a margin along u and v.

        The silhouette is convex, so a square is in it where the rays through its four corners meet the body.
        """
        corners = self._slopes(centres[:, None] + margin * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]]))
        rays = np.concatenate([corners, np.ones_like(corners[..., :1])], axis=-1) @ R_m2c
        normals, offsets = self._body_planes
        gap = offsets + self._lattice.distance * R_m2c[:, None, 2] @ normals.T  # (k, 1, planes), camera to plane
        speed = rays @ normals.T
        with np.errstate(divide="ignore", invalid="ignore"):
            steps = gap / speed
        enter = np.where(speed < 0, steps, -np.inf).max(axis=2)
        leave = np.where(speed > 0, steps, np.inf).min(axis=2)
        return np.asarray((enter < leave).all(axis=1))

    def _outline(self, points: Floats, in_front: Flags) -> Segments:
        """Return the outlines of the front triangles (T, n), running upwards on the right of them."""
        side, triangle, image = np.nonzero(self._is_outline(in_front))
        start, end = self._triangles[triangle, side], self._triangles[triangle, (side + 1) % 3]
        return Segments(image, points[image, start], points[image, end])

    def _in_turned(self, R_m2c: Rotations, slivers: Flags) -> LatticePoints:
        """Return the points that slivers (T, n) may hold when moved vertices turn them round.

        A moved triangle a, b, c that is drawn has a point p on the left of all its sides, and moving changes
        (a - p) x (b - p) by at most e (|a - p|_1 + |b - p|_1) + 2 e^2.
        """
        triangle, image = np.nonzero(slivers)
        corners = self._vertices[self._triangles[triangle]] @ R_m2c[image].transpose(0, 2, 1)
        corners = self._lattice.project(corners).transpose(1, 0, 2)  # (3, s, 2)
        sides = corners[_NEXT] - corners
        lengths = np.hypot(sides[..., 0], sides[..., 1])
        sliver, longest = np.arange(len(image)), lengths.argmax(axis=0)
        height = np.abs(_cross(sides[0], sides[1])) / np.maximum(lengths.max(axis=0), np.finfo(float).tiny)
        start = corners[longest, sliver]
        held = points_near(Segments(sliver, start, start + sides[longest, sliver]), self._shift + height)
        a = corners[:, held.owner] - held.uv
        b = a[_NEXT]
        change = self._shift * (np.abs(a).sum(axis=-1) + np.abs(b).sum(axis=-1)) + 2.0 * self._shift**2
        held = held[(_cross(a, b) <= change).all(axis=0)]  # v runs downwards: left is negative
        return LatticePoints.joined((image[held.owner], held.row, held.column))

    def _project(self, R_m2c: Rotations) -> Floats:
        """Return all vertices on the lattice, whose points lie at half-integers: (n, V, 2)."""
        world = np.swapaxes(R_m2c, 0, 1) @ self._vertices.T  # (3, n, V): x, y and z each in one piece
        return self._lattice.project(np.moveaxis(world, 0, -1))


def vertex_shift(camera: Camera, settings: RenderSettings) -> float:
    """Return by how many lattice spacings, along u or v, a renderer can move a projected vertex."""
    lattice = camera.lattice(settings.samples_per_axis)
    engine = engine_named(settings.engine)
    return engine.vertex_shift + engine.float_shift * max(lattice.width, lattice.height)


def _cross(f: Floats, g: Floats) -> Floats:
    """Return the cross product of vectors (..., 2): twice the area of the triangle that they span."""
    return f[..., 0] * g[..., 1] - f[..., 1] * g[..., 0]


def _in_products(chosen: npt.NDArray[np.int64], size: int) -> Iterator[npt.NDArray[np.int64]]:
    """Give numbers (k,) in pieces whose columns a matrix of `size` entries is multiplied with in one thread."""
    step = max(_PRODUCT // size, 1)
    return (chosen[start : start + step] for start in range(0, len(chosen), step))


def _connected(start: npt.NDArray[np.int64], end: npt.NDArray[np.int64]) -> int:
    """Return in how many connected groups the sides (k,) from one vertex to another lie."""
    group = np.arange(max(start.max(), end.max()) + 1)
    while not np.array_equal(group[start], group[end]):
        first = np.minimum(group[start], group[end])
        np.minimum.at(group, start, first)
        np.minimum.at(group, end, first)
    return len(np.unique(group[start]))


def _neighbours(triangles: npt.NDArray[np.int64]) -> npt.NDArray[np.int64]:
    """Return which triangle lies beyond the three sides of each of T triangles: (3, T), and T where there is none."""
    sides = np.stack([triangles.T, triangles.T[_NEXT]], axis=-1).reshape(-1, 2).tolist()
    having = {(start, end): number % len(triangles) for number, (start, end) in enumerate(sides)}
    return np.array([having.get((end, start), len(triangles)) for start, end in sides]).reshape(3, -1)
