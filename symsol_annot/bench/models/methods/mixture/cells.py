"""The equivolumetric grid as mixtures use it: tensors, axes, the size of its cells, and the density of poses on it."""

from functools import lru_cache

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.networks.mixtures import PoseMixture
from symsol_annot.rotations.grid import grid_index, grid_size

_SAME = 6  # decimals to which axes are compared
_BROAD = 0.2  # of the grid: a component that reaches more of it is worked out everywhere

Floats = npt.NDArray[np.float64]


class Grid:
    """The equivolumetric grid of a level as tensors, and what is found on it."""

    def __init__(self, level: int) -> None:
        self.index = grid_index(level)
        self.level = level
        self.rotations = torch.from_numpy(self.index.rotations).float()
        cell = (8.0 * np.pi**2 / grid_size(level)) ** (1.0 / 3.0)  # the side of a cube of a cell's volume, in rad
        self.blur_rad = cell / np.sqrt(12.0)  # the deviation of a uniform distribution on it, along a side
        tilts = np.arange(6 * 2**level) * (2.0 * np.pi / (6 * 2**level))
        self._cosines, self._sines = np.cos(tilts).astype(np.float32), np.sin(tilts).astype(np.float32)

    def __len__(self) -> int:
        return len(self.rotations)

    @lru_cache(maxsize=4)  # noqa: B019 - grids are few, and live as long as the program
    def axes(self, axis: tuple[float, float, float]) -> tuple[Tensor, Tensor]:
        """Return the distinct axes R a (k, 3) of the grid, and which of them each of its rotations has (N,)."""
        rounded = (self.rotations @ torch.tensor(axis)).numpy().round(_SAME) + 0.0
        distinct, which = np.unique(rounded, axis=0, return_inverse=True)
        return torch.from_numpy(distinct), torch.from_numpy(which.reshape(-1))

    @torch.no_grad()
    def density(self, mixture: PoseMixture, log_least: float) -> Floats:
        """Return p (N,), relative to uniform, of the only image of a mixture, nearly.

        ln of a component's share is linear in the rotation, so over the tilts t of one direction it is
        c + a cos t + b sin t. The tilts at which that is above `log_least` are neighbours, and for most directions
        there are none; the shares elsewhere are left out.
        """
        if not mixture.components:
            return np.full(len(self), float(mixture.log_weights[0, -1].exp()))
        tilts = len(self._cosines)
        forms = mixture.along_third_axis(self.rotations[: len(self) // tilts])  # the directions, with the tilt 0
        place = torch.nonzero((forms[2] + torch.hypot(forms[0], forms[1]) > log_least).flatten())[:, 0]
        a, b, c = (form.flatten()[place].numpy() for form in forms)
        reach = np.arccos(np.clip((log_least - c) / np.hypot(a, b), -1.0, 1.0)) * (tilts / (2.0 * np.pi))
        middle = np.arctan2(b, a) * (tilts / (2.0 * np.pi))
        first = np.ceil(middle - reach).astype(np.int64)
        count = np.minimum(np.floor(middle + reach).astype(np.int64) - first + 1, tilts)

        direction, component = np.divmod(place.numpy(), mixture.components)
        reached = np.bincount(component, weights=count, minlength=mixture.components)
        is_broad = reached > _BROAD * len(self)
        found = mixture.chosen(torch.from_numpy(is_broad)).of_image(self.rotations).double().exp().numpy()
        count[is_broad[component]] = 0

        which = np.repeat(np.arange(len(count)), count)
        tilt = (np.arange(len(which)) - np.repeat(np.cumsum(count) - count - first, count)) % tilts
        shares = np.exp(a[which] * self._cosines[tilt] + b[which] * self._sines[tilt] + c[which])
        found += np.bincount(tilt * (len(self) // tilts) + direction[which], weights=shares, minlength=len(self))
        return found


@lru_cache(maxsize=2)
def grid_of(level: int) -> Grid:
    """Return the grid of a level, made once."""
    return Grid(level)
