"""Chunks of HDF5 data sets, read and made past HDF5: with zlib-ng, which is faster, and in all threads at once.

HDF5 says where a chunk lies; its bytes are then read from the file itself.
"""

import math
import os
import sys
import threading
import weakref
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias, cast

import h5py
import numpy as np
import numpy.typing as npt
from zlib_ng import zlib_ng

from symsol_annot.errors import DataError

Identity: TypeAlias = tuple[int, int, int]

GZIP_LEVEL = 4  # the highest of zlib-ng 2.3.3 that gives the same bytes with and without a processor's SIMD
HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)  # what h5py makes of damage
DEFLATE, SHUFFLE, FLETCHER32 = h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32
_READABLE_FILTERS: tuple[list[int], ...] = (
    [],
    [DEFLATE],
    [FLETCHER32],
    [DEFLATE, FLETCHER32],
)  # a shuffle of bytes is none
_CHECKSUM_BYTES = 4
_NOT_THERE = "the file's index is damaged: a chunk is missing, or there twice"
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


def whole(dataset: h5py.Dataset) -> npt.NDArray[Any]:
    """Return all of a data set.

    Raises:
        ValueError: a chunk of it is not in the file; HDF5 would give zeros.
    """
    if dataset.chunks is not None:
        expected = math.prod(-(-side // chunk) for side, chunk in zip(dataset.shape, dataset.chunks, strict=True))
        found = {chunk.chunk_offset for chunk in _chunks(dataset)}
        if len(found) != expected or any(np.any(np.array(offset) >= dataset.shape) for offset in found):
            raise ValueError(_NOT_THERE)
    values: npt.NDArray[Any] = dataset[...]
    return values


def filters_of(dataset: h5py.Dataset) -> list[int]:
    """Return the codes of a data set's filters, in the order in which they were applied."""
    plist = dataset.id.get_create_plist()
    return [plist.get_filter(i)[0] for i in range(plist.get_nfilters())]


def identity_of(file: h5py.File) -> Identity:
    """Return `ByteFile.identity` of a file that HDF5 has open."""
    return _identity(file.filename if sys.platform == "win32" else file.id.get_vfd_handle())


class ByteFile:
    """A file that is open for reading, from any thread and in forked processes; closed once nobody holds it."""

    def __init__(self, path: Path) -> None:
        self._descriptor = os.open(path, os.O_RDONLY | getattr(os, "O_BINARY", 0))
        weakref.finalize(self, os.close, self._descriptor)  # so not while another thread reads

    @property
    def identity(self) -> Identity:
        """What tells it from a file that took its name."""
        return _identity(self._descriptor)

    def read(self, size: int, offset: int) -> bytes:
        """Return the bytes at a place.

        Raises:
            ValueError: the file ends before.
        """
        data = _pread(self._descriptor, size, offset)
        if len(data) != size:
            raise ValueError(f"the file ends {size - len(data)} bytes too early")
        return data


class Rows:
    """Where the rows of a data set of bytes lie, each a chunk; it outlives the HDF5 file that told it.

    gzip's adler32 is checked at reading, fletcher32 is not. A data set that is stored in another way than
    docs/format.md has it is left to HDF5, which opens the file again for each row.
    """

    def __init__(self, dataset: h5py.Dataset) -> None:
        self._path, self._name = dataset.file.filename, dataset.name
        self._shape, self._dtype = dataset.shape[1:], dataset.dtype
        self._size = math.prod(self._shape)
        self._places = _places(dataset) if _has_a_chunk_a_row(dataset) else None

    def read(self, row: int, file: ByteFile) -> npt.NDArray[Any]:
        """Return a row as a new array.

        Args:
            row: its number.
            file: the data set's.

        Raises:
            DataError: the row is damaged.
        """
        try:
            return self._by_hdf5(row) if self._places is None else self._by_place(self._places.get(row), file)
        except (*HDF5_ERRORS, _DEFLATE_ERROR) as error:
            raise DataError(
                f"{self._path}: row {row} cannot be read: {self._name.strip('/')}: {error}. "
                "`symsol-annot verify` checks the whole set"
            ) from None

    def _by_place(self, place: "_Place | None", file: ByteFile) -> npt.NDArray[Any]:
        if place is None:  # HDF5 would give zeros
            raise ValueError(_NOT_THERE)
        data = file.read(place.size, place.offset)
        if place.is_deflated:
            data = _inflated(data, self._size)
        return np.frombuffer(data, self._dtype).reshape(self._shape).copy()

    def _by_hdf5(self, row: int) -> npt.NDArray[Any]:
        with h5py.File(self._path, "r") as file:
            values: npt.NDArray[Any] = file[self._name][row]
        if values.shape != self._shape or values.dtype != self._dtype:
            raise ValueError(f"expected {self._dtype} of shape {self._shape}, found {values.dtype} of {values.shape}")
        return values


class _Place(NamedTuple):
    """Where a row lies in the file, without its fletcher32."""

    offset: int
    size: int
    is_deflated: bool


def _has_a_chunk_a_row(dataset: h5py.Dataset) -> bool:
    is_plain = dataset.dtype.itemsize == 1 and not dataset.file.userblock_size
    filters = [code for code in filters_of(dataset) if code != SHUFFLE]
    return is_plain and dataset.chunks == (1, *dataset.shape[1:]) and filters in _READABLE_FILTERS


def _places(dataset: h5py.Dataset) -> dict[int, _Place | None]:
    """Return where the rows lie, by row; None for one that is there twice."""
    filters = filters_of(dataset)
    places: dict[int, _Place | None] = {}
    for chunk in _chunks(dataset):
        applied = [code for bit, code in enumerate(filters) if not chunk.filter_mask >> bit & 1]
        size = chunk.size - (_CHECKSUM_BYTES if FLETCHER32 in applied else 0)
        row = chunk.chunk_offset[0]
        places[row] = None if row in places else _Place(chunk.byte_offset, max(0, size), DEFLATE in applied)
    return places


def _chunks(dataset: h5py.Dataset) -> list[Any]:
    """Return what HDF5 says of the chunks that are in the file."""
    found: list[Any] = []
    dataset.id.chunk_iter(found.append)
    return found


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
