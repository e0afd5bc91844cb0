"""TensorBoard's files of a training: the loss as it goes, and the figures of each epoch."""

import importlib
from pathlib import Path
from typing import Any

from symsol_annot.bench.models.training.record import EpochFigures, TrainingRecord
from symsol_annot.bench.models.validation import FIGURES
from symsol_annot.errors import output_errors
from symsol_annot.system.closing import Closing
from symsol_annot.system.machine import check_extra

EVENTS_FOLDER = "tensorboard"  # in a checkpoint's folder
_FILES = "events.out.tfevents.*"
_TOLD_BY_STEPS = ("loss", "learning_rate")


class EventLog(Closing):
    """Writes a training's events, after those of its finished epochs where it goes on.

    By step, counted from the first of the training: steps/loss, the mean since the last that was told, and
    steps/learning_rate. By epoch: epochs/NAME, what its figures tell of the training; validation/NAME, its figures on
    validation images; calibration/NAME, what was fitted after the last. What a stopped run told of an epoch that it did
    not finish is hidden by what comes after it.

    Args:
        folder: of the files; None writes none.
        record: of the training; where the folder has no files yet, they begin with its epochs.
        steps: how many an epoch has.

    Raises:
        MissingExtraError: tensorboard is not installed.
        OutputError: the folder cannot be written.
    """

    def __init__(self, folder: Path | None, record: TrainingRecord, steps: int) -> None:
        self._folder, self._writer = folder, None
        if folder is None:
            return
        check_event_log()
        with output_errors(folder):
            is_new = not any(folder.glob(_FILES))
            self._writer = _writer(str(folder), purge_step=record.epochs_done * steps + 1)
            if is_new:
                for row in record.rows:
                    self._tell_row(row)

    def tell_steps(self, step: int, loss: float, learning_rate: float) -> None:
        """Write the mean loss of the steps up to one since the last that was told, and its learning rate."""
        if self._folder and self._writer:
            with output_errors(self._folder):
                for name, value in zip(_TOLD_BY_STEPS, (loss, learning_rate), strict=True):
                    self._writer.add_scalar(f"steps/{name}", value, step)

    def tell_epoch(self, record: TrainingRecord) -> None:
        """Write the figures of the last epoch, and see to it that they are in the file."""
        if self._folder and self._writer:
            with output_errors(self._folder):
                self._tell_row(record.rows[-1])
                for name, value in record.calibration.items():
                    self._writer.add_scalar(f"calibration/{name}", value, record.epochs_done)
                self._writer.flush()

    def close(self) -> None:
        """Write what is left."""
        if self._folder and self._writer:
            with output_errors(self._folder):
                self._writer.close()

    def _tell_row(self, row: EpochFigures) -> None:
        for name, value in row.items():
            if name != "epoch" and self._writer:
                self._writer.add_scalar(
                    f"{'validation' if name in FIGURES else 'epochs'}/{name}", value, int(row["epoch"])
                )


def check_event_log() -> None:
    """Raise where TensorBoard is not installed.

    Raises:
        MissingExtraError: it is not.
    """
    check_extra("tensorboard", "a log for TensorBoard")


def _writer(folder: str, *, purge_step: int) -> Any:
    return importlib.import_module("torch.utils.tensorboard").SummaryWriter(folder, purge_step=purge_step)
