"""Finite groups of what is left of one connected surface without some of it: a cube with a bump, or with a corner cut.

Looked for are rotations that carry most of a surface onto itself, from its flat faces: a pair of planes and every pair
at the same angle give the rotation, and where planes are carried to gives its centre. Two images differ in what the one
has and the other has not: in points of the surface that the rotation does not carry onto the surface, there or back. If
a camera sees none of them in either image, the images are the same, and the larger group counts.
"""

from functools import cached_property
from itertools import combinations

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.axes import angles_and_axes
from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.finding.found import CertifiedGroup, Group, LargerGroup
from symsol_annot.objects.finding.kinds import fitted_group
from symsol_annot.objects.finding.surface import Flags, Points, Surface
from symsol_annot.rotations.so3 import Rotations, frame_about

_PLANE = 1e-4  # of normals and of levels in radii: faces in one plane
_MOST_PLANES, _LEAST_AREA = 60, 0.004  # of the whole area
_LEAST_FLAT = 0.5  # of the area must be flat
_ACROSS = 0.3  # sine of the angle between two planes that fix a rotation
_ALIKE = 3.0  # times larger may the area of a plane be that another is carried onto
_NORMALS_KEPT = 0.7  # share of the flat area whose normals are those of planes again
_EQUATIONS = 16  # of a centre, from the largest planes
_LEAST_LEFT = 0.75  # of the area: what is less does not dominate
_OFF_CENTRE = 1e-3  # radii
_MOST_AXES, _MOST_ELEMENTS = 8, 24
_POINTS, _FEW = 2000, 300  # that are compared, and that tell at once
_OCCLUDERS, _LOOKED_AT = 1000, 200
_INWARDS = 1e-3  # share of the way from a corner to the centre
_CAMERAS, _CAMERA_RADII = 300, 4.0
_SAME = 0.02  # Frobenius distance of rotations that are one


def off_flat_faces(surface: Surface, shape: CertifiedGroup, tolerance: float) -> LargerGroup | None:
    """Return the largest finite group that most of a surface has and all of it has not; None where there is none.

    Args:
        surface: in any unit and place.
        shape: its group as it is.
        tolerance: of a symmetry, in radii.
    """
    radius = float(np.linalg.norm(surface.vertices - shape.centre, axis=1).max())
    placed = surface.placed(shape.centre, radius)
    planes, areas = _planes(placed)
    if len(planes) < 3 or areas.sum() < _LEAST_FLAT * placed.areas.sum():
        return None
    matcher, own = _Matcher(placed, tolerance), shape.group.rotations
    candidates = [R for R in _candidates(planes, areas) if not _is_among(R, own)]
    centres = [(R, centre) for R in candidates if (centre := _centre(R, planes, areas)) is not None]
    best, chosen, score = list(candidates[:0]), np.zeros(3), (0.0, 0.0)
    for centre in _distinct(centres):
        measured = [(R, *_carried(R, centre, planes, areas)) for R in candidates]
        most = [(R, share, off) for R, share, off in measured if share >= _LEAST_LEFT]
        total = (round(sum(share for _, share, _ in most), 2), -sum(off for _, _, off in most))
        if total > score:
            best, chosen, score = [R for R, _, _ in most], centre, total
    found = [R for R in best if matcher.share(R, chosen) >= _LEAST_LEFT]
    if not found:
        return None
    group = _group_of(found, [R for R in own if np.linalg.norm((R - np.eye(3)) @ chosen) < _OFF_CENTRE])
    return matcher.larger(group, chosen, shape.centre, radius)


def _planes(surface: Surface) -> tuple[Points, npt.NDArray[np.float64]]:
    """Return the planes (p, 4) that faces lie in, normal and level, and the area in each, the largest first."""
    levels = np.einsum("ti,ti->t", surface.normals, surface.corners[:, 0])
    rows = np.column_stack([surface.normals, levels])
    _, first, place = np.unique(np.round(rows / _PLANE), axis=0, return_index=True, return_inverse=True)
    areas = np.bincount(place.reshape(-1), surface.areas)
    order = np.argsort(-areas, kind="stable")[:_MOST_PLANES]
    order = order[areas[order] >= _LEAST_AREA * surface.areas.sum()]
    return rows[first[order]], areas[order]


def _candidates(planes: Points, areas: npt.NDArray[np.float64]) -> Rotations:
    """Return rotations (n, 3, 3) that carry two planes onto two others at the same angle, of about their area."""
    normals = planes[:, :3]
    across = np.flatnonzero(np.linalg.norm(np.cross(normals, normals[0]), axis=1) > _ACROSS)
    if not len(across):
        return np.zeros((0, 3, 3))
    second = int(across[0])
    cosine = float(normals[0] @ normals[second])
    is_alike = [(areas <= _ALIKE * areas[base]) & (areas >= areas[base] / _ALIKE) for base in (0, second)]
    fits = (np.abs(normals @ normals.T - cosine) < _PLANE) & is_alike[0][:, None] & is_alike[1]
    to_first, to_second = np.nonzero(fits)
    frame = _frame(normals[:1], normals[second : second + 1])[0]
    R = _frame(normals[to_first], normals[to_second]) @ frame.T
    kept = np.einsum("nij,pj->npi", R, normals) @ normals.T > 1.0 - _PLANE
    share = (kept.any(axis=2) * areas).sum(axis=1) / areas.sum()
    distinct: list[Rotations] = []
    for one in R[share >= _NORMALS_KEPT]:
        if not distinct or not _is_among(one, np.stack(distinct)):
            distinct.append(one)
    return np.stack(distinct) if distinct else np.zeros((0, 3, 3))


def _frame(a: Points, b: Points) -> Rotations:
    """Return orthonormal frames (n, 3, 3), as columns, of unit vectors (n, 3) that are not parallel."""
    normal = np.cross(a, b)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return np.stack([a, np.cross(normal, a), normal], axis=-1)


def _is_among(R: Rotations, others: Rotations) -> bool:
    return bool(np.linalg.norm(others - R, axis=(1, 2)).min(initial=np.inf) < _SAME)


def _centre(R: Rotations, planes: Points, areas: npt.NDArray[np.float64]) -> Points | None:
    """Return the centre (3,) about which R carries most of the planes onto planes, the one nearest to the origin."""
    image, target = np.nonzero(planes[:, :3] @ R.T @ planes[:, :3].T > 1.0 - _PLANE)
    weight = np.minimum(areas[image], areas[target])
    order = np.argsort(-weight, kind="stable")
    image, target, weight = image[order], target[order], weight[order]
    rows, values = planes[image, :3] @ R.T - planes[image, :3], planes[target, 3] - planes[image, 3]
    solvable = np.flatnonzero(np.linalg.norm(rows, axis=1) > _ACROSS)[:_EQUATIONS]
    best, most = None, 0.0
    for pair in [*([k] for k in solvable), *(list(two) for two in combinations(solvable, 2))]:
        centre = np.linalg.lstsq(rows[pair], values[pair], rcond=1e-6)[0]
        fits = np.abs(rows @ centre - values) <= 4 * _PLANE
        covered = np.zeros(len(planes))
        np.maximum.at(covered, image[fits], weight[fits])
        if covered.sum() > most + 1e-12:
            best, most = np.linalg.lstsq(rows[fits], values[fits], rcond=1e-6)[0], float(covered.sum())
    return best if best is not None and np.linalg.norm(best) <= 1.0 else None


def _carried(R: Rotations, centre: Points, planes: Points, areas: npt.NDArray[np.float64]) -> tuple[float, float]:
    """Return the share of the flat area in planes that R about a centre carries onto planes, and how far off it is."""
    normals = planes[:, :3] @ R.T
    off = np.abs((planes[:, 3] + (normals - planes[:, :3]) @ centre)[:, None] - planes[:, 3])
    same = (normals @ planes[:, :3].T > 1.0 - _PLANE) & (off <= 4 * _PLANE)
    shares = np.minimum(areas[:, None], areas) * same
    total = float(shares.max(axis=1).sum())
    farthest = np.take_along_axis(off, shares.argmax(axis=1)[:, None], axis=1)[:, 0]
    return total / float(areas.sum()), float(shares.max(axis=1) @ farthest) / max(total, 1e-300)


def _distinct(centres: list[tuple[Rotations, Points]]) -> list[Points]:
    """Return the centres of rotations, and points that two of them leave in place, each once."""
    axes = [(R - np.eye(3), (R - np.eye(3)) @ centre) for R, centre in centres]
    meeting = []
    for (rows, values), (others, more) in combinations(axes[:_MOST_AXES], 2):
        point = np.linalg.lstsq(np.concatenate([rows, others]), np.concatenate([values, more]), rcond=1e-6)[0]
        if max(np.abs(rows @ point - values).max(), np.abs(others @ point - more).max()) <= 4 * _PLANE:
            meeting.append(point)
    distinct: list[Points] = []
    for centre in [*(centre for _, centre in centres), *meeting]:
        if min((float(np.linalg.norm(centre - other)) for other in distinct), default=1.0) > _PLANE:
            distinct.append(centre)
    return distinct


def _group_of(found: list[Rotations], own: list[Rotations]) -> Group:
    """Return the group that rotations are with those that the whole has; a cyclic one where they are no group."""
    try:
        return fitted_group(np.stack([*own, *found]))
    except ObjectError:
        angle, axis = angles_and_axes(found[0][None])
        return Group("cyclic", max(2, round(2 * np.pi / float(angle[0]))), frame_about(axis[0]))


class _Matcher:
    """Tells which points of a surface in the unit sphere a rotation about a centre carries onto it."""

    def __init__(self, surface: Surface, tolerance: float) -> None:
        self._surface, self._tolerance = surface, tolerance
        self._distance = SurfaceDistance(surface.corners)
        rng, pieces = np.random.default_rng(0), self._distance.pieces
        sides = pieces[:, 1:] - pieces[:, :1]
        areas = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1) / 2.0
        even = rng.choice(len(pieces), size=_POINTS, p=areas / areas.sum())
        some = rng.permutation(len(surface.triangles))[:_POINTS]  # the corners of small faces as well
        corners = surface.corners[some]
        corners = corners + _INWARDS * (corners.mean(axis=1, keepdims=True) - corners)
        self._points = np.concatenate([pieces[even].mean(axis=1), corners.reshape(-1, 3)])
        self._triangle = np.concatenate([self._distance.parent[even], np.repeat(some, 3)])

    def share(self, R: Rotations, centre: Points) -> float:
        """Return the share of the area that a rotation carries onto the surface, there and back."""
        some = self._points[:_FEW]
        for turn in (R, R.T):
            if np.count_nonzero(self._is_on(some, turn, centre)) < (_LEAST_LEFT - 0.1) * _FEW:
                return 0.0
        even = self._points[:_POINTS]
        return min(float(self._is_on(even, turn, centre).mean()) for turn in (R, R.T))

    def _is_on(self, points: Points, turn: Rotations, centre: Points) -> Flags:
        return self._distance((points - centre) @ turn.T + centre, self._tolerance) <= self._tolerance

    def larger(self, group: Group, centre: Points, origin: Points, radius: float) -> LargerGroup | None:
        """Return what is reported of a group, if some camera does not see where one of its rotations differs."""
        failures, tried, is_hidden = np.zeros(len(self._points), dtype=np.intp), 0, False
        step = max(1, len(group.rotations) // _MOST_ELEMENTS)
        for R in group.rotations[1::step]:
            there, back = ~self._is_on(self._points, R, centre), ~self._is_on(self._points, R.T, centre)
            if not there.any() and not back.any():
                continue
            failures += there | back
            tried += 1
            is_hidden = is_hidden or self._is_hidden(there, back, R, centre)
        if not is_hidden:
            return None
        is_taken = failures > 0.5 * failures.max()
        left = 1.0 - float(is_taken[:_POINTS].mean())
        if left < _LEAST_LEFT:
            return None
        in_triangle = np.bincount(self._triangle, is_taken, minlength=len(self._surface.triangles))
        taken = np.flatnonzero(in_triangle > 0.5 * np.bincount(self._triangle, minlength=len(in_triangle)))
        taken = taken[in_triangle[taken] > 0]
        x, y, z = (origin + radius * self._points[is_taken].mean(axis=0)).tolist()
        faces = f"the {len(taken)} faces" if len(taken) else "the cut"
        what = f"{faces} around ({x:.3g}, {y:.3g}, {z:.3g})"
        sources = self._surface.source[taken]
        return LargerGroup(group, group, origin + radius * centre, sources, what, left, self._tolerance)

    def _is_hidden(self, there: Flags, back: Flags, R: Rotations, centre: Points) -> bool:
        """Tell whether a camera sees none of the points that differ, of the surface and of the surface turned.

        Args:
            there: points that R does not carry onto the surface, so that the turned surface has them alone.
            back: points that its inverse does not carry onto the surface, so that the surface has them alone.
            R: (3, 3).
            centre: (3,) of the turn.
        """
        cameras = _CAMERA_RADII * np.concatenate([_directions(), np.unique(self._surface.normals.round(6), axis=0)])
        cameras = cameras[self._hide(back, centre + cameras)]
        return bool(self._hide(there, centre + cameras @ R).any())

    def _hide(self, differs: Flags, cameras: Points) -> Flags:
        """Tell which cameras (n, 3) see none of the points that differ: they face away, or the surface blocks them."""
        hidden = np.ones(len(cameras), dtype=bool)
        chosen = np.flatnonzero(differs)
        for index in np.random.default_rng(0).permutation(chosen)[:_LOOKED_AT]:
            normal = self._surface.normals[self._triangle[index]]
            point = self._points[index] + _INWARDS * normal
            facing = np.flatnonzero(hidden & ((cameras - point) @ normal > 0))
            if len(facing):
                hidden[facing] = self._blocks(point, cameras[facing])
        return hidden

    def _blocks(self, point: Points, cameras: Points) -> Flags:
        """Tell of which cameras (n, 3) the surface's larger faces block the view of a point (3,).

        Moeller and Trumbore, "Fast, minimum storage ray/triangle intersection", 1997.
        """
        a, u, v = self._occluders
        rays = cameras - point
        across = np.cross(rays[:, None], v)
        determinant = np.einsum("nti,ti->nt", across, u)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / determinant
            first = np.einsum("nti,ti->nt", across, point - a) * inverse
            other = np.cross(point - a, u)
            second = (rays @ other.T) * inverse
            length = np.einsum("ti,ti->t", other, v) * inverse
            hits = (first >= 0) & (second >= 0) & (first + second <= 1) & (length > 0) & (length < 1)
        return np.asarray(hits.any(axis=1))

    @cached_property
    def _occluders(self) -> tuple[Points, Points, Points]:
        """The largest triangles: a corner and the two sides from it, (t, 3) each."""
        largest = np.argsort(-self._surface.areas, kind="stable")[:_OCCLUDERS]
        a, b, c = np.moveaxis(self._surface.corners[largest], 1, 0)
        return a, b - a, c - a


def _directions() -> Points:
    """Return unit vectors (n, 3) all around."""
    index = np.arange(_CAMERAS) + 0.5
    z, turn = 1 - 2 * index / _CAMERAS, np.pi * (1 + np.sqrt(5)) * index
    return np.column_stack([np.sqrt(1 - z * z) * np.cos(turn), np.sqrt(1 - z * z) * np.sin(turn), z])
