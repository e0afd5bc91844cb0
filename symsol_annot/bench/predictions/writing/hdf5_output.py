"""Writing an HDF5 file to a disk that may fill up."""

import io
import os
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import h5py

_CACHE_BYTES = 2**26


class HDF5Output:
    """A new HDF5 file, whose bytes are on the disk once the `with` block is left.

    A failed write leaves the HDF5 library with a file that it can neither finish nor close, and crashes the
    process at its end. So HDF5 writes through a file object that never fails: it notes the first failure, which is
    raised here.

    Attributes:
        file: to be filled.

    Raises:
        OSError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._bytes = _Bytes(path, "w+")
        self.file = h5py.File(self._bytes, "w", libver=("earliest", "v108"), rdcc_nbytes=_CACHE_BYTES)

    def raise_failure(self) -> None:
        """Raise the failure that was met so far, if there was one.

        Raises:
            OSError: something could not be written.
        """
        if self._bytes.failure:
            raise self._bytes.failure

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._bytes:
            self.file.close()
            if error is None:
                self.raise_failure()
                os.fsync(self._bytes.fileno())


class _Bytes(io.FileIO):
    """A file that notes the first failure, and from then on writes nothing."""

    failure: BaseException | None = None

    def write(self, data: Any) -> int:
        """Write all of some bytes."""
        left = memoryview(data).cast("B")
        size = len(left)
        try:
            while left and not self.failure:
                left = left[super().write(left) :]
        except (OSError, KeyboardInterrupt) as error:
            self.failure = error
        return size

    def truncate(self, size: int | None = None) -> int:
        """Set the file's size."""
        try:
            return 0 if self.failure else super().truncate(size)
        except (OSError, KeyboardInterrupt) as error:
            self.failure = error
            return 0
