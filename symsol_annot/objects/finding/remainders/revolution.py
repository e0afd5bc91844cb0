"""Axes that much of a surface is round about, found from its normals, which meet the axis of a surface of revolution.

A surface slips along itself under a motion x -> w x x + v where normals n have n . (w x x + v) = 0: Gelfand and Guibas,
"Shape segmentation using local slippage analysis", 2004. Each smooth face votes for its axis.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.finding.surface import Flags, Points, Surface
from symsol_annot.rotations.so3 import rotations_about

_SMOOTH = np.cos(np.radians(25.0))  # between normals across an edge within a smooth face
_LEAST_SHARE = 0.02  # of the area: smaller faces do not vote
_MOST_AXES = 3
_SLIPS = 0.03  # root mean square of n . velocity over that of a random motion
_MOST_OFF = 0.01  # of the radius: how far the facets of a round surface may be from round
_FACETS = 4.0  # how much farther than half of a surface the rest may be, and be round
_TURNS = np.array([0.31, 0.93, 1.71, 2.53, 3.37, 4.19, 5.23])  # rad
_SAMPLES = 400  # triangles that say whether an axis is worth while


@dataclass(frozen=True, eq=False)
class Revolution:
    """An axis, and what of a surface is round about it.

    Attributes:
        point, direction: (3,) of the axis, in the surface's unit and frame.
        is_round: (T,) the triangles that most turns about the axis carry onto the surface.
        deviation: how far from the surface those turns carry them at most, in radii.
    """

    point: Points
    direction: Points
    is_round: Flags
    deviation: float


def revolutions(surface: Surface, tolerance: float) -> list[Revolution]:
    """Return axes that half of a surface's area or more is round about; `tolerance` is of a symmetry, in radii."""
    centre = surface.area_centroid
    radius = float(np.linalg.norm(surface.vertices - centre, axis=1).max())
    placed = surface.placed(centre, radius)
    distance = SurfaceDistance(placed.corners)
    found = []
    some = np.random.default_rng(0).permutation(len(placed.triangles))[:_SAMPLES]
    every = np.arange(len(placed.triangles))
    for point, direction in _axes(placed):
        off = _offsets(placed, distance, some, point, direction, _MOST_OFF, tolerance / 10)
        typical = np.sort(off, axis=0)[len(_TURNS) // 2]
        order = np.argsort(typical)
        shares = np.cumsum(placed.areas[some][order]) / placed.areas[some].sum()
        limit = max(_FACETS * float(typical[order][np.searchsorted(shares, 0.5)]), tolerance)
        if limit > _MOST_OFF:
            continue
        off = _offsets(placed, distance, every, point, direction, limit, limit)
        is_round = (off <= limit).mean(axis=0) > 0.5
        found.append(Revolution(point * radius + centre, direction, is_round, limit))
    return found


def _offsets(
    surface: Surface,
    distance: SurfaceDistance,
    chosen: npt.NDArray[np.intp],
    point: Points,
    direction: Points,
    limit: float,
    slack: float,
) -> npt.NDArray[np.float64]:
    """Return how far from the surface turns carry the centroids of triangles: (turns, n); see `SurfaceDistance`."""
    centres = surface.corners[chosen].mean(axis=1) - point
    turned = centres @ np.swapaxes(rotations_about(direction, _TURNS), -1, -2) + point
    return distance(turned.reshape(-1, 3), limit, slack).reshape(len(_TURNS), -1)


def _axes(surface: Surface) -> list[tuple[Points, Points]]:
    """Return the axes that smooth faces are round about, points and directions, those of most area first."""
    labels = _smooth_faces(surface)
    areas = np.bincount(labels, surface.areas)
    votes: list[tuple[float, Points, Points]] = []
    for face in np.flatnonzero(areas > _LEAST_SHARE * areas.sum()):
        axis = _axis_of(surface, labels == face)
        if axis is None:
            continue
        point, direction = axis
        for index, (weight, other_point, other) in enumerate(votes):
            across = np.linalg.norm(np.cross(direction, other_point - point))
            if abs(direction @ other) > 0.999 and across < 0.01:
                votes[index] = (weight + float(areas[face]), other_point, other)
                break
        else:
            votes.append((float(areas[face]), point, direction))
    votes.sort(key=lambda vote: -vote[0])
    return [(point, direction) for _, point, direction in votes[:_MOST_AXES]]


def _smooth_faces(surface: Surface) -> npt.NDArray[np.intp]:
    """Return the number (T,) of the smooth face that each triangle belongs to."""
    across = surface.neighbours
    is_smooth = (across >= 0) & (np.einsum("ti,tki->tk", surface.normals, surface.normals[across]) > _SMOOTH)
    rows, edges = np.nonzero(is_smooth)
    graph = coo_matrix((np.ones(len(rows)), (rows, across[rows, edges])), 2 * (len(across),))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)


def _axis_of(surface: Surface, chosen: Flags) -> tuple[Points, Points] | None:
    """Return a point and the direction of the axis that some triangles are round about.

    None where there is none, or many: a plane, a ball and a bent sheet have none of their own.
    """
    centres, normals = surface.corners[chosen].mean(axis=1), surface.normals[chosen]
    weights = surface.areas[chosen] / surface.areas[chosen].sum()
    middle = weights @ centres
    size = max(float(np.sqrt(weights @ np.square(centres - middle).sum(axis=1))), 1e-9)
    rows = np.concatenate([np.cross((centres - middle) / size, normals), normals], axis=1)
    values, vectors = np.linalg.eigh(np.einsum("t,ti,tj->ij", weights, rows, rows))
    slips = int(np.count_nonzero(np.sqrt(np.maximum(values, 0.0)) < _SLIPS))
    if not 1 <= slips <= 2:
        return None
    turns, moves = vectors[:3, :slips], vectors[3:, :slips]
    left, lengths, right = np.linalg.svd(turns, full_matrices=False)
    if lengths[0] < 0.1 or (slips == 2 and lengths[1] > 0.1 * lengths[0]):
        return None
    direction = left[:, 0]
    velocity = moves @ right[0] / lengths[0]
    return middle + size * np.cross(direction, velocity), direction
