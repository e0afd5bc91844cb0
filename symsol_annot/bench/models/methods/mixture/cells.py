"""The equivolumetric grid as mixtures use it: tensors, the axes that its rotations have, and the size of its cells."""

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from symsol_annot.rotations.grid import grid_index, grid_size

_SAME = 6  # decimals to which axes are compared


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


@lru_cache(maxsize=2)
def grid_of(level: int) -> Grid:
    """Return the grid of a level, made once."""
    return Grid(level)
