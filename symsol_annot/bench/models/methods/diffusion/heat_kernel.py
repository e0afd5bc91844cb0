"""Brownian noise on SO(3): how far it turns a rotation, and the slope of its density (Leach et al., ICLR-W 2022).

A rotation R that has wandered for a while is R exp(theta n), with a uniform axis n and an angle of the heat kernel's
density

    f(theta) = sum_l (2 l + 1) exp(-l (l + 1) sigma^2 / 2) sin((l + 1/2) theta) / sin(theta / 2),

relative to uniform, in which angles have the density (1 - cos theta) / pi. Its deviation is sigma about each axis where
that is small. The score is the gradient of ln f: d ln f / d theta along n, seen from the turned rotation.
"""

import math
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.diffusion.noise_levels import LEVELS, Floats, deviations, level_shares

_ANGLES, _QUANTILES = 4096, 1024
_TERMS = 40  # of the series, for deviations of _SERIES_FROM_RAD or more; the last is below 1e-80
_SERIES_FROM_RAD = 0.5  # below, the kernel is a normal distribution's to 1e-8


class HeatKernel:
    """The heat kernel at all levels of noise, in tables on a device.

    Args:
        device: of the tables.
        median_rad: the deviation that half of what is drawn lies below, see `level_shares`; 0 for all levels alike.
        spread: of the deviation's logarithm.

    Attributes:
        sigma: (128,) deviations in rad, ascending.
    """

    def __init__(self, device: torch.device, median_rad: float = 0.0, spread: float = 1.0) -> None:
        quantiles, slopes = _tables()
        self.sigma = torch.from_numpy(deviations()).float().to(device)
        self._shares = torch.from_numpy(level_shares(median_rad, spread)).float().to(device)
        self._quantiles = torch.from_numpy(quantiles).float().to(device)
        self._slopes = torch.from_numpy(slopes).float().to(device)

    def draw(self, shape: tuple[int, ...], rng: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """Draw noise at random levels.

        Returns:
            The levels' indices (*shape,), rotation vectors (*shape, 3) in rad, and sigma times the score there
            (*shape, 3).
        """
        device = rng.device
        level = torch.multinomial(self._shares, math.prod(shape), replacement=True, generator=rng).reshape(shape)
        place = torch.rand(shape, generator=rng, device=device) * (_QUANTILES - 1)
        below = place.long().clamp(max=_QUANTILES - 2)
        part = place - below
        angle, slope = (
            torch.lerp(table[level, below], table[level, below + 1], part) for table in (self._quantiles, self._slopes)
        )
        axis = torch.nn.functional.normalize(torch.randn((*shape, 3), generator=rng, device=device), dim=-1)
        return level, axis * angle[..., None], axis * slope[..., None]


@lru_cache(maxsize=1)
def _tables() -> tuple[Floats, Floats]:
    """Return the angles (L, Q) at evenly spaced shares of the noise, and sigma times the slope of ln f there."""
    sigmas = deviations()
    quantiles, slopes = np.empty((2, LEVELS, _QUANTILES))
    shares = (np.arange(_QUANTILES) + 0.5) / _QUANTILES
    for level, sigma in enumerate(sigmas):
        reach = min(np.pi, 8.0 * sigma)
        angles = (np.arange(_ANGLES) + 0.5) * (reach / _ANGLES)
        density = kernel(angles, sigma) * (1.0 - np.cos(angles))
        below = np.cumsum(density) - 0.5 * density
        quantiles[level] = np.interp(shares, below / density.sum(), angles)
        slopes[level] = sigma * slope(quantiles[level], sigma)
    return quantiles, slopes


def kernel(angle: Floats, sigma: float) -> Floats:
    """Return f (n,) at angles (n,) in rad above 0, for a deviation in rad; up to a factor where that is below 0.5."""
    if sigma < _SERIES_FROM_RAD:
        normal: Floats = np.exp(-0.5 * (angle / sigma) ** 2) * (angle / (2.0 * np.sin(angle / 2.0)))
        return normal
    return _series(angle, sigma)[0]


def slope(angle: Floats, sigma: float) -> Floats:
    """Return d ln f / d theta (n,) at angles (n,) in rad above 0, for a deviation in rad."""
    if sigma < _SERIES_FROM_RAD:
        normal: Floats = 1.0 / angle - 0.5 / np.tan(angle / 2.0) - angle / sigma**2
        return normal
    value, derivative = _series(angle, sigma)
    return derivative / value


def _series(angle: Floats, sigma: float) -> tuple[Floats, Floats]:
    """Return f and its derivative (n,)."""
    terms = np.arange(_TERMS)
    weights = (2 * terms + 1) * np.exp(-0.5 * terms * (terms + 1) * sigma**2)
    half, order = angle / 2.0, terms[:, None] + 0.5
    above, below = np.sin(order * angle), np.sin(half)
    turned = order * np.cos(order * angle) / below - above * (0.5 * np.cos(half)) / below**2
    return weights @ (above / below), weights @ turned
