"""Which rotations of a group map a part onto itself, or onto another: derived from its triangles, not declared.

A rotation that carries every corner of a part, and points spread over it, onto the part's surface within the tolerance
is certified; since it changes no area, it then covers the part. Only few rotations are tried that way: the area's
centroid and its second moments refute most, products of certified rotations are certified, and a refuted one refutes
all that differ from it by a certified one.
"""

from collections.abc import Callable
from functools import cached_property

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.surface import SURFACE_TOLERANCE, Points, distance_to_triangles, surface_points
from symsol_annot.rotations.groups import nearest_element
from symsol_annot.rotations.so3 import Rotations, angle_between

Flags = npt.NDArray[np.bool_]

_SAME = 1e-6  # of two elements' matrices
_FEW = 12  # points that are tried first
_FEW_DISTANCES = 20_000  # are measured one by one; for more, a tree pays
_MOMENT_SLACK = 1e-4  # of centroids and second moments, beyond what the surface's tolerance can move them by


def stabiliser_of_part(triangles: Points, group: Rotations) -> Flags:
    """Tell which rotations of a group (G, 3, 3), identity first, map triangles (T, 3, 3) onto themselves: (G,)."""
    certified = np.zeros(len(group), dtype=bool)
    certified[0] = True
    is_open = _moments_fit(triangles, triangles, group)
    points, onto = _points_of(triangles), _Onto(triangles)
    generators: list[int] = []
    for element in np.argsort(angle_between(group, np.eye(3)), kind="stable").tolist():
        if not is_open[element] or certified[element]:
            continue
        if onto.has_all(points @ group[element].T):
            generators.append(element)
            certified = _generated(group, certified, generators)
        else:
            refuted = nearest_element(group, group[element] @ group[certified])
            is_open[refuted] = False
    return certified


def carried_onto(triangles: Points, others: Points, group: Rotations) -> Flags:
    """Tell which rotations of a group (G, 3, 3) carry triangles (T, 3, 3) onto other ones (U, 3, 3): (G,)."""
    fits = _moments_fit(triangles, others, group)
    points, onto = _points_of(triangles), _Onto(others)
    for element in np.flatnonzero(fits).tolist():
        fits[element] = onto.has_all(points @ group[element].T)
    return fits


def _points_of(triangles: Points) -> Points:
    """Return points spread over triangles, followed by all their corners."""
    return np.concatenate([surface_points(triangles), np.unique(triangles.reshape(-1, 3), axis=0)])


class _Onto:
    """Triangles (T, 3, 3) that points are to be on."""

    def __init__(self, triangles: Points) -> None:
        self._triangles = triangles

    @cached_property
    def _distance(self) -> Callable[..., Points]:
        from symsol_annot.objects.finding.distances import SurfaceDistance  # noqa: PLC0415 - scipy is slow to load

        return SurfaceDistance(self._triangles)

    def has_all(self, points: Points) -> bool:
        """Tell whether points (n, 3) are on the triangles, within the tolerance; of most that are not, a few tell."""
        if distance_to_triangles(points[:_FEW], self._triangles).max() > SURFACE_TOLERANCE:
            return False
        if len(points) * len(self._triangles) <= _FEW_DISTANCES:
            return bool(distance_to_triangles(points[_FEW:], self._triangles).max(initial=0.0) <= SURFACE_TOLERANCE)
        return bool(self._distance(points[_FEW:], SURFACE_TOLERANCE).max(initial=0.0) <= SURFACE_TOLERANCE)


def _generated(group: Rotations, certified: Flags, generators: list[int]) -> Flags:
    """Return the subgroup that elements generate, given the one that all but the last of them do: (G,)."""
    powers = [np.eye(3)]
    while np.abs((following := powers[-1] @ group[generators[-1]]) - np.eye(3)).max() > _SAME:
        powers.append(following)
    found = certified.copy()
    found[nearest_element(group, group[certified][:, None] @ np.stack(powers))] = True
    while True:  # closed under right multiplication with generators, it is the group that they generate
        products = nearest_element(group, group[found][:, None] @ group[generators])
        if found[products].all():
            return found
        found[products] = True


def _moments_fit(triangles: Points, others: Points, group: Rotations) -> Flags:
    """Tell which rotations carry area, centroid and second moments of triangles onto those of others."""
    area, centroid, moments = _moments(triangles)
    other_area, other_centroid, other_moments = _moments(others)
    if abs(area - other_area) > _MOMENT_SLACK * max(area, other_area):
        return np.zeros(len(group), dtype=bool)
    off = np.linalg.norm(group @ centroid - other_centroid, axis=-1)
    turned = group @ moments @ np.swapaxes(group, -1, -2)
    return np.asarray((off <= _MOMENT_SLACK) & (np.abs(turned - other_moments).max(axis=(1, 2)) <= _MOMENT_SLACK))


def _moments(triangles: Points) -> tuple[float, Points, Points]:
    """Return the area of triangles, its centroid (3,), and its mean of x x^T (3, 3)."""
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2.0
    total = float(areas.sum())
    sums = triangles.sum(axis=1)
    centroid = areas @ sums / (3.0 * total)
    squares = np.einsum("tci,tcj->tij", triangles, triangles) + np.einsum("ti,tj->tij", sums, sums)
    return total, centroid, np.einsum("t,tij->ij", areas, squares) / (12.0 * total)
