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
        self._tilts = 6 * 2**level
        three_times_round = torch.arange(-self._tilts, 2 * self._tilts)
        angle = three_times_round.double() * (2.0 * np.pi / self._tilts)
        self._cosines, self._sines = angle.cos().float(), angle.sin().float()
        self._starts = three_times_round % self._tilts * (len(self) // self._tilts)  # of a tilt's rotations

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
        uniform = mixture.log_weights[0, -1].double().exp()
        if not mixture.components:
            return uniform.expand(len(self)).numpy()
        tilts, steps_per_rad = self._tilts, self._tilts / (2.0 * np.pi)
        forms = mixture.along_third_axis(self.rotations[: len(self) // tilts])  # the directions, with the tilt 0
        r = torch.hypot(forms[0], forms[1])
        place = torch.nonzero((forms[2] + r > log_least).flatten())[:, 0]
        a, b, c, r = (of_all.flatten()[place] for of_all in (*forms, r))
        reach = torch.arccos(((log_least - c) / r).clamp(-1.0, 1.0)) * steps_per_rad
        middle = torch.atan2(b, a) * steps_per_rad
        first = torch.ceil(middle - reach).long()
        count = (torch.floor(middle + reach).long() - first + 1).clamp(max=tilts)

        direction = torch.div(place, mixture.components, rounding_mode="floor")
        component = place - direction * mixture.components
        reached = torch.bincount(component, count.double(), mixture.components)
        is_broad = reached > _BROAD * len(self)
        found = uniform.expand(len(self)).clone()
        if is_broad.any():
            found = mixture.chosen(is_broad).of_image(self.rotations).double().exp()
            count[is_broad[component]] = 0

        which = torch.repeat_interleave(count)
        at = torch.arange(len(which)) + (first + tilts - torch.cumsum(count, 0) + count)[which]  # in what goes round
        shares = torch.addcmul(torch.addcmul(c[which], a[which], self._cosines[at]), b[which], self._sines[at]).exp_()
        return found.index_add_(0, self._starts[at] + direction[which], shares.double()).numpy()


@lru_cache(maxsize=2)
def grid_of(level: int) -> Grid:
    """Return the grid of a level, made once."""
    return Grid(level)
