"""The original SYMSOL zip, read as a stranger's file: nothing is unpacked to disk, and nothing beyond its limits.

    {train,test}/images/{object}_{index:05d}.png
    {train,test}/rotations.npz      an array (n, m, 3, 3) an object: m rotations an image, the first the rendered one

The npz is a zip inside the zip, and is read through both, row after row.
"""

import io
import re
import struct
import zipfile
import zlib
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from symsol_annot.closing import Closing
from symsol_annot.errors import DataError, bulleted
from symsol_annot.manifest import SPLITS
from symsol_annot.png import PNG_SIGNATURE
from symsol_annot.scene import SIZE_RANGE

OBJECTS = ("tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO", "sphereX")
MAX_IMAGES, MAX_LISTED = 100_000, 3600  # of an object in a split; rotations an image
_IMAGE_NAME = re.compile(rf"({'|'.join(SPLITS)})/images/({'|'.join(OBJECTS)})_([0-9]{{5}})\.png")
_MAX_PNG_BYTES = 2**25
_MAX_TABLE_BYTES = 2**34  # SYMSOL's would be 4 GB in float64; a bomb of zeros is through in a minute
_MAX_HEADER_BYTES = 10_000  # of an npy file; beyond, Python's parser may take long
_DTYPES = ("<f4", "<f8")
_PNG_START = PNG_SIGNATURE + b"\0\0\0\rIHDR"
_MODES = ("RGB", "RGBA")
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_ENCRYPTED = 1  # flag
_READING_ERRORS = (
    OSError,  # Pillow's and the operating system's
    EOFError,
    KeyError,
    NotImplementedError,
    OverflowError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
    Warning,
)


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
        with _as_data_error(what):
            self.header = _read_header(file)

    def read(self, images: int) -> npt.NDArray[np.float64]:
        """Return the rotations (images, m, 3, 3) of the next images.

        Raises:
            DataError: the array is damaged or ends too early.
        """
        shape = (images, self.header.listed, 3, 3)
        size = int(np.prod(shape)) * np.dtype(self.header.dtype).itemsize
        with _as_data_error(self._what):
            data = self._file.read(size)
            if len(data) != size:
                raise ValueError("it ends before its last image")
        return np.frombuffer(data, self.header.dtype).reshape(shape).astype(np.float64)


class SymsolZip(Closing):
    """An open zip whose list of files was checked: for every rotation an image, and no image without.

    Attributes:
        path: of the zip.
        objects: those that are in it, in SYMSOL's order.

    Raises:
        DataError: it is no zip, or not laid out as SYMSOL's; the message lists every fault.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = Lock()  # a zip is opened at one place at a time
        if not path.is_file():
            found = "is no regular file" if path.exists() else "no such file"
            raise DataError(f"{path}: {found}; expected the zip of the original SYMSOL, symsol_dataset.zip")
        with ExitStack() as stack:
            with _as_data_error(f"{path}: cannot be read as a zip"):
                self._zip = stack.enter_context(zipfile.ZipFile(path))
            self._tables: dict[str, zipfile.ZipFile] = {}
            self._headers: dict[tuple[str, str], TableHeader] = {}
            faults = _member_faults(self._zip) or self._open_tables(stack) or self._table_faults()
            faults = faults or self._image_faults()
            if faults:
                listed = bulleted(faults)
                raise DataError(f"{path}: is not laid out as the original SYMSOL:\n{listed}")
            self._open_files = stack.pop_all()

    def header(self, name: str, split: str) -> TableHeader:
        """Return how many images a split of an object has, and how many rotations are listed for each."""
        return self._headers[name, split]

    @contextmanager
    def rotations(self, name: str, split: str) -> Iterator[RotationTable]:
        """Open an object's rotations, at the first image."""
        what = f"{self.path}: {split}/rotations.npz: {name}"
        with self._lock, _as_data_error(what):
            file = self._tables[split].open(f"{name}.npy")
        with file:
            yield RotationTable(file, what)

    def image(self, name: str, split: str, index: int) -> npt.NDArray[np.uint8]:
        """Return an image (H, W, 3) as RGB; an alpha channel is left out. Any thread may ask.

        Raises:
            DataError: it is no PNG, damaged, of another kind of colour, or of a size that no set has.
        """
        member = f"{split}/images/{name}_{index:05d}.png"
        with _as_data_error(f"{self.path}: {member}"):
            with self._lock:
                data = self._read_member(member)
            return _decoded(data)

    def close(self) -> None:
        """Close the file."""
        self._open_files.close()

    def _read_member(self, member: str) -> bytes:
        info = self._zip.getinfo(member)
        _refuse_larger(info, _MAX_PNG_BYTES)
        with self._zip.open(info) as file:
            return file.read(_MAX_PNG_BYTES)

    def _open_tables(self, stack: ExitStack) -> list[str]:
        faults = []
        for split in SPLITS:
            name = f"{split}/rotations.npz"
            if name not in self._zip.namelist():
                faults.append(f"{name} is missing")
                continue
            with _as_data_error(f"{self.path}: {name}"):
                _refuse_larger(self._zip.getinfo(name), _MAX_TABLE_BYTES)
                inner = stack.enter_context(self._zip.open(name))
                table = self._tables[split] = stack.enter_context(zipfile.ZipFile(inner))
            faults += [f"{name}: {fault}" for fault in _member_faults(table)]
            strangers = sorted(set(table.namelist()) - {f"{known}.npy" for known in OBJECTS})
            if strangers:
                faults.append(
                    f"{name}: holds {', '.join(map(ascii, strangers[:5]))}, which is none of SYMSOL's objects"
                )
        return faults

    def _table_faults(self) -> list[str]:
        """Read what the arrays say of themselves, in the order in which they lie; return the faults."""
        for split, table in self._tables.items():
            for info in sorted(table.infolist(), key=lambda info: info.header_offset):
                name = info.filename.removesuffix(".npy")
                with self.rotations(name, split) as opened:
                    self._headers[name, split] = opened.header
        self.objects = tuple(name for name in OBJECTS if any((name, split) in self._headers for split in SPLITS))
        return [
            f"{split}/rotations.npz: has no {name}, the other split has"
            for name in self.objects
            for split in SPLITS
            if (name, split) not in self._headers
        ] or ([] if self.objects else ["its rotations.npz hold no object"])

    def _image_faults(self) -> list[str]:
        indices: dict[tuple[str, str], set[int]] = defaultdict(set)
        for member in self._zip.namelist():
            match = _IMAGE_NAME.fullmatch(member)
            if match:
                indices[match[2], match[1]].add(int(match[3]))
        faults = []
        for name, split in sorted({*indices, *self._headers}):
            header = self._headers.get((name, split))
            expected, there = set(range(header.images if header else 0)), indices[name, split]
            if expected - there:
                faults.append(_image_fault(name, split, expected - there, "is missing, though it has rotations"))
            if there - expected:
                faults.append(_image_fault(name, split, there - expected, "has no rotations"))
        return faults


def _image_fault(name: str, split: str, indices: set[int], what: str) -> str:
    more = f"; {len(indices)} such images" if len(indices) > 1 else ""
    return f"{split}/images/{name}_{min(indices):05d}.png {what}{more}"


def _member_faults(file: zipfile.ZipFile) -> list[str]:
    """List what a zip may not hold: names twice, encryption, packings that unpack to more than deflate can."""
    names = file.namelist()
    if len(set(names)) < len(names):
        return ["holds files of the same name"]
    odd = [info for info in file.infolist() if info.flag_bits & _ENCRYPTED or info.compress_type not in _METHODS]
    return [f"{odd[0].filename!a} is encrypted, or packed by another method than deflate"] if odd else []


def _refuse_larger(info: zipfile.ZipInfo, limit: int) -> None:
    """Refuse a file that says it unpacks to more; none gives more than it says."""
    if info.file_size > limit:
        raise ValueError(f"is of {info.file_size} bytes, more than the {limit} allowed")


def _read_header(file: IO[bytes]) -> TableHeader:
    """Read the header of an npy file, of which nothing else is trusted: no objects, no other shape or type."""
    npy: Any = np.lib.format  # numpy's annotations lack half of it
    version = npy.read_magic(file)
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    if version not in readers:
        raise ValueError(f"is an npy file of version {version}")
    shape, is_fortran, dtype = readers[version](file, max_header_size=_MAX_HEADER_BYTES)
    if dtype.str not in _DTYPES or is_fortran or len(shape) != 4 or shape[2:] != (3, 3) or min(shape) < 1:
        expected = "an array (n, m, 3, 3) of little-endian float32 or float64, row by row"
        raise ValueError(f"expected {expected}, found {shape} of {dtype.str}{', by columns' if is_fortran else ''}")
    if shape[0] > MAX_IMAGES or shape[1] > MAX_LISTED:
        raise ValueError(f"is of shape {shape}, beyond the {MAX_IMAGES} images and {MAX_LISTED} rotations allowed")
    return TableHeader(int(shape[0]), int(shape[1]), dtype.str)


def _decoded(data: bytes) -> npt.NDArray[np.uint8]:
    if not data.startswith(_PNG_START) or len(data) < len(_PNG_START) + 8:
        raise ValueError("is no PNG")
    width, height = struct.unpack_from(">II", data, len(_PNG_START))  # before any memory is taken for it
    low, high = SIZE_RANGE
    if not (low <= width <= high and low <= height <= high):
        raise ValueError(f"is {width} x {height} pixels, expected {low} to {high} each way")
    from PIL import Image  # noqa: PLC0415 - slow to import

    with Image.open(io.BytesIO(data), formats=["PNG"]) as picture:
        if picture.mode not in _MODES:
            raise ValueError(f"is a PNG of mode {picture.mode}, expected 8-bit {' or '.join(_MODES)}")
        return np.asarray(picture.convert("RGB"))


@contextmanager
def _as_data_error(what: str) -> Iterator[None]:
    try:
        yield
    except _READING_ERRORS as error:
        raise DataError(f"{what}: {error or type(error).__name__}") from None
