"""Which rotations of a group map a part onto itself, or onto another: derived from its triangles, not declared.

A rotation that carries every corner of a part, and points spread over it, onto the part's surface within the tolerance
is certified; since it changes no area, it then covers the part. Only few rotations are tried that way: the area's
centroid and its second moments refute most, products of certified rotations are certified, and a refuted one refutes
all that differ from it by a certified one.
"""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.surface import SURFACE_TOLERANCE, Points, surface_offsets, surface_points
from symsol_annot.rotations.groups import CIRCLE_STEPS, nearest_element
from symsol_annot.rotations.so3 import Rotations, angle_between, frame_about, rotations_about

Flags = npt.NDArray[np.bool_]

_SAME = 1e-6  # of two elements' matrices
_NO_TURN = 1e-4  # rad: less is none
_DECIMALS = 9  # of vertices, as meshes have them
_FEW_POINTS = 4  # that most rotations move off the part
_MOMENT_SLACK = 1e-4  # of centroids and second moments, beyond what the surface's tolerance can move them by


def stabiliser_of_part(triangles: Points, group: Rotations) -> Flags:
    """Tell which rotations of a group (G, 3, 3), identity first, map triangles (T, 3, 3) onto themselves: (G,)."""
    certified = np.zeros(len(group), dtype=bool)
    certified[0] = True
    is_open = _moments_fit(triangles, triangles, group)
    generators: list[int] = []
    for element in np.argsort(angle_between(group, np.eye(3)), kind="stable").tolist():
        if not is_open[element] or certified[element]:
            continue
        coset = nearest_element(group, group[element] @ group[certified])
        if is_open[coset].all() and lands_on(triangles, triangles, group[element]):
            generators.append(element)
            certified = _generated(group, certified, generators)
        else:
            is_open[coset] = False
    return certified


def carried_onto(triangles: Points, others: Points, group: Rotations) -> Flags:
    """Tell which rotations of a group (G, 3, 3) carry triangles (T, 3, 3) onto other ones (U, 3, 3): (G,)."""
    fits = _moments_fit(triangles, others, group)
    for element in np.flatnonzero(fits).tolist():
        fits[element] = lands_on(triangles, others, group[element])
    return fits


def lands_on(triangles: Points, others: Points, R: Rotations) -> bool:
    """Tell whether a rotation carries points spread over triangles, and all their corners, onto other triangles.

    A few points refute most rotations. A corner that comes to lie on a corner needs no distance to triangles.
    """
    points = surface_points(triangles)
    for some in (points[-_FEW_POINTS:], points[:-_FEW_POINTS]):
        if surface_offsets(some, others, R[None])[0] > SURFACE_TOLERANCE:
            return False
    from scipy.spatial import cKDTree  # noqa: PLC0415 - scipy is slow to load, and most rotations are refuted before

    corners, targets = (np.unique(some.reshape(-1, 3), axis=0) for some in (triangles, others))
    to_corner, _ = cKDTree(targets).query(corners @ R.T, distance_upper_bound=SURFACE_TOLERANCE)
    beside = corners[~(to_corner <= SURFACE_TOLERANCE)]
    return bool(surface_offsets(beside, others, R[None])[0] <= SURFACE_TOLERANCE)


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
    area, centroid, moments = moments_of(triangles)
    other_area, other_centroid, other_moments = moments_of(others)
    if abs(area - other_area) > _MOMENT_SLACK * max(area, other_area):
        return np.zeros(len(group), dtype=bool)
    off = np.linalg.norm(group @ centroid - other_centroid, axis=-1)
    turned = group @ moments @ np.swapaxes(group, -1, -2)
    return np.asarray((off <= _MOMENT_SLACK) & (np.abs(turned - other_moments).max(axis=(1, 2)) <= _MOMENT_SLACK))


def moments_of(triangles: Points) -> tuple[float, Points, Points]:
    """Return the area of triangles, its centroid (3,), and its mean of x x^T (3, 3)."""
    sides = triangles[:, 1:] - triangles[:, :1]
    areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2.0
    total = float(areas.sum())
    sums = triangles.sum(axis=1)
    centroid = areas @ sums / (3.0 * total)
    squares = np.einsum("tci,tcj->tij", triangles, triangles) + np.einsum("ti,tj->tij", sums, sums)
    return total, centroid, np.einsum("t,tij->ij", areas, squares) / (12.0 * total)


def order_about(axis: Points, triangles: Points) -> int:
    """Return how many turns about an axis (3,) map triangles (T, 3, 3) onto themselves; 360 where a circle does.

    They carry the corner farthest from the axis onto others that are as far, so that few have to be tried.
    """
    x, y, _ = (np.unique(triangles.reshape(-1, 3).round(_DECIMALS), axis=0) @ frame_about(axis)).T
    radius, azimuth = np.hypot(x, y), np.arctan2(y, x)
    farthest = azimuth[radius >= radius.max() - SURFACE_TOLERANCE]
    turns = np.sort((farthest - farthest[0]) % (2.0 * np.pi))
    for turn in turns[turns > _NO_TURN].tolist():
        order = round(2.0 * np.pi / turn)
        generator = rotations_about(axis, 2.0 * np.pi / order)
        if abs(2.0 * np.pi / order - turn) * radius.max() <= SURFACE_TOLERANCE and lands_on(
            triangles, triangles, generator
        ):
            return CIRCLE_STEPS if order % CIRCLE_STEPS == 0 else order
    return 1
