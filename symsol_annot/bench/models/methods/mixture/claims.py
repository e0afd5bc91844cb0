"""From a density to what a classifier claims: the threshold at which the expected F-measure is highest.

Of a region {p > t} the density itself tells what to expect, from samples R_i of it in descending order of p: a share
j / n of the set's S members is inside, and the region's volume, sum_{i <= j} 1 / p_i / n of SO(3), holds that share of
the N rotations of the grid. So

    E[F](j) = 2 (j / n) S / ((j / n) S + N / n sum_{i <= j} 1 / p_i + S).

Of a set that fills a volume, S of the N rotations are members themselves, and the first term of the denominator, which
counts members beside the grid, is left out.

The claim is sigmoid(ln p(R) - ln t + ln 4), which is above 0.8 where p > t.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD

CLAIM_LOGIT = float(np.log(STANDARD_THRESHOLD / (1.0 - STANDARD_THRESHOLD)))  # ln 4
Floats = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Calibration:
    """What is fitted on validation images alone, so that claims hold what they say.

    Attributes:
        precision: the factor of all precisions of the pose's density.
        axis_precision: that of the axis's.
        threshold: the factor of t.
        hidden_threshold: that of t for images that are taken to hide the marking.
        shown_logit: what is added to the logit that the marking shows.
    """

    precision: float = 1.0
    axis_precision: float = 1.0
    threshold: float = 1.0
    hidden_threshold: float = 1.0
    shown_logit: float = 0.0

    @classmethod
    def from_record(cls, known: Mapping[str, float]) -> "Calibration":
        """Return the calibration that a record holds; what it lacks is as without one."""
        return cls(**{field.name: known[field.name] for field in fields(cls) if field.name in known})

    def to_record(self) -> dict[str, float]:
        """Return it by names, for a record."""
        return asdict(self)


def best_threshold(
    log_p: npt.NDArray[Any], members: float, cells: int, *, has_volume: bool = False
) -> tuple[float, float]:
    """Return ln t, and the F-measure to be expected there.

    Args:
        log_p: (n,) ln p at samples of p.
        members: S.
        cells: N.
        has_volume: whether the set fills a volume.
    """
    descending = np.sort(log_p)[::-1].astype(np.float64)
    share = np.arange(1, len(descending) + 1) / len(descending)
    claimed = cells * np.cumsum(np.exp(-descending)) / len(descending)
    f = 2.0 * share * members / ((0.0 if has_volume else share * members) + claimed + members)
    best = int(f.argmax())
    return float(descending[best]), float(f[best])


def f_measure(
    at_members: npt.NDArray[Any], on_grid: npt.NDArray[Any], log_t: Floats, set_size: int | None = None
) -> Floats:
    """Return the F-measures (k,) of thresholds ln t (k,).

    Args:
        at_members: (S,) ln p.
        on_grid: (m,) ln p of grid rotations, of all that are above any of the thresholds.
        log_t: the thresholds.
        set_size: S, where `at_members` has not all of the set but all that are above any of the thresholds.
    """
    true = (at_members[:, None] > log_t).sum(axis=0)
    false = (on_grid[:, None] > log_t).sum(axis=0)
    return np.asarray(2.0 * true / (true + false + (set_size or len(at_members))))
