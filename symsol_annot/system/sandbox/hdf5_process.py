"""The child process (`hdf5_child.py`) in which HDF5 opens files of unknown origin, with limits on time and memory."""

import contextlib
import json
import math
import os
import signal
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DamageError
from symsol_annot.system.closing import Closing

SECONDS_PER_REQUEST = 60.0
MEMORY_BYTES = 3 * 2**29  # of address space, of which the libraries take a quarter
_CHILD = Path(__file__).with_name("hdf5_child.py")
_ENVIRONMENT = {
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "HDF5_PLUGIN_PATH": os.devnull,
    "HDF5_USE_FILE_LOCKING": "FALSE",  # a file system may have no locks; a user's setting would outrank the program's
}


@dataclass(frozen=True)
class Limits:
    """What a child process may use.

    Attributes:
        seconds: of a request, by the clock.
        processor_seconds: of a request, of its own work, which a busy machine does not stretch.
        memory_bytes: of address space.
    """

    seconds: float = SECONDS_PER_REQUEST
    processor_seconds: float = SECONDS_PER_REQUEST
    memory_bytes: int = MEMORY_BYTES


@dataclass(frozen=True, eq=False)
class DatasetFacts:
    """What a name at the file's root is, known without reading it.

    Attributes:
        found: why it cannot be read: a link, a group, a type, values in other files; None where it can. The rest is
            then meaningless.
        shape: of the data set.
        dtype: numpy's name of its type, in little-endian order.
        exact_type: numpy's name of its type where the bytes in the file are numpy's own; else empty.
        filters: the HDF5 numbers of its filters.
        chunks: the shape of a chunk; None for a contiguous data set.
        chunk_bytes: the size of one chunk, 0 for a contiguous data set.
        places: (k, 4) where chunks lie that hold whole rows: first row, place in the file, size there, filters that
            were left out; none where that was not asked for.
    """

    found: str | None
    shape: tuple[int, ...] = ()
    dtype: str = ""
    exact_type: str = ""
    filters: tuple[int, ...] = ()
    chunks: tuple[int, ...] | None = None
    chunk_bytes: int = 0
    places: npt.NDArray[np.uint64] = field(default_factory=lambda: np.zeros((0, 4), np.uint64))

    @property
    def values_bytes(self) -> int:
        """How many bytes its values take without compression."""
        return math.prod(self.shape) * np.dtype(self.dtype).itemsize


@dataclass(frozen=True)
class Description:
    """What a file says of itself.

    Attributes:
        attributes: those that are one string or one number, and were wanted.
        arrays: those that were wanted as arrays, and are.
        odd_attributes: what the other attributes are instead.
        datasets: what every name at the root is.
        identity: device, inode and size of the file that was described.
    """

    attributes: Mapping[str, Any]
    arrays: Mapping[str, npt.NDArray[Any]]
    odd_attributes: Mapping[str, str]
    datasets: Mapping[str, DatasetFacts]
    identity: tuple[int, int, int]


class Hdf5Process(Closing):
    """A child process that describes and reads HDF5 files, one after the other.

    After a fault or any exception it must be closed: it may be half-way through an answer, or damaged.
    """

    def __init__(self, limits: Limits) -> None:
        """Start the process.

        Raises:
            DamageError: it cannot be started.
        """
        self._limits = limits
        try:
            self._process = subprocess.Popen(
                [
                    *(sys.executable, "-P", str(_CHILD)),
                    *(str(limits.seconds), str(limits.processor_seconds), str(limits.memory_bytes)),
                ],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                env={**os.environ, **_ENVIRONMENT},
                start_new_session=True,  # Ctrl-C is the parent's to handle
            )
        except OSError as error:
            raise DamageError(f"the process that opens it cannot be started: {error.strerror}") from None

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    @property
    def has_ended(self) -> bool:
        """Whether it is gone, whatever became of it."""
        return self._process.poll() is not None

    def begin_to_open(self, path: Path, attributes: Mapping[str, str] | None = None) -> None:
        """Ask for a file's description, which `description` waits for; meanwhile the caller may do other work.

        Args:
            path: of a regular file.
            attributes: those that are wanted, to their kinds "text", "whole", "real" or "array", and the places of
                chunks with them; None for all but arrays, without places.
        """
        self._send({"open": str(path.absolute()), "attributes": attributes and dict(attributes)}, "the file")

    def description(self) -> Description:
        """Return the description of the file that was asked about.

        Raises:
            DamageError: it is damaged, or describing it crashed or took too long.
        """
        what = "the file's structure"
        found = self._receive(what)
        attributes = found["attributes"]
        datasets = {
            name: _facts(entry, self._array((entry.get("places_count", 0), 4), "<u8", what))
            for name, entry in found["datasets"].items()
        }
        return Description(
            {name: entry["value"] for name, entry in attributes.items() if "value" in entry},
            {
                name: self._array(tuple(entry["shape"]), entry["dtype"], what)
                for name, entry in attributes.items()
                if "dtype" in entry
            },
            {name: entry["found"] for name, entry in attributes.items() if "found" in entry},
            datasets,
            tuple(found["identity"]),
        )

    def rows(self, dataset: str, start: int, stop: int, facts: DatasetFacts) -> npt.NDArray[Any]:
        """Return rows of a data set of the file that was opened last.

        Raises:
            DamageError: it is damaged, or reading it crashed or took too long.
        """
        shape, what = (stop - start, *facts.shape[1:]), f"{dataset!r}"
        self._send({"dataset": dataset, "start": start, "stop": stop}, what)
        header = self._receive(what)
        if header != {"dtype": facts.dtype, "shape": list(shape)}:
            raise DamageError(f"{what}: it changed while it was read, or is damaged")
        return self._array(shape, facts.dtype, what)

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):  # where this process changed its user, it may not
            self._process.kill()
        for pipe in (self._process.stdin, self._process.stdout):  # whose end is the child's, too
            if pipe:
                with contextlib.suppress(OSError):
                    pipe.close()
        self._process.wait()

    def _send(self, request: dict[str, Any], what: str) -> None:
        stdin: Any = self._process.stdin
        try:
            stdin.write(json.dumps(request).encode() + b"\n")
            stdin.flush()
        except OSError:
            raise self._death(what) from None

    def _receive(self, what: str) -> dict[str, Any]:
        length = bytearray(8)
        self._receive_into(memoryview(length), what)
        text = bytearray(int.from_bytes(length, "little"))
        self._receive_into(memoryview(text), what)
        header: dict[str, Any] = json.loads(text)
        if "error" in header:
            is_whole_file = what == "the file's structure"
            raise DamageError(header["error"] if is_whole_file else f"{what}: {header['error']}")
        return header

    def _array(self, shape: tuple[int, ...], dtype: str, what: str) -> npt.NDArray[Any]:
        array = np.empty(shape, dtype)
        if array.size:
            self._receive_into(array.data.cast("B"), what)
        return array

    def _receive_into(self, buffer: memoryview, what: str) -> None:
        stdout: Any = self._process.stdout
        while buffer:
            count = stdout.readinto(buffer)
            if not count:
                raise self._death(what)
            buffer = buffer[count:]

    def _death(self, what: str) -> DamageError:
        code, limits = self._process.wait(), self._limits
        if code in (-getattr(signal, "SIGALRM", 0), -getattr(signal, "SIGPROF", 0)):
            seconds = limits.seconds if code == -signal.SIGALRM else limits.processor_seconds
            how = f"reading it took more than {seconds:g} s, which only a damaged or hostile file does"
        elif code < 0:
            how = f"the HDF5 library crashed on it ({signal.Signals(-code).name}); the file is damaged"
        else:
            how = f"the HDF5 library gave up on it (exit code {code}); the file is damaged, or wants too much memory"
        return DamageError(f"{what}: {how}")


def _facts(entry: dict[str, Any], places: npt.NDArray[np.uint64]) -> DatasetFacts:
    if "found" in entry:
        return DatasetFacts(entry["found"])
    return DatasetFacts(
        None,
        shape=tuple(entry["shape"]),
        dtype=entry["dtype"],
        exact_type=entry["exact_type"],
        filters=tuple(entry["filters"]),
        chunks=None if entry["chunks"] is None else tuple(entry["chunks"]),
        chunk_bytes=entry["chunk_bytes"],
        places=places,
    )
