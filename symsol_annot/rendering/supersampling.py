"""From a frame, of one unmixed colour for each point of the camera's lattice, to a view.

Picture, segmentation and the marking's area come from the same frame, so they cannot contradict each other.
"""

import numpy as np
import numpy.typing as npt

from symsol_annot.rendering.renderer import MARKING, View

Bytes = npt.NDArray[np.uint8]


def view_of(colours: Bytes, ids: Bytes, n: int) -> View:
    """Return the view of a frame.

    Args:
        colours: (n H + 1, n W + 1, 3) in sRGB, for the points that `Camera.lattice` has.
        ids: (n H + 1, n W + 1) what lies at each of these points.
        n: the lattice's points per axis of a pixel, even.
    """
    marking_pixels = int(np.count_nonzero(ids == MARKING)) / n**2
    return View(pixel_averages(colours, n), np.ascontiguousarray(ids[n // 2 :: n, n // 2 :: n]), marking_pixels)


def pixel_averages(colours: Bytes, n: int) -> Bytes:
    """Average over each pixel's square by the trapezoidal rule: (n H + 1, n W + 1, C) to (H, W, C), halves rounded up.

    Of a pixel's (n + 1)^2 points, those on its edges count half and those on its corners a quarter.
    """
    rows = _twice_trapezoids(colours.astype(np.uint16), n)
    sums = _twice_trapezoids(rows.swapaxes(0, 1), n).swapaxes(0, 1)
    return np.ascontiguousarray((sums + 2 * n * n) // (4 * n * n), dtype=np.uint8)


def _twice_trapezoids(values: npt.NDArray[np.uint16], n: int) -> npt.NDArray[np.uint16]:
    """Return 2 n times the average of each n + 1 neighbours along the first axis, the two outer ones at half weight."""
    sums = values[:-1:n] + values[n::n]
    for k in range(1, n):
        sums += 2 * values[k::n]
    return sums
