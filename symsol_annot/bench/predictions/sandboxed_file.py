"""A predictions file of unknown origin, which HDF5 opens in a process of its own."""

import contextlib
from collections.abc import Mapping
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy.typing as npt

from symsol_annot.errors import DamageError, PredictionsError
from symsol_annot.system.closing import Closing
from symsol_annot.system.sandbox.hdf5_process import (
    MEMORY_BYTES,
    SECONDS_PER_REQUEST,
    DatasetFacts,
    Description,
    Hdf5Process,
    Limits,
)


class SandboxedFile(Closing):
    """A predictions file of unknown origin. What goes wrong in it is a PredictionsError, whatever HDF5 makes of it."""

    def __init__(self, path: Path, seconds: float = SECONDS_PER_REQUEST, memory_bytes: int = MEMORY_BYTES) -> None:
        self.path = path
        try:
            missing = None if path.is_file() else "is no regular file" if path.exists() else "there is no such file"
        except OSError as error:
            missing = f"cannot be opened: {error.strerror}"
        if missing:
            raise PredictionsError(str(path), [missing])
        self._end: PredictionsError | None = None  # of the process, if it met one
        try:
            self._process = Hdf5Process(Limits(seconds, seconds, memory_bytes))
        except DamageError as fault:
            raise PredictionsError(str(path), [str(fault)]) from None
        with contextlib.suppress(DamageError):  # told when the description is asked for
            self._process.begin_to_open(path)

    @property
    def size_bytes(self) -> int:
        """The file's size."""
        return self.path.stat().st_size

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    @property
    def attributes(self) -> Mapping[str, Any]:
        """Those that are one string or one number."""
        return self._description.attributes

    @property
    def odd_attributes(self) -> Mapping[str, str]:
        """What the other attributes are instead."""
        return self._description.odd_attributes

    @property
    def datasets(self) -> Mapping[str, DatasetFacts]:
        """What every name at the root is."""
        return self._description.datasets

    def read(self, dataset: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Return rows of a data set whose facts were checked before.

        Raises:
            PredictionsError: it is damaged, or reading it crashed or took too long.
        """
        if self._end:
            raise self._end
        facts = self.datasets[dataset]
        try:
            return self._process.rows(dataset, start, stop, facts)
        except DamageError as fault:
            raise self._as_error(fault) from None

    def close(self) -> None:
        """End the process."""
        self._process.close()

    @cached_property
    def _description(self) -> Description:
        try:
            return self._process.description()
        except DamageError as fault:
            raise self._as_error(fault) from None

    def _as_error(self, fault: DamageError) -> PredictionsError:
        error = PredictionsError(str(self.path), [str(fault)])
        if self._process.has_ended:
            self._end = error
        return error
