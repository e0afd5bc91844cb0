"""Do a classifier's answers look like a distribution over rotations, where each should stand for itself?

A softmax over the queries, or over the grid, gives answers that add up to 1. No rotation of a set of hundreds can then
be claimed, whatever the method knows, and all its figures are 0.
"""

from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.rotations.grid import grid_size

_LEAST_IMAGES = 10
_SUM_TOLERANCE = 1e-2  # of a sum that is 1: float16 answers are off by less
_NEARLY_ALL = 0.9  # of the images
_GRID_FACTOR = 3.0  # the sum over the grid is estimated from random rotations
_MEND = (
    f"A rotation is claimed where its own probability of being in the set is above {STANDARD_THRESHOLD}: divide each "
    "image's answers by their largest, train a probability per rotation, or send the distribution in as a density "
    "(`write_density`); see docs/metrics.md"
)


class NormalisationTried:
    """What the answers at an image's queries add up to, and the largest of them, image by image."""

    def __init__(self, grid_level: int) -> None:
        self._grid_size = grid_size(grid_level)
        self._sums: list[float] = []
        self._largest: list[float] = []
        self._of_decoys: list[float] = []  # their mean

    def add(self, asked: npt.NDArray[Any]) -> None:
        """Take an image's answers (9, G), of which the first row is at its candidates, the others at decoys."""
        self._sums.append(float(asked.sum(dtype=np.float64)))
        self._largest.append(float(asked.max()))
        self._of_decoys.append(float(asked[1:].mean(dtype=np.float64)))

    def seen(self) -> npt.NDArray[np.float64]:
        """Return what was taken of the images, (3, n)."""
        return np.array([self._sums, self._largest, self._of_decoys], dtype=np.float64)

    def see(self, seen: npt.NDArray[np.float64]) -> None:
        """Take what was taken of other images elsewhere, (3, n)."""
        for mine, theirs in zip((self._sums, self._largest, self._of_decoys), seen.tolist(), strict=True):
            mine.extend(theirs)

    def notes(self) -> tuple[str, ...]:
        """Return a line where hardly anything is claimed and the answers add up to 1."""
        sums, largest = np.array(self._sums), np.array(self._largest)
        if len(sums) < _LEAST_IMAGES or np.median(largest) > STANDARD_THRESHOLD:
            return ()
        if (np.abs(sums - 1.0) <= _SUM_TOLERANCE).mean() >= _NEARLY_ALL:
            found = f"the answers at an image's queries add up to {np.median(sums):.3f}, the largest of them being "
            found += f"{np.median(largest):.2g} (medians over images): they look normalised over the queries."
            return (f"{found} {_MEND}",)
        over_grid = self._grid_size * float(np.mean(self._of_decoys))
        is_one = 1.0 / _GRID_FACTOR <= over_grid <= _GRID_FACTOR
        if is_one and (largest <= STANDARD_THRESHOLD).all():
            found = (
                f"no answer at a query is above {largest.max():.2g}, and if all {self._grid_size:,} of the grid are "
            )
            found += f"answered as the decoys are, an image's answers add up to {over_grid:.2g}: they look normalised "
            found += "over the grid."
            return (f"{found} {_MEND}",)
        return ()
