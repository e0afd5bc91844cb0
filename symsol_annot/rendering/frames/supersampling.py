"""From a frame, of one unmixed colour and one part's id for each point of the camera's lattice, to a view.

Picture, segmentation and the parts' areas come from the same frame, so they cannot contradict each other.
"""

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RenderError
from symsol_annot.rendering.renderer import BACKGROUND

Bytes = npt.NDArray[np.uint8]
Lanes = npt.NDArray[np.uint64]

_EACH_LANE = np.uint64(0x0001_0001_0001)


def lanes_of(colours: Bytes) -> Lanes:
    """Return colours (..., 3) as one number (...) each: red, green and blue in its 16-bit lanes, from the lowest.

    So the three are added at once; sums of up to 257 colours fit.
    """
    lanes = np.zeros((*colours.shape[:-1], 4), "<u2")
    lanes[..., :3] = colours
    return lanes.view("<u8")[..., 0].astype(np.uint64, copy=False)


def pixel_averages(colours: Lanes, n: int) -> Bytes:
    """Average over each pixel's square by the trapezoidal rule: (n H + 1, n W + 1) to (H, W, 3), halves rounded up.

    Of a pixel's (n + 1)^2 points, those on its edges count half and those on its corners a quarter. The result is a
    view of every second byte of another array.
    """
    rows = _twice_trapezoids(colours[:-1:n], colours[n::n], [colours[k::n] for k in range(1, n)])
    sums = _twice_trapezoids(rows[:, :-1:n], rows[:, n::n], [rows[:, k::n] for k in range(1, n)])
    sums += np.uint64(2 * n * n) * _EACH_LANE
    if n == 6:  # 144 is no power of 2
        averages = (sums.view("<u2") // np.uint16(4 * n * n)).view("<u8")
    else:
        averages = (sums >> np.uint64(2 * n.bit_length())) & (np.uint64(255) * _EACH_LANE)
    return averages.view(np.uint8).reshape(*averages.shape, 8)[..., 0:6:2]


def segmentation_of(ids: Bytes, n: int) -> Bytes:
    """Return what lies at each pixel's centre: (n H + 1, n W + 1) ids to (H, W)."""
    return np.ascontiguousarray(ids[n // 2 :: n, n // 2 :: n])


def part_pixels_of(ids: Bytes, n: int, parts: int) -> npt.NDArray[np.float64]:
    """Return each part's visible area (P,) in pixels: the lattice points that show it, over those per pixel.

    Raises:
        RenderError: there is an id of no part, or none of any.
    """
    refuse_strays(int(ids.max()), parts)
    counts = [int(np.count_nonzero(ids == part)) for part in range(BACKGROUND + 1, parts + 1)]
    if not any(counts):
        raise RenderError("a frame came back empty: the object is not in it")
    return np.array(counts, dtype=np.float64) / n**2


def refuse_strays(highest: int, parts: int) -> None:
    """Refuse a frame by the highest id in it.

    Raises:
        RenderError: it is the id of no part.
    """
    if highest > parts:
        raise RenderError(
            f"Blender drew ids of no part, {highest} the highest of 0 to {parts}: the frame has no segmentation. "
            "Finished shards are kept. Please report this, with the command you gave"
        )


def _twice_trapezoids(first: Lanes, last: Lanes, between: list[Lanes]) -> Lanes:
    """Return 2 n times the average of n + 1 neighbours, the first and the last at half weight."""
    doubled = between[0].copy()
    for values in between[1:]:
        doubled += values
    doubled <<= np.uint64(1)
    doubled += first
    doubled += last
    return doubled
