"""The mesh of sphereX: a ball with an X and, beside one end of it, a disc, cut out of its surface.

The X is where two slabs |y| <= X_HALF_WIDTH and |x| <= X_HALF_WIDTH, |x| and |y| <= X_REACH, meet the ball's upper
half, so that turns about z by quarters map it onto itself. Its ends curve inwards more than any horizon does: where
something of the X shows, a corner of one of its ends does. The disc is a regular polygon of FACETS corners about its
own axis.
"""

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull
from symsol_annot_assets.meshes import FACETS, MeshBuilder, Points

X_REACH = float(np.sin(np.radians(32.0)))  # from the middle of the X to its ends, along x and y
X_HALF_WIDTH = float(np.sin(np.radians(4.0)))  # of its bars
DISC_RADIUS_RAD = float(np.radians(6.0))
DISC_POLAR_RAD, DISC_AZIMUTH_RAD = float(np.radians(32.0)), float(np.radians(26.0))  # of the disc's middle

_BAR_STEPS, _ACROSS_STEPS, _DISC_RINGS = 16, 4, 3  # of an arm along and across it, and of the disc
_BODY_POINTS = 10_000
_CLEARANCE = 0.023  # radii between points of the body and the outlines of X and disc
_GOLDEN_TURN = np.pi * (1.0 + np.sqrt(5.0))

Triangles = npt.NDArray[np.intp]


def marked_ball() -> MeshBuilder:
    """Return sphereX: the X and the disc as grids of their own, and the body as the convex hull between them.

    Raises:
        RuntimeError: the hull does not keep an outline, so that the surface would not be closed.
    """
    x_shape, disc = _x_triangles(), _disc_triangles()
    vertices, body = _body_triangles(x_shape, disc)
    mesh = MeshBuilder()
    for material, triangles in (("body", vertices[body]), ("x", x_shape), ("disc", disc)):
        for corners in triangles:
            mesh.add(corners, corners, material)
    return mesh


def disc_axis() -> Points:
    """Return the unit vector (3,) to the disc's middle."""
    sine = np.sin(DISC_POLAR_RAD)
    return np.array([sine * np.cos(DISC_AZIMUTH_RAD), sine * np.sin(DISC_AZIMUTH_RAD), np.cos(DISC_POLAR_RAD)])


def is_in_x(points: Points) -> npt.NDArray[np.bool_]:
    """Tell which points (n, 3) of the ball lie in the X, rim included."""
    x, y, z = np.abs(points[:, 0]), np.abs(points[:, 1]), points[:, 2]
    long, wide = X_REACH + 1e-9, X_HALF_WIDTH + 1e-9
    return np.asarray((z > 0) & (((x <= long) & (y <= wide)) | ((y <= long) & (x <= wide))))


def _lifted(x: npt.NDArray[np.float64], y: npt.NDArray[np.float64]) -> Points:
    """Return the points (..., 3) of the upper half of the ball over x and y."""
    return np.stack([x, y, np.sqrt(1.0 - x**2 - y**2)], axis=-1)


def _x_triangles() -> Points:
    """Return the triangles (T, 3, 3) of the X: four arms, and between them the middle, a quarter four times."""
    along = np.linspace(X_HALF_WIDTH, X_REACH, _BAR_STEPS + 1)
    half = np.linspace(0.0, X_HALF_WIDTH, _ACROSS_STEPS // 2 + 1)
    arm = _grid_triangles(_lifted(*np.meshgrid(along, half, indexing="ij")))
    mirrored = arm[:, ::-1] * [1.0, -1.0, 1.0]
    quarter = np.concatenate([arm, mirrored, _grid_triangles(_lifted(*np.meshgrid(half, half, indexing="ij")))])
    turns = np.array([[[1, 0], [0, 1]], [[0, -1], [1, 0]], [[-1, 0], [0, -1]], [[0, 1], [-1, 0]]])
    flat = np.einsum("qij,tcj->qtci", turns, quarter[..., :2]).reshape(-1, 3, 2)
    height = np.tile(quarter[..., 2:], (4, 1, 1))
    return np.concatenate([flat, height], axis=-1)


def _grid_triangles(points: Points) -> Points:
    """Return the triangles (T, 3, 3) of a grid of points (m, n, 3), x along the first axis and y along the second.

    They are cut along the diagonal that stands out, where x and y are positive.
    """
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    pairs = np.stack([np.stack([a, b, d], axis=-2), np.stack([b, c, d], axis=-2)], axis=-3)
    return pairs.reshape(-1, 3, 3)


def _disc_triangles() -> Points:
    """Return the triangles (T, 3, 3) of the disc: a fan about its axis, and rings."""
    axis = disc_axis()
    aside = np.cross(axis, [0.0, 0.0, 1.0])
    aside /= np.linalg.norm(aside)
    turn = 2.0 * np.pi * np.arange(FACETS + 1) / FACETS
    ways = np.cos(turn)[:, None] * aside + np.sin(turn)[:, None] * np.cross(axis, aside)
    radii = DISC_RADIUS_RAD * np.arange(_DISC_RINGS + 1) / _DISC_RINGS
    points = np.cos(radii)[:, None, None] * axis + np.sin(radii)[:, None, None] * ways
    points[:, -1] = points[:, 0]
    fan = np.stack([np.broadcast_to(axis, (FACETS, 3)), points[1, :-1], points[1, 1:]], axis=1)
    return np.concatenate([fan, _grid_triangles(points[1:])])


def _body_triangles(x_shape: Points, disc: Points) -> tuple[Points, Triangles]:
    """Return vertices (V, 3) and the triangles (T, 3) of the hull that lie in neither X nor disc."""
    marks, body = np.concatenate([x_shape, disc]).reshape(-1, 3), _spread_points()
    marks = marks[np.unique(marks.round(9), axis=0, return_index=True)[1]]
    distance = np.sqrt(np.maximum(2.0 - 2.0 * body @ marks.T, 0.0)).min(axis=1)
    vertices = np.concatenate([marks, body[distance > _CLEARANCE]])
    triangles = ConvexHull(vertices).simplices
    corners = vertices[triangles]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    inwards = (normals * corners[:, 0]).sum(axis=1)
    triangles[inwards < 0] = triangles[inwards < 0][:, ::-1]
    middles = vertices[triangles].mean(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    is_in_disc = middles @ disc_axis() > np.cos(DISC_RADIUS_RAD * np.cos(np.pi / FACETS)) - 1e-9
    triangles = _in_order(triangles[~is_in_x(middles) & ~is_in_disc])
    _refuse_open(np.concatenate([vertices[triangles], x_shape, disc]))
    return vertices, triangles


def _spread_points() -> Points:
    """Return points (n, 3) spread evenly over the ball, along a spiral."""
    index = np.arange(_BODY_POINTS) + 0.5
    z, turn = 1.0 - 2.0 * index / _BODY_POINTS, _GOLDEN_TURN * index
    return np.column_stack([np.sqrt(1.0 - z * z) * np.cos(turn), np.sqrt(1.0 - z * z) * np.sin(turn), z])


def _in_order(triangles: Triangles) -> Triangles:
    """Return triangles in an order of their own, each from its smallest corner on."""
    first = triangles.argmin(axis=1)
    turned = np.stack([np.take_along_axis(triangles, (first + k)[:, None] % 3, axis=1)[:, 0] for k in range(3)], axis=1)
    return np.asarray(turned[np.lexsort(turned.T[::-1])])


def _refuse_open(corners: Points) -> None:
    _, number = np.unique(corners.reshape(-1, 3).round(9) + 0.0, axis=0, return_inverse=True)
    triangles = number.reshape(-1, 3)
    sides = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2)
    found = set(map(tuple, sides.tolist()))
    if len(found) < len(sides) or found != {(end, start) for start, end in found}:
        raise RuntimeError("the hull does not keep the outlines of X and disc; use more points or more clearance")
