"""The curve of a training: its loss, and its figures on the validation images."""

from pathlib import Path

from symsol_annot.bench.models.recipe_keys import STEPS
from symsol_annot.bench.models.training.record import TrainingRecord
from symsol_annot.bench.models.validation import FIGURES
from symsol_annot.plotting.canvas import label_text, new_figure, write_figure

_PANELS = {"errors": False, "ratios": True}  # whether higher is better
_FEW_EPOCHS = 20  # up to which each is a point: a line of one has no length
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
    point = "o" if len(epochs) <= _FEW_EPOCHS else None
    drops = [epoch for epoch in epochs[1:] if _drops_before(record, int(epoch))]
    extensions = [done for done, _ in record.extensions if done < len(epochs)]
    for number, (title, names) in enumerate(shown.items(), 1):
        axes = figure.add_subplot(1, len(shown), number)
        for name in names:
            values = [row.get(name, float("nan")) for row in record.rows]
            axes.plot(epochs, values, linewidth=1.2, marker=point, markersize=3.5, label=name)
        for epoch in drops:
            axes.axvline(epoch - 0.5, color="0.7", linewidth=0.6, linestyle=":")
        for epoch in extensions:
            axes.axvline(epoch + 0.5, color="0.5", linewidth=0.8, linestyle="--")
        axes.set_xlim(0.5, len(epochs) + 0.5)
        axes.xaxis.get_major_locator().set_params(integer=True, min_n_ticks=1)
        axes.set_xlabel("epoch", fontsize=8)
        axes.set_ylabel(_LABELS[title], fontsize=8)
        if title != "ratios" and all(row.get(name, 1.0) > 0.0 for row in record.rows for name in names):
            axes.set_yscale("log")  # a loss that is a log-likelihood may be below 0
        axes.tick_params(labelsize=7, which="both")
        axes.legend(fontsize=6)
    told = {"dotted: the learning rate drops": drops, "dashed: extended": extensions}
    title = "; ".join([f"{record.object}: {label_text(record.recipe.title)}", *(name for name in told if told[name])])
    figure.suptitle(title, fontsize=8)
    write_figure(figure, path)


def _drops_before(record: TrainingRecord, epoch: int) -> bool:
    """Tell whether the learning rate drops there at once: a cosine falls all the time."""
    if record.recipe.schedule != STEPS:
        return False
    return record.rows[epoch - 1]["learning_rate"] < record.rows[epoch - 2]["learning_rate"]
