"""Pictures of the losses: figures 4.5, A.1 and A.2 as curves, figures 4.2 to 4.4 as a toy that converges."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from symsol_annot.bench.models.loss_tables import EMBEDDED_LOSSES
from symsol_annot.bench.models.losses import CONCENTRATION
from symsol_annot.bench.models.plots.toy import TOYS, Points, Stage, Toy, positions, winners
from symsol_annot.plotting.canvas import SERIES, legend_below, legend_mark, new_figure, write_figure
from symsol_annot.rotations.groups import Z_AXIS
from symsol_annot.rotations.so3 import Angles, rotations_about

LossOfRotations = Callable[[Tensor, Tensor], Tensor]

_STEEP = 16.0  # figure A.2b, whose value the thesis does not tell: two minima, where 4 has one
_HYPOTHESIS, _MODE = SERIES[:2]
_CURVES_INCHES, _TOY_INCHES = (3.2, 2.4), (2.4, 2.5)


@dataclass(frozen=True)
class Curves:
    """Losses of a rotation about one axis, summed over the true rotations about it.

    Attributes:
        figure: its number in the thesis.
        truths_rad: the angles of the true rotations.
        losses: by their labels.
    """

    figure: str
    truths_rad: tuple[float, ...]
    losses: Mapping[str, LossOfRotations]


def _beside_von_mises(name: str, concentration: float = CONCENTRATION) -> dict[str, LossOfRotations]:
    """Return a loss and the von Mises loss, by their labels."""
    loss, von_mises = EMBEDDED_LOSSES[name], EMBEDDED_LOSSES["von-mises"]
    return {
        loss.label(): loss.function,
        von_mises.label(concentration=concentration): partial(von_mises.function, concentration=concentration),
    }


_WITH_GEODESIC = _beside_von_mises("geodesic")
_WITH_COSINE = _beside_von_mises("cyclic-cosine")
CURVES = (
    (Curves("4.5a", (np.pi,), _WITH_GEODESIC), Curves("4.5b", (2.0, 4.0), _WITH_GEODESIC)),
    (
        Curves("A.1a", (np.pi,), _WITH_COSINE),
        Curves("A.1b", (2.0, 4.0), _WITH_COSINE),
        Curves("A.1c", (1.0, 2.5, 4.5), _WITH_COSINE),
    ),
    (
        Curves("A.2a", (3.0, 3.75), _WITH_COSINE),
        Curves("A.2b", (3.0, 3.75), _beside_von_mises("cyclic-cosine", _STEEP)),
    ),
)


def summed_loss(angles_rad: Angles, truths_rad: Angles, loss: LossOfRotations) -> npt.NDArray[np.float64]:
    """Return the loss of rotations about one axis, summed over the true rotations about it (appendix A.1).

    Args:
        angles_rad: (n,) of the rotations.
        truths_rad: (t,) of the true ones.
        loss: of two rotations.

    Returns:
        (n,) losses.
    """
    R_p = torch.from_numpy(rotations_about(Z_AXIS, angles_rad))
    R_gt = torch.from_numpy(rotations_about(Z_AXIS, truths_rad))
    summed: npt.NDArray[np.float64] = loss(R_p[:, None], R_gt).sum(dim=-1).numpy()
    return summed


def plot_curves(path: Path) -> None:
    """Write figures 4.5, A.1 and A.2 as a picture, one row each.

    Raises:
        OutputError: the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    labels = list(dict.fromkeys(label for row in CURVES for shown in row for label in shown.losses))
    colours = dict(zip(labels, SERIES, strict=False))
    figure, cells = _rows_of_panels([len(row) for row in CURVES], _CURVES_INCHES)
    angles_rad = np.linspace(0.0, 2.0 * np.pi, 721)
    for row, curves in enumerate(CURVES):
        for column, shown in enumerate(curves):
            axes = cells(row, column)
            for name, loss in shown.losses.items():
                values = summed_loss(angles_rad, np.array(shown.truths_rad), loss)
                axes.plot(angles_rad, values, color=colours[name], linewidth=1.2, label=name)
            for truth in shown.truths_rad:
                axes.axvline(truth, color="0.6", linewidth=0.6, linestyle=":")
            axes.set_title(f"{shown.figure}: truth at {', '.join(f'{t:.3g}' for t in shown.truths_rad)}", fontsize=8)
            axes.set(xlim=(0.0, 2.0 * np.pi), ylim=(0.0, None))
            axes.tick_params(labelsize=7)
            axes.set_xlabel("rotation about the axis, rad", fontsize=8)
            if column == 0:
                axes.set_ylabel("loss, summed over\nthe true rotations", fontsize=8)
    lines = [legend_mark(label, colour, line="-") for label, colour in colours.items()]
    legend_below(figure, [*lines, legend_mark("true rotation", "0.6", line=":")], columns=5)
    write_figure(figure, path)


def plot_toys(path: Path) -> None:
    """Write figures 4.2 to 4.4 as a picture: where hypotheses begin, and where each stage takes them.

    Arrows lead from winners to their modes, pale ones from the other hypotheses that a mode pulls; lines border the
    Voronoi cells.

    Raises:
        OutputError: the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    panels = [1 + len(toy.stages) for toy in TOYS]
    figure, cells = _rows_of_panels([sum(panels[:2]), *panels[2:]], _TOY_INCHES)  # the first two share a row
    for toy, (row, left) in zip(
        TOYS, [(0, 0), (0, panels[0]), *((row, 0) for row in range(1, len(TOYS)))], strict=False
    ):
        first = toy.stages[0]
        places = positions(toy)
        titles = [f"{toy.figure}: {first.title}, at first", *(f"after {stage.title}" for stage in toy.stages)]
        for column, (hypotheses, stage, title) in enumerate(zip(places, (first, *toy.stages), titles, strict=True)):
            axes = cells(row, left + column)
            _draw_toy(axes, toy, hypotheses, stage)
            axes.set_title(title, fontsize=8)
    marks = [legend_mark("mode", _MODE, "x"), legend_mark("hypothesis", _HYPOTHESIS, "o")]
    pulls = [legend_mark("is pulled to", "0.3", ">"), legend_mark("border between cells", "0.75", line="-")]
    legend_below(figure, [*marks, *pulls], columns=4)
    write_figure(figure, path)


def _rows_of_panels(counts: Sequence[int], inches: tuple[float, float]) -> tuple[Any, Callable[[int, int], Any]]:
    """Return a figure, and what adds the panel at a row and column: each row's panels share its whole width."""
    width, height = inches
    figure = new_figure(figsize=(width * max(counts), height * len(counts) + 0.3), layout="constrained")
    parts = math.lcm(*counts)
    grid = figure.add_gridspec(len(counts), parts)

    def add(row: int, column: int) -> Any:
        each = parts // counts[row]
        return figure.add_subplot(grid[row, column * each : (column + 1) * each])

    return figure, add


def _draw_toy(axes: Any, toy: Toy, hypotheses: Points, stage: Stage) -> None:
    if stage.winners == 1:
        _draw_cells(axes, hypotheses)
    if stage.pulls_all:
        _draw_pulls(axes, toy.modes, hypotheses, winners(hypotheses, toy.modes, len(hypotheses)), alpha=0.15)
    _draw_pulls(axes, toy.modes, hypotheses, winners(hypotheses, toy.modes, stage.winners), alpha=0.8)
    axes.scatter(*toy.modes.T, marker="x", s=50, color=_MODE, zorder=3)
    axes.scatter(*hypotheses.T, s=22, color=_HYPOTHESIS, alpha=0.6, linewidths=0, zorder=4)
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0), xticks=[], yticks=[], aspect="equal")


def _draw_pulls(axes: Any, modes: Points, hypotheses: Points, pulled: npt.NDArray[np.intp], alpha: float) -> None:
    for mode, indices in zip(modes, pulled, strict=True):
        for at in hypotheses[indices]:
            axes.annotate(
                "", mode, at, arrowprops={"arrowstyle": "->", "color": "0.3", "alpha": alpha, "linewidth": 0.8}
            )


def _draw_cells(axes: Any, hypotheses: Points) -> None:
    """Draw the borders of the Voronoi cells, of hypotheses at one place one cell."""
    x, y = np.meshgrid(*2 * [np.linspace(0.0, 1.0, 201)])
    apart = np.unique(hypotheses.round(3), axis=0)
    distances = np.linalg.norm(np.stack([x, y], axis=-1)[..., None, :] - apart, axis=-1)
    for index in range(len(apart)):
        others = np.delete(distances, index, axis=-1).min(axis=-1)
        axes.contour(x, y, distances[..., index] - others, levels=[0.0], colors="0.75", linewidths=0.6)
