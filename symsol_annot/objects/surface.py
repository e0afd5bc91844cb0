"""Points of a surface, and how far they lie from triangles."""

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import Rotations

Points = npt.NDArray[np.float64]

SURFACE_TOLERANCE = 1e-6  # bounding-sphere radii that a turned surface may lie off the surface
SURFACE_POINTS = 32  # that stand for a surface
_CHUNK = 2**18


def surface_points(triangles: Points, count: int = SURFACE_POINTS) -> Points:
    """Return (count, 3) points spread over triangles (T, 3, 3), always the same ones, corners among them."""
    rng = np.random.default_rng(0)
    areas = np.linalg.norm(np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]), axis=1)
    chosen = rng.choice(len(triangles), size=count, p=areas / areas.sum())
    weights = rng.dirichlet(np.ones(3), size=count)
    weights[: count // 4] = np.eye(3)[rng.integers(3, size=count // 4)]
    return np.einsum("pi,pij->pj", weights, triangles[chosen])


def surface_offsets(points: Points, triangles: Points, rotations: Rotations) -> npt.NDArray[np.float64]:
    """Return for each rotation how far off the triangles the farthest turned point lies: (len(rotations),)."""
    turned = (points @ np.swapaxes(rotations, -1, -2)).reshape(-1, 3)
    return distance_to_triangles(turned, triangles).reshape(len(rotations), len(points)).max(axis=1, initial=0.0)


def distance_to_triangles(points: Points, triangles: Points) -> npt.NDArray[np.float64]:
    """Return the distance (P,) of points (P, 3) to the nearest of triangles (T, 3, 3)."""
    step = max(1, _CHUNK // len(triangles))
    chunks = [_distances(points[start : start + step], triangles) for start in range(0, len(points), step)]
    return np.concatenate(chunks) if chunks else np.zeros(0)


def _distances(points: Points, triangles: Points) -> npt.NDArray[np.float64]:
    """Return (P,) distances to the nearest triangle: to its plane where the foot is inside, else to its edges."""
    edges = np.roll(triangles, -1, axis=1) - triangles  # (T, 3, 3)
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    from_corner = points[:, None, None] - triangles  # (P, T, 3, 3)
    along = np.einsum("ptci,tci->ptc", from_corner, edges) / np.square(edges).sum(axis=-1)
    to_edge = from_corner - np.clip(along, 0.0, 1.0)[..., None] * edges
    distance = np.sqrt(np.square(to_edge).sum(axis=-1)).min(axis=-1)
    sides = np.einsum("ptci,tci->ptc", from_corner, np.cross(normals[:, None], edges))
    height = np.abs(np.einsum("pti,ti->pt", from_corner[:, :, 0], normals))
    nearest: npt.NDArray[np.float64] = np.where((sides >= 0).all(axis=-1), height, distance).min(axis=1)
    return nearest
