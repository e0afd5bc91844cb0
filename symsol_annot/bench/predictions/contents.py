"""What a predictions file holds once it is open: read in a child process, or held in memory and never a file."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from symsol_annot.bench.predictions.columns import Array, Column
from symsol_annot.bench.predictions.format import PREDICTIONS_FORMAT, PREDICTIONS_FORMAT_VERSION
from symsol_annot.bench.predictions.truth import Subject
from symsol_annot.system.sandbox.hdf5_process import DatasetFacts


class Contents(Protocol):
    """Attributes and data sets, of which rows are read when they are asked for."""

    @property
    def path(self) -> Path:
        """Where they are from, for messages."""

    @property
    def size_bytes(self) -> int:
        """How many bytes they take as they are stored."""

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Those that are one string or one number."""

    @property
    def odd_attributes(self) -> Mapping[str, str]:
        """What the other attributes are instead."""

    @property
    def datasets(self) -> Mapping[str, DatasetFacts]:
        """What every name at the root is."""

    def read(self, dataset: str, start: int, stop: int) -> Array:
        """Return rows of a data set whose facts were checked before.

        Raises:
            PredictionsError: they cannot be read.
        """


class HeldArrays:
    """Arrays in memory, checked and read as if they had been written to a file.

    Attributes:
        path: what they are called in messages.
        attributes: as a file would have them.
        odd_attributes: none.
        datasets: name to what the array is.
    """

    def __init__(self, name: str, attributes: Mapping[str, Any], arrays: Mapping[str, Array]) -> None:
        self.path, self.attributes, self.odd_attributes = Path(name), attributes, dict[str, str]()
        self._arrays = {dataset: _little_endian(array) for dataset, array in arrays.items()}
        self.datasets = {
            dataset: DatasetFacts(None, array.shape, array.dtype.str) for dataset, array in self._arrays.items()
        }

    @property
    def size_bytes(self) -> int:
        """How many bytes the arrays take."""
        return sum(array.nbytes for array in self._arrays.values())

    def read(self, dataset: str, start: int, stop: int) -> Array:
        """Return rows of an array; who asks does not write to them."""
        return self._arrays[dataset][start:stop]


def said_of(about: Subject) -> dict[str, Any]:
    """Return what a predictions file says of the split that it is about."""
    return {
        "format": PREDICTIONS_FORMAT,
        "format_version": PREDICTIONS_FORMAT_VERSION,
        "object": about.object,
        "split": about.split,
        "fingerprint": about.fingerprint,
    }


def filled(column: Column) -> Array:
    """Return a column as one array."""
    blocks = list(column.blocks)
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks) if blocks else np.zeros(column.shape, column.dtype)


def _little_endian(array: Array) -> Array:
    return array.astype(array.dtype.newbyteorder("<"), copy=False)
