"""Is a surface a ball of facets, or one but for a few of its faces?"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.found import CertifiedGroup, Group, LargerGroup
from symsol_annot.objects.finding.remainders.roundness import MOST_OFF_ROUND, NEARLY_BALL, off_ball
from symsol_annot.objects.finding.surface import Flags, Points, Surface
from symsol_annot.rotations.groups import ALL_ROTATIONS

_ROUNDS = 40  # of a fit by absolute distances
_LEAST_OFF = 1e-9  # radii, under which a vertex weighs no more
_LEAST_COVERED = 0.8  # of a sphere's area, by what is left of a ball
_FACETS = 4.0  # how much farther than half of the vertices the rest may be from the sphere, and be on it
_MOST_OFF_SPHERE = 2e-3  # radii that a vertex on the sphere may be off


@dataclass(frozen=True, eq=False)
class Ball:
    """The sphere that a surface is near.

    Attributes:
        centre: (3,) in the surface's unit and frame.
        radius: the largest distance of the surface from it.
        deviation: by how much the least distance is smaller, in radii: no rotation carries a point farther off.
    """

    centre: Points
    radius: float
    deviation: float

    @property
    def group(self) -> Group:
        """All rotations."""
        return Group(ALL_ROTATIONS, None, np.eye(3))

    @property
    def certified(self) -> CertifiedGroup:
        """All rotations as the surface's group, which no candidate was tried for, and none is left of."""
        return CertifiedGroup(self.group, self.centre, self.deviation, self.deviation, 0, None, 0)


def ball_limit(round_within: float | None) -> float:
    """Return how far from a ball a surface may be to count as one, in radii, if a user stated this or None."""
    return NEARLY_BALL if round_within is None else round_within


def ball_of(surface: Surface, within: float = MOST_OFF_ROUND) -> Ball | None:
    """Return the ball that a surface is within some radii; None where it is farther from each.

    Facets leave off most in their middles, so their corners say where the centre is.
    """
    found = _about(surface, _fitted_centre(surface.vertices, np.ones(len(surface.vertices))))
    return found if found.deviation <= within else None


def without_bumps(surface: Surface, within: float) -> LargerGroup | None:
    """Return all rotations, as the group of a ball that a surface is without some faces; None where it is no such.

    Args:
        surface: in any unit and place.
        within: how far what is left may be from a ball, in radii.
    """
    taken = _off_sphere(surface)
    if not taken.any() or taken.all():
        return None
    rest = surface.chosen(~taken)
    ball = ball_of(rest, within)
    if ball is None or rest.areas.sum() < _LEAST_COVERED * 4.0 * np.pi * ball.radius**2:
        return None
    patches = int(surface.chosen(taken).components.max()) + 1
    what = f"{np.count_nonzero(taken)} faces in {patches} patch{'es' if patches > 1 else ''}"
    area_left = float(rest.areas.sum() / surface.areas.sum())
    return LargerGroup(ball.group, ball.group, ball.centre, surface.source[taken], what, area_left, ball.deviation)


def _about(surface: Surface, centre: Points) -> Ball:
    radius = float(np.linalg.norm(surface.vertices - centre, axis=1).max())
    return Ball(centre, radius, off_ball(surface.placed(centre, radius)))


def _fitted_centre(points: Points, weights: npt.NDArray[np.float64]) -> Points:
    """Return the centre (3,) of the sphere |p|^2 = 2 c . p + d that fits weighted points (n, 3) best."""
    middle = points.mean(axis=0)
    size = max(float(np.abs(points - middle).max()), 1e-300)
    unit = (points - middle) / size
    rows = np.column_stack([2.0 * unit, np.ones(len(unit))])
    weighted = rows.T * (weights / weights.sum())
    solution = np.linalg.lstsq(weighted @ rows, weighted @ np.square(unit).sum(axis=1), rcond=None)[0]
    return np.asarray(solution[:3] * size + middle)


def _off_sphere(surface: Surface) -> Flags:
    """Return which triangles (T,) have a corner off the sphere that most vertices are on; all where there is none."""
    areas = np.zeros(len(surface.vertices))
    np.add.at(areas, surface.triangles.reshape(-1), np.repeat(surface.areas, 3))
    weights = areas.copy()
    for _ in range(_ROUNDS):
        distances = np.linalg.norm(surface.vertices - _fitted_centre(surface.vertices, weights), axis=1)
        order = np.argsort(distances)
        shares = np.cumsum(areas[order]) / areas.sum()
        radius = float(distances[order][np.searchsorted(shares, 0.5)])
        off = np.abs(distances / radius - 1.0)
        weights = areas / np.maximum(off, _LEAST_OFF)
    order = np.argsort(off)
    typical = float(off[order][np.searchsorted(np.cumsum(areas[order]) / areas.sum(), 0.5)])
    limit = max(_FACETS * typical, 1e-5)
    if limit > _MOST_OFF_SPHERE:
        return np.ones(len(surface.triangles), dtype=bool)
    return np.asarray((off[surface.triangles] > limit).any(axis=1))
