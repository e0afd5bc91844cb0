"""The smallest sphere around points, found by exchanging the few of them that it rests on."""

import contextlib
from itertools import combinations

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError

_ROUNDING = 1e-12  # of the radius
_MOST_STEPS = 1000  # a few dozen are usual
_MOST_RESTED_ON = 4
Points = npt.NDArray[np.float64]


def smallest_sphere(points: Points) -> tuple[Points, float]:
    """Return centre (3,) and radius of the smallest sphere that holds all points (n, 3).

    The sphere around two to four points grows by the point that is farthest outside it, until there is none. Each step
    makes it larger, so that none comes back.
    """
    with contextlib.suppress(QhullError):  # all in one plane
        points = points[ConvexHull(points).vertices]
    rested_on, centre, radius = points[:1], points[0], 0.0
    for _ in range(_MOST_STEPS):
        distances = np.linalg.norm(points - centre, axis=1)
        farthest = int(np.argmax(distances))
        if distances[farthest] <= radius * (1.0 + _ROUNDING):
            break
        rested_on, centre, larger = _around_few(np.vstack([rested_on, points[farthest]]))
        if larger <= radius:  # by rounding
            break
        radius = larger
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def _around_few(points: Points) -> tuple[Points, Points, float]:
    """Return the smallest sphere around at most five points, by trying all that it may rest on."""
    best: tuple[Points, Points, float] = (points, points[0], np.inf)
    for count in range(1, min(len(points), _MOST_RESTED_ON) + 1):
        for chosen in combinations(range(len(points)), count):
            few = points[list(chosen)]
            offsets = few[1:] - few[0]
            centre = few[0] + np.linalg.lstsq(2.0 * offsets, np.square(offsets).sum(axis=1), rcond=1e-12)[0]
            radius = float(np.linalg.norm(points - centre, axis=1).max())
            if radius < best[2] * (1.0 - _ROUNDING):
                best = (few, centre, radius)
    return best
