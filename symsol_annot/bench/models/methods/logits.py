"""Logits of a split's images, which are asked about in their order, by models that score rotations one by one."""

from functools import cached_property
from threading import Lock

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.embedded import BLOCK, embedded_blocks
from symsol_annot.bench.models.methods.method import Asked
from symsol_annot.bench.models.networks.answers import RotationScorer
from symsol_annot.bench.models.networks.rotation_classifier import RotationClassifier
from symsol_annot.errors import ModelError
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

_EMBEDDED_AT_ONCE = 64  # images
_SHARES_AT_ONCE = 2**15  # rotations


class LogitsByIndex:
    """What a model says of the images of a split, at any rotations and on a grid.

    Args:
        model: that is asked.
        input_size: the side in pixels that its images are reduced to; 0 for images as they are.
        dataset: whose images they are.
        grid: R_m2c (N, 3, 3).
        asked: how its products are worked out.
    """

    def __init__(
        self, model: RotationClassifier, input_size: int, dataset: Dataset, grid: Rotations, asked: Asked
    ) -> None:
        self._model, self._grid, self._lock = model, grid, Lock()
        self._scorer = RotationScorer(model, asked.products, is_compiled=asked.is_compiled)
        self._embeddings_in = embedded_blocks(model, dataset, input_size, _EMBEDDED_AT_ONCE)

    def at(self, i: int, R: Rotations) -> Tensor:
        """Return the logits (n,) of an image at rotations R_m2c (n, 3, 3).

        Raises:
            ModelError: they are not finite.
        """
        return self._logits(i, self._shares(R))

    def on_grid(self, i: int) -> Tensor:
        """Return the logits (N,) of an image on the grid.

        Raises:
            ModelError: they are not finite.
        """
        with self._lock:  # images are asked about in several threads, and from Python 3.12 on the property has no lock
            shares = self._shares_of_grid
        return self._logits(i, shares)

    @cached_property
    def _shares_of_grid(self) -> Tensor:
        """What the grid's rotations bring to the second stage, worked out once for all images."""
        return self._shares(self._grid)

    def _logits(self, i: int, shares: Tensor) -> Tensor:
        found = self._scorer.logits(self._embeddings_in(i // BLOCK)[i % BLOCK], shares)
        if not found.isfinite().all():
            raise ModelError(f"image {i}: the model's answers are not finite; its weights are of no use, train it anew")
        return found

    @torch.no_grad()
    def _shares(self, R: Rotations) -> Tensor:
        parts = torch.split(torch.from_numpy(R.astype(np.float32)).to(self._model.device), _SHARES_AT_ONCE)
        return torch.cat([self._model.shares(part) for part in parts])
