"""Lattice points counted by a polygon's outline are those that a test of every point finds."""

import numpy as np
import pytest

from symsol_annot.annotation.scanline import LatticePoints, Segments, count_inside, is_inside, points_near

SIDE = 24


def polygon(rng):
    """Return a star-shaped polygon's corners (k, 2), in the order in which its outline runs."""
    angles = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 12)))[::-1]
    radii = rng.uniform(2, 11, len(angles))
    return SIDE / 2 + radii[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)


def outlines_of(polygons):
    owner = np.repeat(np.arange(len(polygons)), [len(corners) for corners in polygons])
    return Segments(owner, np.concatenate(polygons), np.concatenate([np.roll(c, -1, axis=0) for c in polygons]))


def turns_around(corners):
    """Return how often a polygon winds around each lattice point, from the angles that its corners are seen at."""
    u, v = np.meshgrid(np.arange(SIDE) + 0.5, np.arange(SIDE) + 0.5)
    seen = [np.arctan2(y - v, x - u) for x, y in corners]
    steps = [(b - a + np.pi) % (2 * np.pi) - np.pi for a, b in zip(seen, np.roll(seen, -1, axis=0), strict=True)]
    return -np.rint(np.sum(steps, axis=0) / (2 * np.pi)).astype(int)


def distances_along_axes(points, start, end):
    """Return the larger of |du| and |dv| from each point (n, 2) to a segment, which is convex along it."""

    def at(share):
        return np.abs(start + share[:, None] * (end - start) - points).max(axis=1)

    low, high = np.zeros(len(points)), np.ones(len(points))
    for _ in range(30):  # thirds, of which the farther outer one goes
        first, second = low + (high - low) / 3, high - (high - low) / 3
        is_right = at(first) > at(second)
        low, high = np.where(is_right, first, low), np.where(is_right, high, second)
    return at(low)


@pytest.mark.parametrize("seed", range(20))
def test_outlines_count_the_points_that_they_wind_around(seed):
    rng = np.random.default_rng(seed)
    polygons = [polygon(rng) for _ in range(5)]
    outlines = outlines_of(polygons)
    around = [turns_around(corners) for corners in polygons]
    assert count_inside(outlines, 5).tolist() == [turns.sum() for turns in around]
    near = points_near(outlines, 1.5)
    assert is_inside(near, outlines).tolist() == [
        around[o][r, c] > 0 for o, r, c in zip(near.owner, near.row, near.column, strict=True)
    ]


@pytest.mark.parametrize("reach", [0.05, 0.4, 1.3])
def test_points_near_a_segment_are_those_within_reach_along_both_axes(reach):
    rng = np.random.default_rng(7)
    ends = rng.uniform(3, SIDE - 3, (40, 2, 2))
    ends[:4, 1, 1] = ends[:4, 0, 1]  # along a row
    ends[4:8, 1, 0] = ends[4:8, 0, 0]  # along a column
    ends[8] = ends[8, 0]  # a point
    near = points_near(Segments(np.arange(40), ends[:, 0], ends[:, 1]), reach)
    found = set(zip(near.owner.tolist(), near.row.tolist(), near.column.tolist(), strict=True))
    assert len(found) == len(near.owner)
    cells = np.array([*np.ndindex(SIDE, SIDE)])
    for k, (start, end) in enumerate(ends):
        distances = distances_along_axes(cells[:, ::-1] + 0.5, start, end)
        for (row, column), distance in zip(cells.tolist(), distances, strict=True):
            if abs(distance - reach) > 0.001:
                assert ((k, row, column) in found) == (distance < reach)


def test_points_lie_half_a_spacing_beyond_their_row_and_column():
    points = LatticePoints.joined(([0, 0], [3, 5], [7, 2]))
    assert points.uv.tolist() == [[7.5, 3.5], [2.5, 5.5]]
    assert LatticePoints.none().uv.shape == (0, 2)


def test_points_of_chosen_polygons_are_kept_and_their_polygons_numbered_anew():
    points = LatticePoints.joined(([0, 1, 2, 2], [3, 4, 5, 6], [7, 8, 9, 9]))
    kept = points.of_owners(np.array([False, True, True]))
    assert [kept.owner.tolist(), kept.row.tolist(), kept.column.tolist()] == [[0, 1, 1], [4, 5, 6], [8, 9, 9]]
