"""An object's rotations in the original SYMSOL: an npy file inside a zip, read row after row and within limits."""

import ast
import struct
from dataclasses import dataclass
from typing import IO

import numpy as np
import numpy.typing as npt

from symsol_annot.importing.reading_errors import as_data_error

MAX_IMAGES, MAX_LISTED = 100_000, 1000  # of an object in a split; rotations per image, SYMSOL's 720 at most
_MAX_HEADER_BYTES = 10_000  # of an npy file; beyond, Python's parser may take long
_LENGTHS = {(1, 0): "<H", (2, 0): "<I"}  # version of an npy file to the type of its header's length
_DTYPES = ("<f4", "<f8")
_MAX_SIDE = 2**63
_NPY_START = b"\x93NUMPY"


@dataclass(frozen=True)
class TableHeader:
    """What an object's array of rotations says of itself.

    Attributes:
        images: n.
        listed: m, how many rotations are listed for each image.
        dtype: "<f4" or "<f8".
    """

    images: int
    listed: int
    dtype: str


class RotationTable:
    """An object's rotations in a split, read from the first image to the last."""

    def __init__(self, file: IO[bytes], what: str) -> None:
        self._file, self._what = file, what
        with as_data_error(what):
            self.header = _read_header(file)

    def read(self, images: int) -> npt.NDArray[np.float64]:
        """Return the rotations (images, m, 3, 3) of the next images.

        Raises:
            DataError: the array is damaged or ends too early.
        """
        shape = (images, self.header.listed, 3, 3)
        size = int(np.prod(shape)) * np.dtype(self.header.dtype).itemsize
        with as_data_error(self._what):
            data = self._file.read(size)
            if len(data) != size:
                raise ValueError("it ends before its last image")
            found = np.frombuffer(data, self.header.dtype).reshape(shape).astype(np.float64)
            found[np.isinf(found)] = np.nan  # which is no rotation either, and subtracts without a warning
        return found


def _read_header(file: IO[bytes]) -> TableHeader:
    """Read the header of an npy file, of which nothing else is trusted: no objects, no other shape or type."""
    start = file.read(len(_NPY_START) + 2)
    version = tuple(start[len(_NPY_START) :])
    if not start.startswith(_NPY_START) or version not in _LENGTHS:
        raise ValueError(f"is no npy file of version 1.0 or 2.0, begins with {start!r}")
    (length,) = struct.unpack(_LENGTHS[version], file.read(struct.calcsize(_LENGTHS[version])))
    if length > _MAX_HEADER_BYTES:
        raise ValueError(f"its header has {length} bytes, more than the {_MAX_HEADER_BYTES} allowed")
    descr, is_fortran, shape = _header_parts(file.read(length))
    if descr not in _DTYPES or is_fortran or len(shape) != 4 or shape[2:] != (3, 3) or min(shape) < 1:
        expected = "an array (n, m, 3, 3) of little-endian float32 or float64, row by row"
        raise ValueError(f"expected {expected}, found {shape} of {descr}{', by columns' if is_fortran else ''}")
    if shape[0] > MAX_IMAGES or shape[1] > MAX_LISTED:
        raise ValueError(f"is of shape {shape}, beyond the {MAX_IMAGES} images and {MAX_LISTED} rotations allowed")
    return TableHeader(shape[0], shape[1], descr)


def _header_parts(text: bytes) -> tuple[str, bool, tuple[int, ...]]:
    try:
        said = ast.literal_eval(text.decode("latin-1").strip())
    except (SyntaxError, ValueError, TypeError, MemoryError, RecursionError):
        said = None
    if not isinstance(said, dict) or set(said) != {"descr", "fortran_order", "shape"}:
        raise ValueError("its header is none of an npy file")
    descr, is_fortran, shape = said["descr"], said["fortran_order"], said["shape"]
    is_shape = isinstance(shape, tuple) and all(type(side) is int and abs(side) < _MAX_SIDE for side in shape)
    if not isinstance(descr, str) or type(is_fortran) is not bool or not is_shape:
        raise ValueError("its header tells of no array of numbers")
    return descr, is_fortran, shape
