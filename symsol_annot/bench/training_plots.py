"""The curve of a training: its loss, and its figures on the held-out images."""

from pathlib import Path

from symsol_annot.bench.checkpoints import About
from symsol_annot.canvas import new_figure, write_figure

_ERRORS = ("recall_mean_error_rad", "precision_mean_error_rad")
_RATIOS = ("coverage_at_5_deg", "accuracy_at_5_deg", "recall", "precision", "f_measure")
_LABELS = {"loss": "loss", "errors": "mean error (rad)", "ratios": "held-out images"}


def plot_curve(path: Path, about: About) -> None:
    """Write a PNG: the loss by epoch, and beside it what the held-out images' figures are.

    Raises:
        OutputError: the file cannot be written.
        SymsolError: matplotlib is not installed.
    """
    there = {name for row in about.rows for name in row}
    panels = {"loss": ("loss",), "errors": _ERRORS, "ratios": _RATIOS}
    shown = {title: [name for name in names if name in there] for title, names in panels.items()}
    shown = {title: names for title, names in shown.items() if names}
    figure = new_figure(figsize=(4.0 * len(shown), 3.0), layout="constrained")
    epochs = [row["epoch"] for row in about.rows]
    drops = [epoch for epoch, row in zip(epochs[1:], about.rows[1:], strict=True) if _drops_before(about, int(epoch))]
    for number, (title, names) in enumerate(shown.items(), 1):
        axes = figure.add_subplot(1, len(shown), number)
        for name in names:
            axes.plot(epochs, [row.get(name, float("nan")) for row in about.rows], linewidth=1.2, label=name)
        for epoch in drops:
            axes.axvline(epoch - 0.5, color="0.7", linewidth=0.6, linestyle=":")
        axes.set_xlabel("epoch", fontsize=8)
        axes.set_ylabel(_LABELS[title], fontsize=8)
        axes.tick_params(labelsize=7)
        if title != "ratios":
            axes.set_yscale("log")
        axes.legend(fontsize=6)
    figure.suptitle(f"{about.object}: {about.recipe.title}; dotted: the rate drops", fontsize=8)
    write_figure(figure, path)


def _drops_before(about: About, epoch: int) -> bool:
    return about.rows[epoch - 1]["rate"] < about.rows[epoch - 2]["rate"]
