"""From which directions a body's marking is hidden, as a mixture's view network tells it."""

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.mixture.body import Body
from symsol_annot.bench.models.methods.mixture.cells import Grid
from symsol_annot.bench.models.networks.mixture_network import MixtureNetwork

_TILTS, _TURNS = 181, 720  # at which the share of views that hide the marking is known


class MarkingViews:
    """From which directions the marking is hidden, and how large their share is at each tilt of the axis."""

    def __init__(self, model: MixtureNetwork, body: Body) -> None:
        self._hides, self._axis = model.hides_on_cpu(), body.axis
        tilts = torch.linspace(0.0, np.pi, _TILTS)
        turns = torch.arange(_TURNS) * (2.0 * np.pi / _TURNS)
        across, also = torch.linalg.svd(body.axis[None])[2][1:]
        directions = tilts.cos()[:, None, None] * body.axis + tilts.sin()[:, None, None] * (
            turns.cos()[:, None] * across + turns.sin()[:, None] * also
        )
        share = torch.sigmoid(self._hides(directions)).mean(1)
        self._log_share = (share if body.is_directed else 0.5 * (share + share.flip(0))).log()

    @lru_cache(maxsize=1)  # noqa: B019 - as long as the densities of one model are asked for
    def log_relative_on(self, grid: Grid) -> Tensor:
        """Return `log_relative` (N,) at a grid's rotations, the same for all images."""
        return self.log_relative(grid.rotations)

    def logit(self, R: Tensor) -> Tensor:
        """Return logits (n,) that the marking is hidden at rotations (n, 3, 3)."""
        return self._hides(R[:, 2])

    def log_relative(self, R: Tensor) -> Tensor:
        """Return ln of h(R) over its mean over the body's group (n,)."""
        tilt = torch.acos((R[:, 2] @ self._axis).clamp(-1.0, 1.0)) * ((_TILTS - 1) / np.pi)
        return torch.nn.functional.logsigmoid(self.logit(R)) - self._log_share[tilt.round().long()]
