"""Chunks of HDF5 data sets, read and made past HDF5: with zlib-ng, which is faster, and in all threads at once.

HDF5 says where a chunk lies; its bytes are then read from the file itself.
"""

import hashlib
import math
import os
import sys
import threading
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast

import numpy as np
import numpy.typing as npt
from zlib_ng import zlib_ng

from symsol_annot.errors import DamageError
from symsol_annot.system.reading import open_regular

Identity: TypeAlias = tuple[int, int, int]

GZIP_LEVEL = 4  # the highest of zlib-ng 2.3.3 that gives the same bytes with and without a processor's SIMD
DEFLATE, FLETCHER32 = 1, 3  # HDF5's numbers of the filters
_CHECKSUM_BYTES = 4
_BLOCK_BYTES = 2**20
_DEFLATE_ERROR = cast("type[Exception]", zlib_ng.error)


def stored(values: npt.NDArray[Any]) -> bytes:
    """Return the bytes of a chunk: gzip, then fletcher32."""
    data = zlib_ng.compress(np.ascontiguousarray(values), GZIP_LEVEL)
    return data + fletcher32(data).to_bytes(_CHECKSUM_BYTES, "little")


def inflated(chunk: bytes, size: int) -> bytes:
    """Return what a chunk made by `stored` holds, without looking at its fletcher32.

    Raises:
        ValueError: it is not `size` bytes.
        zlib_ng.error: it is no deflate stream, or its adler32 is wrong.
    """
    return _inflated(chunk[:-_CHECKSUM_BYTES], size)


def deflated(values: bytes) -> bytes:
    """Return bytes as a deflate stream of zlib's format, which any zlib inflates."""
    return bytes(zlib_ng.compress(values, GZIP_LEVEL))


def inflated_up_to(data: bytes, most: int) -> bytes:
    """Return what a deflate stream made by `deflated` holds, which is at most so many bytes.

    Raises:
        ValueError: it is no such stream, or holds more.
    """
    stream = zlib_ng.decompressobj()
    try:
        values = stream.decompress(data, most + 1)
    except _DEFLATE_ERROR as error:
        raise ValueError(f"cannot be inflated: {error}") from None
    if not stream.eof or stream.unused_data or len(values) > most:
        raise ValueError(f"expected a deflate stream of at most {most} bytes, found more, or its end is missing")
    return bytes(values)


def deflate_version() -> str:
    """Return the version of the library that decides the bytes of `stored`."""
    return str(zlib_ng.ZLIBNG_RUNTIME_VERSION)


def fletcher32(data: bytes) -> int:
    """Return HDF5's checksum: sums, modulo 65535, of big-endian 16-bit words and of their running sums.

    A last odd byte is the high one of a word. A sum that is 0 by the modulus alone is written 65535.
    """
    words = np.frombuffer(data + b"\0" * (len(data) % 2), ">u2").astype(np.uint64)
    if not words.any():
        return 0
    times_summed = np.arange(len(words), 0, -1, dtype=np.uint64) % np.uint64(65535)
    plain, running = ((int(total) - 1) % 65535 + 1 for total in (words.sum(), (words * times_summed).sum()))
    return running << 16 | plain


class ByteFile:
    """A file that is open for reading, from any thread and in forked processes; closed once nothing refers to it."""

    def __init__(self, path: Path) -> None:
        self._descriptor = open_regular(path)
        self._end = weakref.finalize(self, os.close, self._descriptor)  # so not while another thread reads

    @property
    def identity(self) -> Identity:
        """What tells it from a file that took its name."""
        return _identity(self._descriptor)

    def close(self) -> None:
        """Close the file at once, from which no other thread may be reading."""
        self._descriptor = -1
        self._end()

    def sha256(self) -> str:
        """Return the SHA-256 of all bytes, as hexadecimal."""
        digest, offset = hashlib.sha256(), 0
        while block := _pread(self._descriptor, _BLOCK_BYTES, offset):
            digest.update(block)
            offset += len(block)
        return digest.hexdigest()

    def read(self, size: int, offset: int) -> bytes:
        """Return the bytes at a place.

        Raises:
            ValueError: the file ends before.
        """
        data = _pread(self._descriptor, size, offset)
        if len(data) != size:
            raise ValueError(f"the file ends {size - len(data)} bytes too early")
        return data


class Place(NamedTuple):
    """Where a chunk lies in a file, with its fletcher32 at the end."""

    offset: int
    size: int


@dataclass(frozen=True)
class StoredArray:
    """A data set as the format stores it: chunks of whole rows, gzip and fletcher32, each at a known place.

    gzip's adler32 is checked at reading, fletcher32 is not.

    Attributes:
        name: of the data set.
        shape: of the array; the first axis has the rows.
        dtype: numpy's name of its type, whose bytes are the file's.
        rows_per_chunk: which divides the rows.
        places: of the chunks, in the order of their rows.
    """

    name: str
    shape: tuple[int, ...]
    dtype: str
    rows_per_chunk: int
    places: tuple[Place, ...]

    def row(self, row: int, file: "ByteFile") -> npt.NDArray[Any]:
        """Return a row as a new array, where each has a chunk of its own.

        Raises:
            DamageError: the row is damaged.
        """
        return self._chunk(row, file).reshape(self.shape[1:])

    def whole(self, file: "ByteFile") -> npt.NDArray[Any]:
        """Return all rows as a new array.

        Raises:
            DamageError: a chunk is damaged.
        """
        return np.concatenate([self._chunk(number, file) for number in range(len(self.places))]).reshape(self.shape)

    def _chunk(self, number: int, file: "ByteFile") -> npt.NDArray[Any]:
        place, kind = self.places[number], np.dtype(self.dtype)
        try:
            data = _inflated(file.read(place.size - _CHECKSUM_BYTES, place.offset), self._chunk_bytes)
        except (ValueError, OSError, _DEFLATE_ERROR) as error:
            rows = f"row {number}" if self.rows_per_chunk == 1 else self.name
            raise DamageError(f"{rows} cannot be read: {self.name}: {error}") from None
        if kind == np.bool_ and np.frombuffer(data, np.uint8).max() > 1:
            raise DamageError(f"{self.name} cannot be read: it holds other bytes than 0 and 1")
        return np.frombuffer(data, kind).copy()

    @property
    def _chunk_bytes(self) -> int:
        return self.rows_per_chunk * math.prod(self.shape[1:]) * np.dtype(self.dtype).itemsize


def largest_chunk(values_bytes: int) -> int:
    """Return how many bytes a stored chunk of so many bytes of values can have: deflate hardly lengthens anything."""
    return values_bytes + values_bytes // 500 + 256


def _inflated(data: bytes, size: int) -> bytes:
    """Inflate to exactly `size` bytes; a stream of more is stopped one byte later."""
    stream = zlib_ng.decompressobj()
    values = stream.decompress(data, size + 1)
    if not stream.eof or len(values) != size:
        found = "more" if len(values) > size else f"{len(values)}, or its end is missing"
        raise ValueError(f"expected a chunk of {size} bytes, found {found}")
    return values


def _identity(file: int | str) -> Identity:
    status = os.stat(file)  # noqa: PTH116 - of a descriptor
    return status.st_dev, status.st_ino, status.st_size


if sys.platform == "win32":
    _seeking = threading.Lock()

    def _pread(descriptor: int, size: int, offset: int) -> bytes:
        with _seeking:
            os.lseek(descriptor, offset, os.SEEK_SET)
            return os.read(descriptor, size)

else:
    _pread = os.pread
