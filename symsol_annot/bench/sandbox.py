"""A stranger's HDF5 file, opened in a child process with limits on time and memory (`hdf5_child.py`)."""

import contextlib
import json
import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.closing import Closing
from symsol_annot.errors import PredictionsError

SECONDS_PER_REQUEST = 60.0
MEMORY_BYTES = 3 * 2**29  # of address space, of which the libraries take a quarter
_CHILD = Path(__file__).with_name("hdf5_child.py")


@dataclass(frozen=True)
class DatasetFacts:
    """What a name at the file's root is, known without reading it.

    Attributes:
        found: why it cannot be read: a link, a group, a type, values in other files; None where it can. The rest is
            then meaningless.
        shape: of the data set.
        dtype: numpy's name of its type.
        filters: the HDF5 numbers of its filters.
        chunk_bytes: the size of one chunk, 0 for a contiguous data set.
    """

    found: str | None
    shape: tuple[int, ...] = ()
    dtype: str = ""
    filters: tuple[int, ...] = ()
    chunk_bytes: int = 0


class SandboxedFile(Closing):
    """An HDF5 file of unknown origin. What goes wrong in it is a PredictionsError, whatever HDF5 makes of it."""

    def __init__(self, path: Path, seconds: float = SECONDS_PER_REQUEST, memory_bytes: int = MEMORY_BYTES) -> None:
        self.path, self._seconds = path, seconds
        try:
            missing = None if path.is_file() else "is no regular file" if path.exists() else "there is no such file"
        except OSError as error:
            missing = f"cannot be opened: {error.strerror}"
        if missing:
            raise PredictionsError(str(path), [missing])
        self._process = subprocess.Popen(
            [sys.executable, "-P", str(_CHILD), str(path.resolve()), str(seconds), str(memory_bytes)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1", "OMP_NUM_THREADS": "1", "HDF5_PLUGIN_PATH": os.devnull},
            start_new_session=True,  # Ctrl-C is the parent's to handle
        )
        self._described: dict[str, Any] | None = None
        self._end: PredictionsError | None = None  # of the process, if it met one

    @property
    def attributes(self) -> dict[str, Any]:
        """Those that are one string or one number."""
        return {name: entry["value"] for name, entry in self._description["attributes"].items() if "value" in entry}

    @property
    def odd_attributes(self) -> dict[str, str]:
        """What the other attributes are instead."""
        return {name: entry["found"] for name, entry in self._description["attributes"].items() if "found" in entry}

    @property
    def datasets(self) -> dict[str, DatasetFacts]:
        """What every name at the root is."""
        return {name: _facts(entry) for name, entry in self._description["datasets"].items()}

    def read(self, dataset: str, start: int, stop: int) -> npt.NDArray[Any]:
        """Return rows of a data set whose facts were checked before.

        Raises:
            PredictionsError: it is damaged, or reading it crashed or took too long.
        """
        if self._end:
            raise self._end
        facts = self.datasets[dataset]
        shape = (stop - start, *facts.shape[1:])
        header = self._exchange({"dataset": dataset, "start": start, "stop": stop}, f"{dataset!r}")
        if header != {"dtype": facts.dtype, "shape": list(shape)}:
            raise PredictionsError(str(self.path), [f"{dataset!r}: it changed while it was read, or is damaged"])
        rows = np.empty(shape, facts.dtype)
        if rows.size:
            self._receive_into(rows.data.cast("B"), f"{dataset!r}")
        return rows

    def close(self) -> None:
        """End the process."""
        with contextlib.suppress(OSError):
            self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe:
                with contextlib.suppress(OSError):
                    pipe.close()

    @property
    def _description(self) -> dict[str, Any]:
        """What the file holds; asked for at first use, so that the process starts while the caller does other work."""
        if self._described is None:
            self._described = self._exchange(None, "the file's structure")
        return self._described

    def _exchange(self, request: dict[str, Any] | None, what: str) -> dict[str, Any]:
        if request is not None:
            try:
                self._stdin.write(json.dumps(request).encode() + b"\n")
                self._stdin.flush()
            except OSError:
                raise self._death(what) from None
        length = bytearray(8)
        self._receive_into(memoryview(length), what)
        text = bytearray(int.from_bytes(length, "little"))
        self._receive_into(memoryview(text), what)
        header: dict[str, Any] = json.loads(text)
        if "error" in header:
            raise PredictionsError(str(self.path), [f"{what}: {header['error']}" if request else header["error"]])
        return header

    def _receive_into(self, buffer: memoryview, what: str) -> None:
        while buffer:
            count = self._stdout.readinto(buffer)
            if not count:
                raise self._death(what)
            buffer = buffer[count:]

    @property
    def _stdin(self) -> Any:
        return self._process.stdin

    @property
    def _stdout(self) -> Any:
        return self._process.stdout

    def _death(self, what: str) -> PredictionsError:
        code = self._process.wait()
        if code == -signal.SIGALRM:
            how = f"reading it took more than {self._seconds:g} s, which only a damaged or hostile file does"
        elif code < 0:
            how = f"the HDF5 library crashed on it ({signal.Signals(-code).name}); the file is damaged"
        else:
            how = f"the HDF5 library gave up on it (exit code {code}); the file is damaged, or wants too much memory"
        self._end = PredictionsError(str(self.path), [f"{what}: {how}"])
        return self._end


def _facts(entry: dict[str, Any]) -> DatasetFacts:
    if "found" in entry:
        return DatasetFacts(entry["found"])
    return DatasetFacts(
        None,
        tuple(entry["shape"]),
        entry["dtype"],
        tuple(entry["filters"]),
        entry["chunk_bytes"],
    )
