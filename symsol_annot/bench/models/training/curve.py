"""The curve of a training: its loss, and its figures on the validation images."""

from pathlib import Path

from symsol_annot.bench.models.training.record import TrainingRecord
from symsol_annot.bench.models.validation import FIGURES
from symsol_annot.plotting.canvas import label_text, new_figure, write_figure

_PANELS = {"errors": False, "ratios": True}  # whether higher is better
_LABELS = {"loss": "loss", "errors": "mean error (rad)", "ratios": "validation images"}


def plot_curve(path: Path, record: TrainingRecord) -> None:
    """Write a PNG: the loss of each epoch, and beside it the figures of the validation images.

    Args:
        path: of the PNG.
        record: of a training with one epoch or more.

    Raises:
        OutputError: the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    there = {name for row in record.rows for name in row}
    shown = {
        title: [name for name, is_higher_better in FIGURES.items() if name in there and is_higher_better == is_higher]
        for title, is_higher in _PANELS.items()
    }
    shown = {"loss": ["loss"], **{title: names for title, names in shown.items() if names}}
    figure = new_figure(figsize=(4.0 * len(shown), 3.0), layout="constrained")
    epochs = [row["epoch"] for row in record.rows]
    drops = [epoch for epoch, row in zip(epochs[1:], record.rows[1:], strict=True) if _drops_before(record, int(epoch))]
    for number, (title, names) in enumerate(shown.items(), 1):
        axes = figure.add_subplot(1, len(shown), number)
        for name in names:
            axes.plot(epochs, [row.get(name, float("nan")) for row in record.rows], linewidth=1.2, label=name)
        for epoch in drops:
            axes.axvline(epoch - 0.5, color="0.7", linewidth=0.6, linestyle=":")
        axes.set_xlabel("epoch", fontsize=8)
        axes.set_ylabel(_LABELS[title], fontsize=8)
        axes.tick_params(labelsize=7)
        if title != "ratios":
            axes.set_yscale("log")
        axes.legend(fontsize=6)
    figure.suptitle(f"{record.object}: {label_text(record.recipe.title)}; dotted: the learning rate drops", fontsize=8)
    write_figure(figure, path)


def _drops_before(record: TrainingRecord, epoch: int) -> bool:
    return record.rows[epoch - 1]["learning_rate"] < record.rows[epoch - 2]["learning_rate"]
