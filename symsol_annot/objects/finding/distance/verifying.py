"""Does a rotation map a surface onto itself, part onto part? By points first, and triangle by triangle then."""

from functools import cached_property

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.distance.covering import Covering
from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.rotations.so3 import Rotations

Points = npt.NDArray[np.float64]

_POINTS = 1_200  # of the whole surface, vertices and others
_FEW, _TOLD, _MOST_TELLING = 12, 4, 40


class Verifier:
    """Compares a surface with itself, turned about the origin.

    Args:
        surface: about as large as the unit sphere.
        tolerance: how far a symmetry may carry a point of a part from that part.
    """

    def __init__(self, surface: Surface, tolerance: float) -> None:
        self.surface, self.tolerance = surface, tolerance
        flags = [surface.part_of == part for part in range(len(surface.part_names))]
        self._parts = [_Part(surface, is_of_part, tolerance) for is_of_part in flags]

    def passes(self, R: Rotations) -> tuple[bool, float]:
        """Tell whether R is a symmetry: by some points, a bound of each triangle, and many points of the rest.

        Returns:
            whether it is, and how far it carries a point of those that were measured.
        """
        farthest = 0.0
        for test in (_Part.by_few, _Part.by_points, _Part.by_triangles):
            for part in self._parts:
                farthest = max(farthest, test(part, R))
                if farthest > self.tolerance:
                    return False, farthest
        return True, farthest

    def residual(self, R: Rotations) -> float:
        """Return the largest distance of a turned point from its part."""
        return max(part.residual(R) for part in self._parts)

    def bound(self, R: Rotations) -> tuple[float, int]:
        """Return how far the turned surface is from itself at most, and on how many triangles that is not known.

        The bound is over the triangles on which it is known.
        """
        bounds = np.concatenate([part.covering.bounds(R) for part in self._parts])
        is_known = np.isfinite(bounds)
        return float(bounds[is_known].max(initial=0.0)), int(np.count_nonzero(~is_known))


class _Part:
    """One part of a surface, compared with itself."""

    def __init__(self, surface: Surface, is_of_part: npt.NDArray[np.bool_], tolerance: float) -> None:
        self._surface, self._is_of_part, self._tolerance = surface, is_of_part, tolerance
        self._distance = SurfaceDistance(surface.corners[is_of_part])
        self._points = _points_of(surface, is_of_part)
        self._telling = self._points[:_FEW]  # that were carried off by a candidate which others had missed

    @cached_property
    def covering(self) -> Covering:
        """Bounds for its triangles."""
        return Covering(self._surface, self._is_of_part, self._distance, self._tolerance)

    def residual(self, R: Rotations) -> float:
        """Return the largest distance of a turned point."""
        return float(self._distance(self._points @ R.T, self._tolerance, self._tolerance / 100).max())

    def by_few(self, R: Rotations) -> float:
        """Return the largest distance of the points that have told most."""
        return float(self._distance(self._telling @ R.T, self._tolerance).max())

    def by_points(self, R: Rotations) -> float:
        """Return the largest distance of points all over the part."""
        return self._remember(self._points, R)

    def by_triangles(self, R: Rotations) -> float:
        """Return the largest distance of many points on the triangles that cannot be bounded."""
        is_open = ~np.isfinite(self.covering.bounds(R))
        pieces = self._distance.pieces[is_open[self._distance.parent]]
        return self._remember(np.concatenate([pieces.mean(axis=1), pieces.reshape(-1, 3)]), R) if len(pieces) else 0.0

    def _remember(self, points: Points, R: Rotations) -> float:
        off = self._distance(points @ R.T, self._tolerance)
        if off.max() > self._tolerance:
            worst = points[np.argsort(off)[-_TOLD:]]
            self._telling = np.concatenate([worst, self._telling])[:_MOST_TELLING]
        return float(off.max())


def _points_of(surface: Surface, is_of_part: npt.NDArray[np.bool_]) -> Points:
    """Return points of a part, always the same: vertices and others by turns."""
    rng = np.random.default_rng(0)
    areas = surface.areas * is_of_part
    share = max(64, round(_POINTS * areas.sum() / surface.areas.sum()))
    vertices = surface.vertices[np.unique(surface.triangles[is_of_part])]
    vertices = vertices[rng.permutation(len(vertices))[: share // 2]]
    chosen = rng.choice(len(areas), size=share // 2, p=areas / areas.sum())
    others = np.einsum("pi,pij->pj", rng.dirichlet(np.ones(3), size=share // 2), surface.corners[chosen])
    both = min(len(vertices), len(others))
    mixed = np.stack([vertices[:both], others[:both]], axis=1).reshape(-1, 3)
    return np.concatenate([mixed, vertices[both:], others[both:]])
