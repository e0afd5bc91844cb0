"""Does an object's geometry have the symmetries that its object.toml declares?

Points of the surface are turned by elements of the group and must land on the surface again. The marking must
land on itself under its stabiliser, and under no other element.
"""

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rotations.so3 import Rotations

SURFACE_TOLERANCE = 1e-6
_POINTS = 32
_ELEMENTS = 12
_FEW_POINTS = 8  # most elements move one of a few points off the marking
_CHUNK = 2**18
_MAX_DISTANCES = 2**28  # of turned points to triangles of the marking: about 20 s

Points = npt.NDArray[np.float64]


def check_object(spec: ObjectSpec) -> None:
    """Check an object's surface against a sample of its group, and its marking against all of it.

    Raises:
        ObjectError: the surface or the marking lacks a declared symmetry, or the marking has another one.
    """
    triangles = spec.mesh.vertices[spec.mesh.triangles]
    group = spec.symmetry_group
    sampled = group[np.unique(np.linspace(0, len(group) - 1, _ELEMENTS).astype(int))]
    off = surface_offsets(surface_points(triangles), triangles, np.concatenate([group[1:2], sampled]))
    if not off.max() <= SURFACE_TOLERANCE:
        raise ObjectError(
            f"{spec.folder}: the surface of {spec.name!r} is not invariant under body.group: an element of it moves "
            f"points {off.max():.3g} off the surface (allowed {SURFACE_TOLERANCE:g}). A round body needs a multiple "
            "of the group's order of facets, about the z axis"
        )
    if spec.marking is not None:
        _check_marking(spec, triangles[spec.mesh.is_marking])


def _check_marking(spec: ObjectSpec, marking: Points) -> None:
    distances = len(marking) * (_POINTS * len(spec.stabiliser) + _FEW_POINTS * len(spec.symmetry_group))
    if distances > _MAX_DISTANCES:
        raise ObjectError(
            f"{spec.folder}: the marking of {spec.name!r} has {len(marking):,} triangles, too many to hold against "
            f"{len(spec.symmetry_group):,} rotations; simplify it to {len(marking) * _MAX_DISTANCES // distances:,}"
        )
    points = surface_points(marking)
    kept = surface_offsets(points, marking, spec.stabiliser)
    if not kept.max() <= SURFACE_TOLERANCE:
        raise ObjectError(
            f"{spec.folder}: marking.stabiliser moves the marking of {spec.name!r} {kept.max():.3g} off itself "
            f"(allowed {SURFACE_TOLERANCE:g})"
        )
    others = spec.symmetry_group[spec.cosets[1:, 0]]
    suspects = others[surface_offsets(points[-_FEW_POINTS:], marking, others) <= SURFACE_TOLERANCE]
    corners = np.unique(marking.reshape(-1, 3), axis=0)
    extra = surface_offsets(np.concatenate([points, corners]), marking, suspects) <= SURFACE_TOLERANCE
    if extra.any():
        raise ObjectError(
            f"{spec.folder}: {np.count_nonzero(extra) + 1} cosets of marking.stabiliser in body.group map the marking "
            f"of {spec.name!r} onto itself, expected 1: the stabiliser is larger than declared"
        )


def surface_points(triangles: Points, count: int = _POINTS) -> Points:
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
