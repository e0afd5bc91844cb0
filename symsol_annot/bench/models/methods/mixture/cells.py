"""The equivolumetric grid as mixtures use it: tensors, axes, the size of its cells, and the density of poses on it."""

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.networks.mixtures import PoseMixture
from symsol_annot.rotations.grid import grid_index, grid_size

_SAME = 6  # decimals to which axes are compared
_NARROW_RAD = 0.5  # beyond which a narrow component's share is nothing


class Grid:
    """The equivolumetric grid of a level as tensors, and what is found on it."""

    def __init__(self, level: int) -> None:
        self.index = grid_index(level)
        self.level = level
        self.rotations = torch.from_numpy(self.index.rotations).float()
        cell = (8.0 * np.pi**2 / grid_size(level)) ** (1.0 / 3.0)  # the side of a cube of a cell's volume, in rad
        self.blur_rad = cell / np.sqrt(12.0)  # the deviation of a uniform distribution on it, along a side

    def __len__(self) -> int:
        return len(self.rotations)

    @lru_cache(maxsize=4)  # noqa: B019 - grids are few, and live as long as the program
    def axes(self, axis: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
        """Return the distinct axes R a (k, 3) of the grid, and which of them each of its rotations has (N,)."""
        rounded = (self.rotations @ torch.tensor(axis)).numpy().round(_SAME) + 0.0
        distinct, which = np.unique(rounded, axis=0, return_inverse=True)
        return torch.from_numpy(distinct), torch.from_numpy(which.reshape(-1))

    @torch.no_grad()
    def log_density(self, mixture: PoseMixture, log_least: float) -> Tensor:
        """Return ln p (N,), relative to uniform, of the only image of a mixture, nearly.

        At an angle a from a component's centre H, ln of its share is at most that at H less k (1 - cos a), with k the
        least eigenvalue of its precision K. Where that is below `log_least`, the share is left out.
        """
        precisions = mixture.roots[0] @ mixture.roots[0].mT
        fall = (mixture.log_peaks[0] - log_least) / torch.linalg.eigvalsh(precisions)[:, 0]
        is_narrow = fall < 1.0 - np.cos(_NARROW_RAD)
        found = mixture.chosen(~is_narrow).of_image(self.rotations)
        narrow = mixture.chosen(is_narrow & (fall > 0.0))
        if not narrow.components:
            return found
        angles = torch.arccos(1.0 - fall[is_narrow & (fall > 0.0)]).double().numpy()
        which, where = self.index.each_within(narrow.centres[0].double().numpy(), angles)
        log_shares = narrow.log_shares_of(torch.from_numpy(which), self.rotations[where])
        highest = float(narrow.log_peaks.max())
        shares = np.bincount(where, weights=(log_shares.double() - highest).exp().numpy(), minlength=len(self))
        with np.errstate(divide="ignore"):
            return torch.logaddexp(found, torch.from_numpy(np.log(shares) + highest).float())


@lru_cache(maxsize=2)
def grid_of(level: int) -> Grid:
    """Return the grid of a level, made once."""
    return Grid(level)
