"""What a metric is: its value, weight, direction, equation and title, and where it is shown.

Tables, the leaderboard's columns and order, `compare`, and what scores.json lists of each image follow from here.
"""

from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Generic, TypeVar

import numpy as np
import numpy.typing as npt

HIGHER, LOWER, NEITHER = "higher", "lower", ""  # is better
LEAST_DECIMALS, MOST_DECIMALS = 5, 12  # that scores.json may have of each image's figures
_ARROWS = {HIGHER: " ↑", LOWER: " ↓", NEITHER: ""}

Values = npt.NDArray[np.float64]
M = TypeVar("M")  # what a track's metrics are computed from


class Place(IntEnum):
    """Where metrics are shown; a metric that is shown in one place is shown in those before as well."""

    FILE = 0  # scores.json alone
    TABLES = 1  # of `score`, of `compare`, and each image's figures
    LEADERBOARD = 2
    SUMMARY = 3  # of all objects


@dataclass(frozen=True)
class Metric(Generic[M]):
    """A metric of a track. A track lists its metrics in the order that scores.json has them in.

    Attributes:
        name: in scores.json.
        better: "higher", "lower", or "" where neither is.
        place: the last one that shows it.
        value: from what was measured of b images to the metric of each, (b,), NaN where an image does not define it;
            None where the file or the object does not.
        words: what it is, in tables.
        equation: of the thesis; empty where docs/metrics.md alone defines it.
        row: tables show the metrics in ascending order of it.
        is_pooled: whether an image weighs |S|, so that every member of every set weighs the same; else 1.
        is_detail: whether it is a variant of the metric in the row before it, below which tables indent it.
    """

    name: str
    better: str
    place: Place
    value: Callable[[M], Values | None]
    words: str
    equation: str = ""
    row: int = 0
    is_pooled: bool = False
    is_detail: bool = False

    @property
    def title(self) -> str:
        """The words with the equation."""
        return f"{self.words} ({self.equation})" if self.equation else self.words

    @property
    def label(self) -> str:
        """The title as it stands in a column of titles."""
        return f"  {self.title}" if self.is_detail else self.title

    @property
    def arrow(self) -> str:
        """A blank and an arrow to the better side; empty where neither is better."""
        return _ARROWS[self.better]

    def weights(self, values: Values, set_sizes: npt.NDArray[np.int64]) -> Values:
        """Return what each image weighs in a stratum's figure.

        Args:
            values: (b,) of the images.
            set_sizes: (b,) how many members their symmetry sets have.

        Returns:
            (b,): |S| or 1, and 0 where the value is undefined.
        """
        return np.where(np.isnan(values), 0.0, set_sizes if self.is_pooled else 1.0)
