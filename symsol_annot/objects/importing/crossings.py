"""Which triangles of a mesh cross each other, by a tree of boxes."""

import numpy as np
import numpy.typing as npt

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_LEAF = 4  # triangles in a box that is not divided
_PAIRS = 2**19  # of boxes, compared at once
_MARGIN = 1e-7  # of the size: surfaces that come so near touch, and do not cross


def crossing_pairs(vertices: Points, triangles: Indices) -> Indices:
    """Return pairs (n, 2) of triangles that cross and have no vertex in common.

    An edge of one goes through the other, by more than a ten-millionth of the mesh's size on either side. Two in one
    plane do not cross.
    """
    corners = vertices[triangles]
    margin = _MARGIN * float(np.ptp(vertices, axis=0).max())
    low, high = corners.min(axis=1), corners.max(axis=1)
    found = [np.zeros((0, 2), dtype=np.intp)]
    for near in _near_pairs(corners):
        meeting = near[_boxes_meet(low, high, near, margin)]
        one, other = triangles[meeting[:, 0]], triangles[meeting[:, 1]]
        apart = meeting[(one[:, :, None] != other[:, None, :]).all(axis=(1, 2))]
        found.append(apart[_cross(corners, apart, margin)])
    return np.concatenate(found)


def _near_pairs(corners: Points) -> list[Indices]:
    """Return lists of pairs (n, 2), first index lower, of triangles in boxes that meet; each pair once."""
    order = _along_curve(corners.mean(axis=1))
    levels = int(np.ceil(np.log2(max(1, len(order) / _LEAF))))
    padded = np.concatenate([order, np.zeros(_LEAF * 2**levels - len(order), dtype=np.intp)])
    is_there = (np.arange(len(padded)) < len(order))[:, None]
    low = np.where(is_there, corners[padded].min(axis=1), np.inf).reshape(-1, _LEAF, 3).min(axis=1)
    high = np.where(is_there, corners[padded].max(axis=1), -np.inf).reshape(-1, _LEAF, 3).max(axis=1)
    boxes = [(low, high)]
    for _ in range(levels):
        low, high = low.reshape(-1, 2, 3).min(axis=1), high.reshape(-1, 2, 3).max(axis=1)
        boxes.append((low, high))
    found: list[Indices] = []
    waiting = [(levels, np.zeros((1, 2), dtype=np.intp))]
    while waiting:
        level, pairs = waiting.pop()
        low, high = boxes[level]
        meets = (low[pairs[:, 0]] <= high[pairs[:, 1]]).all(axis=1) & (low[pairs[:, 1]] <= high[pairs[:, 0]]).all(
            axis=1
        )
        pairs = pairs[meets]
        if level == 0:
            found.append(_of_leaves(pairs, padded, len(order)))
            continue
        children = (2 * pairs[:, :, None] + np.arange(2))[:, :, [0, 0, 1, 1]]
        children[:, 1] = children[:, 1][:, [0, 2, 0, 2]]
        both = np.moveaxis(children, 1, 2).reshape(-1, 2)
        both = both[both[:, 0] <= both[:, 1]]
        waiting += [(level - 1, both[start : start + _PAIRS]) for start in range(0, len(both), _PAIRS)]
    return found


def _of_leaves(pairs: Indices, padded: Indices, count: int) -> Indices:
    first, second = (_LEAF * pairs[:, side, None] + np.arange(_LEAF) for side in (0, 1))
    places = np.stack(np.broadcast_arrays(first[:, :, None], second[:, None, :]), axis=-1).reshape(-1, 2)
    places = places[(places[:, 0] < places[:, 1]) & (places[:, 1] < count)]
    return np.sort(padded[places], axis=1)


def _along_curve(points: Points) -> Indices:
    """Return the order of points (n, 3) along a curve that keeps neighbours near (Morton's)."""
    span = np.ptp(points, axis=0).max()
    cells = ((points - points.min(axis=0)) / (span if span > 0 else 1.0) * 1023).astype(np.int64)
    code = np.zeros(len(points), dtype=np.int64)
    for bit in range(10):
        for axis in range(3):
            code |= (cells[:, axis] >> bit & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable").astype(np.intp)


def _boxes_meet(low: Points, high: Points, pairs: Indices, margin: float) -> Flags:
    one, other = pairs.T
    return np.asarray((low[one] + margin <= high[other]).all(axis=1) & (low[other] + margin <= high[one]).all(axis=1))


def _cross(corners: Points, pairs: Indices, margin: float) -> Flags:
    """Tell of pairs of triangles whether an edge of one goes through the other."""
    found = np.zeros(len(pairs), dtype=bool)
    for start in range(0, len(pairs), _PAIRS):
        chunk = slice(start, start + _PAIRS)
        one, other = corners[pairs[chunk, 0]], corners[pairs[chunk, 1]]
        found[chunk] = _goes_through(one, other, margin) | _goes_through(other, one, margin)
    return found


def _goes_through(edges_of: Points, through: Points, margin: float) -> Flags:
    """Tell whether an edge of the first triangles (n, 3, 3) goes through the inside of the second ones."""
    a, b, c = np.moveaxis(through, 1, 0)
    normal = np.cross(b - a, c - a)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    height = np.einsum("nki,ni->nk", edges_of - a[:, None], normal)
    crosses = np.zeros(len(a), dtype=bool)
    for k in range(3):
        low, high = height[:, k], height[:, (k + 1) % 3]
        is_across = (np.minimum(low, high) < -margin) & (np.maximum(low, high) > margin)
        share = np.where(is_across, low / np.where(is_across, low - high, 1.0), 0.0)
        point = edges_of[:, k] + share[:, None] * (edges_of[:, (k + 1) % 3] - edges_of[:, k])
        inside = is_across
        for start, end in ((a, b), (b, c), (c, a)):
            side = np.cross(normal, end - start)
            length = np.maximum(np.linalg.norm(side, axis=1), 1e-300)
            inside = inside & (np.einsum("ni,ni->n", point - start, side) > margin * length)
        crosses |= inside
    return crosses
