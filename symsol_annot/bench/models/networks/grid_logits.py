"""The logits of a network of rotations on the equivolumetric grid, worked out where they matter."""

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.networks.answers import logits_at
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.rotations.grid import equivolumetric_grid, grid_index

_SHARES_AT_ONCE = 2**15  # rotations
_MOST_SHARE = 0.5  # of the grid: to gather more than that takes longer than to ask everywhere


class GridLogits:
    """A network's logits on the grid of a level, for one image after another.

    The grid of the level below, with an eighth of the rotations, is asked first. Of the grid itself only rotations are
    asked whose nearest one there has a logit that could matter; the others take over that logit.

    Args:
        model: the network.
        level: of the grid.
    """

    def __init__(self, model: RotationClassifier, level: int) -> None:
        self._model = model
        self._shares = self._shares_of(level)
        self._below = self._shares_of(level - 1) if level else None
        nearest = grid_index(level - 1).nearest(equivolumetric_grid(level)) if level else np.zeros(0, dtype=np.int64)
        self._nearest = torch.from_numpy(nearest).to(model.device)

    @torch.no_grad()
    def _shares_of(self, level: int) -> Tensor:
        grid = torch.from_numpy(equivolumetric_grid(level)).float().to(self._model.device)
        return torch.cat([self._model.shares(part) for part in torch.split(grid, _SHARES_AT_ONCE)])

    def above(self, embedding: Tensor, least: float) -> Tensor:
        """Return the logits (N,) of one embedded image (E,), worked out where they are about `least` or more."""
        if self._below is None:
            return self.everywhere(embedding)
        return self._refined(embedding, logits_at(self._model, embedding, self._below), least)

    def below_highest(self, embedding: Tensor, depth: float) -> Tensor:
        """Return the logits (N,) of one embedded image (E,), worked out down to so much below the highest."""
        if self._below is None:
            return self.everywhere(embedding)
        below = logits_at(self._model, embedding, self._below)
        return self._refined(embedding, below, float(below.max()) - depth)

    def everywhere(self, embedding: Tensor) -> Tensor:
        """Return the logits (N,) of one embedded image (E,), all worked out."""
        return logits_at(self._model, embedding, self._shares)

    def _refined(self, embedding: Tensor, below: Tensor, least: float) -> Tensor:
        found = below[self._nearest]
        matter = (found >= least).nonzero()[:, 0]
        if len(matter) > _MOST_SHARE * len(found):
            return self.everywhere(embedding)
        if len(matter):
            found[matter] = logits_at(self._model, embedding, self._shares[matter]).to(found.dtype)
        return found
