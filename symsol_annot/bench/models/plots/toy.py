"""Points of a plane in the place of hypotheses, pulled by modes under each meta loss (figures 4.2 to 4.4)."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.loss_tables import META_LOSSES

Points = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Stage:
    """Steps of gradient descent under one meta loss.

    Attributes:
        title: of the meta loss.
        meta_loss: of losses (n, M).
        winners: how many hypotheses a mode pulls.
        steps: how many.
        rate: of the descent.
        pulls_all: whether a mode pulls all other hypotheses too, a little.
    """

    title: str
    meta_loss: Callable[[Tensor], Tensor]
    winners: int
    steps: int
    rate: float
    pulls_all: bool = False


@dataclass(frozen=True)
class Toy:
    """Modes (n, 2) of equal probability, where M hypotheses (M, 2) begin, and the stages that they go through."""

    figure: str
    modes: Points
    start: Points
    stages: tuple[Stage, ...]


def converge(hypotheses: Points, modes: Points, stage: Stage) -> Points:
    """Return where hypotheses (M, 2) are after a stage: the mean over the modes of their meta loss, descended.

    The embedded loss is the squared distance, whose mean over modes is least at their average (eq. 4.9).
    """
    at, targets = torch.from_numpy(hypotheses), torch.from_numpy(modes)
    for _ in range(stage.steps):
        at.requires_grad_()
        losses = (at - targets[:, None]).square().sum(dim=-1)
        (gradient,) = torch.autograd.grad(stage.meta_loss(losses).mean(), at)
        at = (at - stage.rate * gradient).detach()
    moved: Points = at.numpy()
    return moved


def positions(toy: Toy) -> list[Points]:
    """Return where the hypotheses (M, 2) of a toy begin, and where they are after each stage."""
    found = [toy.start]
    for stage in toy.stages:
        found.append(converge(found[-1], toy.modes, stage))
    return found


def winners(hypotheses: Points, modes: Points, count: int) -> npt.NDArray[np.intp]:
    """Return which hypotheses are the `count` nearest of each mode, (n, count)."""
    distances = np.linalg.norm(hypotheses - modes[:, None], axis=-1)
    return np.argsort(distances, axis=-1, kind="stable")[:, :count]


def _evolving(k: int, steps: int) -> Stage:
    return Stage(_EWTA.label(k=k), partial(_EWTA.function, k=k), k, steps, rate=0.05)


_WTA, _RWTA, _EWTA = (META_LOSSES[name] for name in ("wta", "rwta", "ewta"))
_CORNERS = np.array([(0.45, 0.90), (0.10, 0.10), (0.90, 0.10)])

TOYS = (
    Toy(  # two modes share a winner, two hypotheses win nothing
        "4.2",
        modes=np.array([(0.15, 0.80), (0.45, 0.85), (0.85, 0.75), (0.75, 0.20)]),
        start=np.array([(0.30, 0.62), (0.78, 0.58), (0.60, 0.32), (0.18, 0.20), (0.46, 0.45)]),
        stages=(Stage(_WTA.title, _WTA.function, 1, 100, rate=0.25),),
    ),
    Toy(  # those that win nothing meet half way
        "4.3",
        modes=_CORNERS,
        start=np.array([(0.55, 0.70), (0.20, 0.30), (0.80, 0.25), (0.15, 0.65), (0.92, 0.60), (0.50, 0.05)]),
        stages=(Stage(_RWTA.title, _RWTA.function, 1, 600, rate=1.0, pulls_all=True),),
    ),
    Toy(  # at first all meet; then each mode lets go of those far from it
        "4.4",
        modes=_CORNERS,
        start=np.array(
            [
                *((0.13, 0.32), (0.20, 0.25), (0.81, 0.30), (0.75, 0.22)),
                *((0.28, 0.67), (0.33, 0.70), (0.63, 0.65), (0.64, 0.73)),
            ]
        ),
        stages=(_evolving(8, 60), _evolving(4, 150), _evolving(2, 300)),
    ),
)
