"""Candidates for the symmetries of a surface, from the corners of its convex hull.

A symmetry maps the surface onto itself, so also its convex hull, the hull's centroid and the hull's corners. Two
corners that are not in one line with the centroid fix it: it carries them onto a pair as far from the centroid and from
each other. All such pairs give all candidates.
"""

from dataclasses import dataclass
from itertools import permutations

import numpy as np
import numpy.typing as npt
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, QhullError, cKDTree

from symsol_annot.errors import ObjectError
from symsol_annot.rotations.so3 import Rotations

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]

MOST_CANDIDATES = 60_000
_STANDS_OUT = (20.0, 2.0, 0.05, 1e-5)  # tolerances: a corner stands out of the hull of the others by so much
_TRIANGULATION = 8.0  # how much less an image of a corner may seem to stand out, as its faces are cut otherwise
_NEAR_AXIS = 0.1  # sine of the angle of two corners that are as good as collinear with the centroid
_CLASS = 2_000  # more corners at one distance from the centroid are told apart by their neighbours
_NEIGHBOURS = 6
_PROBES = 48
_MATCH = 20.0  # tolerances: how far a corner may be carried from the nearest corner; candidates differ by more
_SAME = 1e-3  # Frobenius distance of candidates that are one
_AT_ONCE = 2**21


@dataclass(frozen=True, eq=False)
class HullCorners:
    """The corners of a convex hull.

    Attributes:
        points: (E, 3), less the centroid.
        stands_out: (E,) a lower bound of the distance of each from the hull of all others.
        centroid: (3,) of the hull's volume.
    """

    points: Points
    stands_out: npt.NDArray[np.float64]
    centroid: Points


def hull_corners(vertices: Points) -> HullCorners:
    """Return the corners of the hull of vertices (V, 3).

    Raises:
        ObjectError: they lie in a plane.
    """
    size = float(np.ptp(vertices, axis=0).max())
    try:
        hull = ConvexHull(vertices)
    except QhullError:
        raise ObjectError(
            "the mesh is flat: all its vertices lie in a plane, so it bounds no body; give it a thickness"
        ) from None
    inner = vertices[hull.vertices].mean(axis=0)
    corners = vertices[hull.simplices]
    volumes = np.abs(
        np.einsum("ti,ti->t", corners[:, 0] - inner, np.cross(corners[:, 1] - inner, corners[:, 2] - inner))
    )
    if volumes.sum() / 6 < 1e-9 * size**3:
        raise ObjectError("the mesh is flat: its thickness is nothing beside its size; give it a thickness")
    centroid = volumes @ (corners.sum(axis=1) + inner) / 4.0 / volumes.sum()
    facets, facet = np.unique(np.round(hull.equations[:, :3], 6), axis=0, return_inverse=True)
    meeting = np.unique(np.column_stack([hull.simplices.ravel(), np.repeat(facet.reshape(-1), 3)]), axis=0)
    outward = np.zeros_like(vertices)
    np.add.at(outward, meeting[:, 0], facets[meeting[:, 1]])
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
    stands_out = np.full(len(vertices), np.inf)
    for start, end in permutations(range(3), 2):
        a, b = hull.simplices[:, start], hull.simplices[:, end]
        np.minimum.at(stands_out, a, np.einsum("ni,ni->n", outward[a], vertices[a] - vertices[b]))
    return HullCorners(vertices[hull.vertices] - centroid, np.maximum(stands_out[hull.vertices], 0.0), centroid)


@dataclass(frozen=True, eq=False)
class Candidates:
    """Rotations about the centroid that may be symmetries.

    Attributes:
        rotations: (n, 3, 3) those that carry corners onto corners, the identity first.
        refuted: (m, 3, 3) those that do not, the nearest misses first, at most a few.
        refuted_by: (m,) how far they carry a corner from all corners.
        tried: how many pairs of corners were tried.
    """

    rotations: Rotations
    refuted: Rotations
    refuted_by: npt.NDArray[np.float64]
    tried: int


def candidate_rotations(corners: HullCorners, tolerance: float) -> Candidates:
    """Return all rotations that carry a pair of corners onto a congruent one, and corners onto corners.

    Args:
        corners: of a surface about as large as the unit sphere.
        tolerance: how far a symmetry may carry a point of the surface from the surface.

    Raises:
        ObjectError: there are too many; the surface is like a ball to this tolerance.
    """
    pool, sources = _pool(corners, tolerance)
    points = corners.points[pool]
    a, b, images_a, images_b = _congruent_pairs(points, np.isin(pool, sources), tolerance)
    found = _carrying(points[a], points[b], points[images_a], points[images_b])
    everything = cKDTree(corners.points)
    probes = corners.points[_spread(corners, sources)]
    rotations, off = [], []
    for start in range(0, len(found), 4096):
        refined, far = _refined(found[start : start + 4096], probes, corners.points, everything, tolerance)
        rotations.append(refined)
        off.append(far)
    R, far = np.concatenate(rotations), np.concatenate(off)
    is_candidate = far <= _MATCH * tolerance
    kept = _distinct(R[is_candidate], far[is_candidate])
    order = np.argsort(np.linalg.norm(kept - np.eye(3), axis=(1, 2)), kind="stable")
    kept = np.concatenate([np.eye(3)[None], kept[order][1:]])
    missed = np.argsort(far)[np.count_nonzero(is_candidate) :][:64]
    return Candidates(kept, R[missed], far[missed], len(found))


def _pool(corners: HullCorners, tolerance: float) -> tuple[Indices, Indices]:
    """Return the corners that may be images, and those of them that stand out for sure, the most that are needed."""
    radii = np.linalg.norm(corners.points, axis=1)
    for level in _STANDS_OUT:
        sources = np.flatnonzero((corners.stands_out > level * tolerance) & (radii > 0.02 * radii.max()))
        if len(sources) < 2:
            continue
        directions = corners.points[sources] / radii[sources, None]
        if np.linalg.svd(directions, compute_uv=False)[1] > _NEAR_AXIS:
            return np.flatnonzero(corners.stands_out > level * tolerance / _TRIANGULATION), sources
    raise ObjectError(
        "the mesh has no corners that stand out of its convex hull; its vertices are as good as in a line"
    )


def _congruent_pairs(
    points: Points, is_source: npt.NDArray[np.bool_], tolerance: float
) -> tuple[int, int, Indices, Indices]:
    """Return two corners and all pairs that are congruent to them, as indices of points (n, 3)."""
    radii = np.linalg.norm(points, axis=1)
    features = radii[:, None]
    alike = cKDTree(features)
    counts = alike.query_ball_point(features, 3 * tolerance, return_length=True)
    if counts.min(initial=_CLASS + 1, where=is_source) > _CLASS:
        near = cKDTree(points).query(points, k=_NEIGHBOURS + 1)[0][:, 1:]
        features = np.concatenate([features, near], axis=1)
        alike = cKDTree(features)
        counts = alike.query_ball_point(features, 6 * tolerance, p=np.inf, return_length=True)
    reach = 3 * tolerance if features.shape[1] == 1 else 6 * tolerance
    sources = np.flatnonzero(is_source)
    first = sources[np.lexsort((-radii[sources], counts[sources]))[0]]
    sines = np.linalg.norm(np.cross(points[sources], points[first]), axis=1) / (radii[sources] * radii[first])
    others = sources[sines > _NEAR_AXIS]
    if not len(others):
        others = sources[[int(sines.argmax())]]
    apart = np.linalg.norm(points[others] - points[first], axis=1)
    second = others[np.lexsort((apart, counts[others]))[0]]
    images_a = np.asarray(alike.query_ball_point(features[first], reach, p=np.inf), dtype=np.intp)
    images_b = np.asarray(alike.query_ball_point(features[second], reach, p=np.inf), dtype=np.intp)
    distance = float(np.linalg.norm(points[first] - points[second]))
    pairs, count = [], 0
    step = max(1, _AT_ONCE // len(images_b))
    for start in range(0, len(images_a), step):
        rows = images_a[start : start + step]
        between = np.linalg.norm(points[rows, None] - points[images_b], axis=-1)
        row, column = np.nonzero(np.abs(between - distance) <= 6 * tolerance)
        pairs.append((rows[row], images_b[column]))
        count += len(row)
        if count > MOST_CANDIDATES:
            raise ObjectError(
                f"more than {MOST_CANDIDATES:,} rotations carry two corners of the mesh onto others: it is like a "
                "ball, whose facets say nothing; state how far it may be from round, or use a mesh with fewer triangles"
            )
    to_first, to_second = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return int(first), int(second), to_first, to_second


def _carrying(a: Points, b: Points, to_a: Points, to_b: Points) -> Rotations:
    """Return the rotations (n, 3, 3) that carry the frame of a, b (3,) onto those of (n, 3) pairs."""
    return np.asarray(_frames(to_a, to_b) @ np.swapaxes(_frames(a[None], b[None]), -1, -2))


def _frames(a: Points, b: Points) -> Rotations:
    """Return orthonormal frames (n, 3, 3), as columns: halfway between a and b, across, and normal to both."""
    a, b = (v / np.linalg.norm(v, axis=1, keepdims=True) for v in (a, b))
    half, across = a + b, b - a
    if np.linalg.norm(half, axis=1).min() < 0.05:  # nearly opposite
        half = a + 0.5 * across
    normal = np.cross(half, across)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    half = half / np.linalg.norm(half, axis=1, keepdims=True)
    return np.stack([half, np.cross(normal, half), normal], axis=-1)


def _spread(corners: HullCorners, sources: Indices) -> Indices:
    """Return some of the corners that stand out, those farthest from each other first."""
    points = corners.points[sources]
    chosen = [int(np.linalg.norm(points, axis=1).argmax())]
    nearest = np.full(len(points), np.inf)
    for _ in range(min(_PROBES, len(points)) - 1):
        nearest = np.minimum(nearest, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(nearest.argmax()))
    return sources[chosen]


def _refined(
    rotations: Rotations, probes: Points, points: Points, tree: "cKDTree", tolerance: float
) -> tuple[Rotations, npt.NDArray[np.float64]]:
    """Return the rotations (n, 3, 3) that fit best to where corners are carried, and how far off the worst is (n,)."""
    few = probes[:8]
    far = tree.query((few @ np.swapaxes(rotations, -1, -2)).reshape(-1, 3))[0].reshape(-1, len(few)).max(axis=1)
    open_ = np.flatnonzero(far <= 2 * _MATCH * tolerance)
    refined = rotations.copy()
    if len(open_):
        turned = probes @ np.swapaxes(rotations[open_], -1, -2)
        images = points[tree.query(turned.reshape(-1, 3))[1]].reshape(turned.shape)
        U, _, Vt = np.linalg.svd(np.einsum("npi,pj->nij", images, probes))
        U[..., -1] *= np.sign(np.linalg.det(U @ Vt))[:, None]
        refined[open_] = U @ Vt
        off = np.linalg.norm(probes @ np.swapaxes(refined[open_], -1, -2) - images, axis=-1)
        far[open_] = off.max(axis=1)
    return refined, far


def _distinct(rotations: Rotations, off: npt.NDArray[np.float64]) -> Rotations:
    """Return the best of each set of rotations that are one."""
    if not len(rotations):
        return np.eye(3)[None]
    flat = rotations.reshape(-1, 9)
    near = cKDTree(flat).sparse_distance_matrix(cKDTree(flat), _SAME, output_type="coo_matrix")
    near.data[:] = 1.0
    labels = connected_components(near, directed=False)[1]
    order = np.lexsort((off, labels))
    is_first = np.ones(len(order), dtype=bool)
    is_first[1:] = labels[order][1:] != labels[order][:-1]
    return rotations[order[is_first]]
