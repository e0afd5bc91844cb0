"""How large the noise of a diffusion on SO(3) is, and how often which."""

import numpy as np
import numpy.typing as npt

LEAST_RAD, MOST_RAD = 0.012, 2.0  # deviations; the last is uniform to 2%
LEVELS = 128  # of noise, by the same factor from one to the next

Floats = npt.NDArray[np.float64]


def deviations() -> Floats:
    """Return the deviations (128,) in rad, ascending."""
    return np.geomspace(LEAST_RAD, MOST_RAD, LEVELS)


def level_shares(median_rad: float, spread: float) -> Floats:
    """Return how much of the noise is drawn at each level (128,), in all 1.

    Args:
        median_rad: of a log-normal distribution of the deviation (Karras et al., NeurIPS 2022, eq. 5), which is cut off
            at the least and the most; 0 for all levels alike.
        spread: the standard deviation of the deviation's natural logarithm.
    """
    if not median_rad:
        return np.full(LEVELS, 1.0 / LEVELS)
    logarithm = -0.5 * (np.log(deviations() / median_rad) / spread) ** 2
    shares: Floats = np.exp(logarithm - logarithm.max())
    return shares / shares.sum()
