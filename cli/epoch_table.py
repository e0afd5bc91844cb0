"""The table that `train` prints: a line per epoch below one that names the columns, and what the names mean."""

import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

_WIDTH = 80


@dataclass(frozen=True)
class _Column:
    """A figure of an epoch as the table has it.

    Attributes:
        heading: above it.
        meaning: in words.
        form: of its number.
        width: of its heading and its numbers, in characters.
    """

    heading: str
    meaning: str
    form: str
    width: int


_OF_TRAINING = {
    "loss": _Column("loss", "its mean over the epoch", ".4g", 9),
    "learning_rate": _Column("rate", "the learning rate at its end", ".3g", 8),
    "winners": _Column("k", "winners", ".0f", 3),
    "concentration": _Column("K", "concentration", ".3g", 4),
    "is_frozen": _Column("frozen", "1 while the first stage is", ".0f", 6),
}
_OF_VALIDATION = {
    "recall_mean_error_rad": _Column("rec.err", "mean recall error in rad", ".4f", 7),
    "precision_mean_error_rad": _Column("prec.err", "mean precision error in rad", ".4f", 8),
    "coverage_at_5_deg": _Column("cov.5", "coverage at 5 degrees", ".3f", 5),
    "accuracy_at_5_deg": _Column("acc.5", "accuracy at 5 degrees", ".3f", 5),
    "recall": _Column("recall", "recall", ".4f", 6),
    "precision": _Column("precision", "precision", ".4f", 9),
    "f_measure": _Column("F", "F-measure", ".4f", 6),
    "log_likelihood_at_gt": _Column("loglik", "mean log-likelihood of R_gt", ".3f", 8),
}
_OF_SPEED = {
    "images_per_second": _Column("img/s", "images learnt from per second", ".0f", 6),
    "seconds": _Column("seconds", "of the epoch, evaluation included", ".0f", 7),
}
_LEFT_OUT = ("epoch", "processor_seconds")


class EpochTable:
    """The lines of a training's table.

    Args:
        row: the figures of an epoch; the others have the same.
        epochs: how many there are to be.
    """

    def __init__(self, row: Mapping[str, float], epochs: int) -> None:
        self._epochs, self._epoch_width = epochs, max(5, 2 * len(str(epochs)) + 1)
        known = _OF_TRAINING | _OF_VALIDATION | _OF_SPEED
        names = sorted(
            row.keys() - set(_LEFT_OUT), key=lambda name: list(known).index(name) if name in known else len(known)
        )
        self._columns = {name: known.get(name, _Column(name, "", ".4g", max(8, len(name)))) for name in names}

    def heading(self) -> Iterator[str]:
        """Give the lines above the first epoch's: what the columns mean, and their names."""
        told = [f"{name} is {meaning}" for name, meaning in self._meanings(_OF_TRAINING | _OF_SPEED)]
        checked = [f"{name} is {meaning}" for name, meaning in self._meanings(_OF_VALIDATION)]
        text = "A line per epoch: " + ", ".join(told)
        if checked:
            text += ". Of the validation images: " + ", ".join(checked)
        yield from textwrap.wrap(f"{text}.", _WIDTH)
        yield self._line("epoch", {name: column.heading for name, column in self._columns.items()})

    def line(self, row: Mapping[str, float]) -> str:
        """Return an epoch's line."""
        cells = {name: format(row[name], column.form) for name, column in self._columns.items() if name in row}
        return self._line(f"{row['epoch']:.0f}/{self._epochs}", cells)

    def _meanings(self, columns: Mapping[str, _Column]) -> Iterator[tuple[str, str]]:
        for name in self._columns:
            if name in columns and columns[name].meaning != columns[name].heading:
                yield columns[name].heading, columns[name].meaning

    def _line(self, epoch: str, cells: Mapping[str, str]) -> str:
        parts = [f"{cells.get(name, '-'):>{column.width}}" for name, column in self._columns.items()]
        return " ".join([epoch.rjust(self._epoch_width), *parts])
