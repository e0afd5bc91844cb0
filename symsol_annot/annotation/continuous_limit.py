"""What the continuous limit asks of a member, beside that it draws the image: the lattice is coarser than a rotation.

Where an image shows a breaking part, a candidate that draws it has the very surface of that part there. And where it
shows the rim of a part that is painted on, the candidate has the rim there: a disc of which the horizon leaves a sliver
still has its surface in place a degree away, and may draw the same few points, but not its rim.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, partial

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.mesh import Mesh
from symsol_annot.objects.surface import SURFACE_TOLERANCE
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import LitWindow
from symsol_annot.rotations.so3 import Rotations

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_POINTS = 24  # of a part's surface, and of its rim, that are compared
_EDGE = 1e-3  # in barycentric coordinates: a rasteriser draws points that lie a little beside a triangle
_BESIDE = 2  # spacings of the lattice between a rim and a point of its part
_IN_FRONT = 1e-6  # of the way from the camera, by which what hides a rim is nearer


@dataclass(frozen=True, eq=False)
class SeenPart:
    """What an image shows of a breaking part, in model coordinates.

    Attributes:
        part: its id.
        surface: (k, 3) points of its surface.
        rim: (m, 3) points of its rim; none of a part that is a closed surface of its own.
    """

    part: int
    surface: Floats
    rim: Floats


def what_is_seen(mesh: Mesh, R_m2c: Rotations, image: LitWindow, lattice: Camera) -> list[SeenPart]:
    """Return what the image at R_m2c (3, 3) shows of each breaking part of which it shows something.

    Args:
        mesh: of the object.
        R_m2c: the image's rotation.
        image: its points around the breaking parts.
        lattice: the camera, as it sees the points.
    """
    found = []
    for part in mesh.breaking:
        surface = _seen_surface(mesh, part, R_m2c, image, lattice)
        if len(surface):
            found.append(SeenPart(part, surface, _seen_rim(mesh, part, R_m2c, image, lattice)))
    return found


def have_the_same(mesh: Mesh, seen: list[SeenPart], group: Rotations) -> Flags:
    """Tell which g (n, 3, 3) leave in place what is seen of each part: its surface, and its rim. None where none is."""
    found = np.full(len(group), bool(seen))
    for of_part in seen:
        triangles = _surface_of(mesh, of_part.part)
        _keep(found, of_part.surface, triangles.corners, partial(triangles, limit=SURFACE_TOLERANCE), group)
        if len(of_part.rim):
            sides = _rim_of(mesh, of_part.part)[0]
            _keep(found, of_part.rim, sides, partial(_distance_to_sides, sides=sides), group)
    return found


@lru_cache(maxsize=32)
def _surface_of(mesh: Mesh, part: int) -> SurfaceDistance:
    """Return what measures distances to the surface of a part."""
    return SurfaceDistance(mesh.triangles_of(part))


def _keep(found: Flags, points: Floats, pieces: Floats, distance: Callable[[Floats], Floats], group: Rotations) -> None:
    """Keep of those found the g whose inverses carry all points (k, 3) onto triangles or sides (T, 3 or 2, 3).

    Args:
        found: (n,) those that are left, which this changes.
        points: what has to be there.
        pieces: the triangles or the sides.
        distance: measures how far points (m, 3) are from them.
        group: (n, 3, 3).
    """
    low, high = pieces.min(axis=(0, 1)) - SURFACE_TOLERANCE, pieces.max(axis=(0, 1)) + SURFACE_TOLERANCE
    for point in points:
        turned = point @ group[found]  # g^-1 point
        lies_on = ((turned >= low) & (turned <= high)).all(axis=1)
        lies_on[lies_on] = distance(turned[lies_on]) <= SURFACE_TOLERANCE
        found[found] = lies_on


def _distance_to_sides(points: Floats, sides: Floats) -> Floats:
    """Return the distance (P,) of points (P, 3) to the nearest of sides (S, 2, 3)."""
    along = sides[:, 1] - sides[:, 0]
    from_start = points[:, None] - sides[:, 0]
    part = np.clip((from_start * along).sum(axis=-1) / (along**2).sum(axis=-1), 0.0, 1.0)
    return np.asarray(np.linalg.norm(from_start - part[..., None] * along, axis=-1).min(axis=1, initial=np.inf))


def _rim_of(mesh: Mesh, part: int) -> tuple[Floats, npt.NDArray[np.intp]]:
    """Return the sides (S, 2, 3) of a part's triangles that no other of them has, and the triangle (S,) of each."""
    (of_part,) = np.nonzero(mesh.part_ids == part)
    corners = mesh.triangles[of_part]
    start, end = corners.reshape(-1), np.roll(corners, -1, axis=1).reshape(-1)
    count = len(mesh.vertices)
    (rim,) = np.nonzero(~np.isin(start * count + end, end * count + start))
    return np.stack([mesh.vertices[start[rim]], mesh.vertices[end[rim]]], axis=1), of_part[rim // 3]


def _seen_rim(mesh: Mesh, part: int, R_m2c: Rotations, image: LitWindow, lattice: Camera) -> Floats:
    """Return points (m, 3) of a part's rim that nothing hides, beside points that show the part."""
    sides, triangle = _rim_of(mesh, part)
    points, camera = sides.mean(axis=1), -lattice.distance * R_m2c[2]
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles[triangle]], 1, 0)
    faces = (np.cross(b - a, c - a) * (camera - a)).sum(axis=1) > 0
    points = points[faces]
    window, shows = image.window, np.pad(image.ids == part, _BESIDE)
    u, v = (np.floor(lattice.project(points @ R_m2c.T)).astype(int) - [window.left, window.top]).T
    is_in = (u >= 0) & (u < window.width) & (v >= 0) & (v < window.height)
    points, reach = points[is_in], range(2 * _BESIDE + 1)
    points = points[np.any([shows[v[is_in] + down, u[is_in] + right] for down in reach for right in reach], axis=0)]
    points = points[_spread(len(points))]
    return points[_nearest_along(mesh.vertices[mesh.triangles], camera, points - camera) > 1.0 - _IN_FRONT]


def _seen_surface(mesh: Mesh, part: int, R_m2c: Rotations, image: LitWindow, lattice: Camera) -> Floats:
    """Return points (k, 3) of a part, in model coordinates, that an image shows, spread over what it shows of it."""
    rows, columns = np.nonzero(image.ids == part)
    chosen = _spread(len(rows))
    uv = np.stack([columns[chosen] + image.window.left, rows[chosen] + image.window.top], axis=1) + 0.5
    centre = np.array([lattice.width / 2, lattice.height / 2])
    rays = np.column_stack([(uv - centre) / lattice.focal_px, np.ones(len(uv))]) @ R_m2c  # in model coordinates
    camera = -lattice.distance * R_m2c[2]
    depth = _nearest_along(mesh.triangles_of(part), camera, rays, _EDGE)
    is_hit = np.isfinite(depth)
    return np.asarray(camera + depth[is_hit, None] * rays[is_hit])


def _nearest_along(triangles: Floats, start: Floats, rays: Floats, slack: float = 0.0) -> Floats:
    """Return how many lengths of each ray (k, 3) from a point the first triangle (T, 3, 3) lies that faces the point.

    Args:
        triangles: of a surface.
        start: (3,) where the rays begin.
        rays: (k, 3) their ways.
        slack: how far beside a triangle a ray may meet its plane, in barycentric coordinates.

    Returns:
        (k,), infinite where a ray meets none.
    """
    a, b, c = np.moveaxis(triangles, 1, 0)
    normals = np.cross(b - a, c - a)
    speed = rays @ normals.T
    with np.errstate(divide="ignore", invalid="ignore"):
        depth = ((a - start) * normals).sum(axis=1) / speed  # (k, T)
        points = start + depth[..., None] * rays[:, None]
        squared = (normals**2).sum(axis=1)
        weights = [
            (np.cross(end - begin, points - begin) * normals).sum(axis=-1) / squared
            for begin, end in ((a, b), (b, c), (c, a))
        ]
        hits = (np.minimum.reduce(weights) >= -slack) & (speed < 0)
    return np.asarray(np.where(hits, depth, np.inf).min(axis=1, initial=np.inf))


def _spread(count: int) -> npt.NDArray[np.intp]:
    """Return numbers of up to `_POINTS` of a count, from the first to the last."""
    return np.unique(np.linspace(0, count - 1, _POINTS).astype(np.intp)) if count else np.zeros(0, np.intp)
