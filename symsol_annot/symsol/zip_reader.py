"""The original SYMSOL zip, read as a stranger's file: nothing is unpacked to disk, and nothing beyond its limits.

    {train,test}/images/{object}_{index:05d}.png
    {train,test}/rotations.npz      an array (n, m, 3, 3) per object: m rotations per image, the first the rendered one

The npz is a zip inside the zip, and is read through both, row after row. The zip's file is opened once.
"""

import ast
import hashlib
import io
import os
import re
import struct
import zipfile
import zlib
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import IO, Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError, bulleted
from symsol_annot.rendering.scene import SIZE_RANGE
from symsol_annot.sets.png import PNG_SIGNATURE
from symsol_annot.system.closing import Closing
from symsol_annot.system.reading import open_regular
from symsol_annot.system.text.names import SPLITS

OBJECTS = ("tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO", "sphereX")
MAX_IMAGES, MAX_LISTED = 100_000, 1000  # of an object in a split; rotations per image, SYMSOL's 720 at most
_IMAGE_NAME = re.compile(rf"({'|'.join(SPLITS)})/images/({'|'.join(OBJECTS)})_([0-9]{{5}})\.png")
_MAX_DIRECTORY_BYTES = 50_000_000  # of a zip; SYMSOL's 400,000 files take about 40 MB, a million names 1 GB of memory
_MAX_READ_BYTES = 2**28  # at once, of what is packed
_MAX_TABLE_BYTES = 2**34  # SYMSOL's would be 4 GB in float64
_MAX_RATIO, _RATIO_SLACK = 20, 2**16  # unpacked to packed; rotations reach 4, PNG files 1, a bomb of zeros 1,000
_PNG_SLACK = 2**16  # what a PNG may have beyond its pixels
_PNG_KEPT = (b"IHDR", b"PLTE", b"IDAT", b"IEND")  # what decides the pixels; of the rest nothing reaches the decoder
_LOCAL_HEADER_BYTES = 30
_MAX_HEADER_BYTES = 10_000  # of an npy file; beyond, Python's parser may take long
_LENGTHS = {(1, 0): "<H", (2, 0): "<I"}  # version of an npy file to the type of its header's length
_DTYPES = ("<f4", "<f8")
_MAX_NAME, _MAX_SIDE = 100, 2**63
_NPY_START = b"\x93NUMPY"
_PNG_START = PNG_SIGNATURE + b"\0\0\0\rIHDR"
_PNG_HEADER_BYTES = len(_PNG_START) + 17  # with the header's 13 bytes and their checksum
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
        with ExitStack() as stack:
            self._file = stack.enter_context(_opened(path))
            self._stamp = self._stamp_now()
            with _as_data_error(f"{path}: cannot be read as a zip"):
                self._zip = stack.enter_context(_opened_zip(self._file))
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
            info = self._tables[split].getinfo(f"{name}.npy")
            _refuse_ratio(info)
            file = self._tables[split].open(info)
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

    def sha256(self) -> str:
        """Return the SHA-256 of the file, as hexadecimal.

        Raises:
            DataError: it cannot be read.
        """
        with self._lock, _as_data_error(str(self.path)):
            self._file.seek(0)
            return hashlib.file_digest(self._file, "sha256").hexdigest()

    def refuse_change(self) -> None:
        """Refuse a file that was written to since it was opened, as far as its size and time tell.

        Raises:
            DataError: it was.
        """
        if self._stamp_now() != self._stamp:
            raise DataError(f"{self.path}: was changed while it was read; run the same command once it is whole")

    def close(self) -> None:
        """Close the file."""
        self._open_files.close()

    def _stamp_now(self) -> tuple[int, int]:
        status = os.fstat(self._file.fileno())
        return status.st_size, status.st_mtime_ns

    def _read_member(self, member: str) -> bytes:
        """Return a PNG's bytes, no more than its pixels can have a use for."""
        info = self._zip.getinfo(member)
        _refuse_ratio(info)
        with self._zip.open(info) as file:
            start = file.read(_PNG_HEADER_BYTES)
            width, height = _png_size(start)
            _refuse_larger(info, width * height * len(_MODES[-1]) + _PNG_SLACK)
            return start + file.read(info.file_size)

    def _open_tables(self, stack: ExitStack) -> list[str]:
        faults = []
        for split in SPLITS:
            name = f"{split}/rotations.npz"
            if name not in self._zip.namelist():
                faults.append(f"{name} is missing")
                continue
            with _as_data_error(f"{self.path}: {name}"):
                info = self._zip.getinfo(name)
                _refuse_larger(info, _MAX_TABLE_BYTES)
                _refuse_ratio(info)
                inner = stack.enter_context(self._zip.open(name))
                table = self._tables[split] = stack.enter_context(_opened_zip(inner))
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


def _opened(path: Path) -> io.BufferedReader:
    try:
        return os.fdopen(open_regular(path), "rb")
    except FileNotFoundError:
        found = "no such file"
    except OSError as error:
        found = error.strerror or str(error)
    raise DataError(f"{path}: {found}; expected the zip of the original SYMSOL, symsol_dataset.zip")


class _Bounded:
    """A file for `zipfile`, which reads a zip's list of files at once, whatever size the zip says that it has."""

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self.limit = _MAX_DIRECTORY_BYTES

    def read(self, size: int = -1) -> bytes:
        if size > self.limit:
            raise ValueError(f"its list of files has {size:,} bytes, more than the {self.limit:,} allowed")
        return self._file.read(self.limit if size < 0 else size)  # all is asked for of a zip's last 64 KiB alone

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)


def _opened_zip(file: IO[bytes]) -> zipfile.ZipFile:
    bounded: Any = _Bounded(file)
    opened = zipfile.ZipFile(bounded)
    bounded.limit = _MAX_READ_BYTES
    return opened


def _member_faults(file: zipfile.ZipFile) -> list[str]:
    """List what a zip may not hold: names twice, encryption, odd packings, files that lie over each other."""
    members = file.infolist()
    if len(set(file.namelist())) < len(members):
        return ["holds files of the same name"]
    odd = [info for info in members if info.flag_bits & _ENCRYPTED or info.compress_type not in _METHODS]
    if odd:
        return [f"{_shown(odd[0])} is encrypted, or packed by another method than deflate"]
    ordered = sorted(members, key=lambda info: info.header_offset)
    for info, following in pairwise(ordered):
        if info.header_offset + _LOCAL_HEADER_BYTES + info.compress_size > following.header_offset:
            return [f"{_shown(info)} and {_shown(following)} lie over each other"]
    return []


def _shown(info: zipfile.ZipInfo) -> str:
    return f"{info.filename[:_MAX_NAME]!a}"


def _refuse_larger(info: zipfile.ZipInfo, limit: int) -> None:
    """Refuse a file that says it unpacks to more; none gives more than it says."""
    if info.file_size > limit:
        raise ValueError(f"is of {info.file_size} bytes, more than the {limit} allowed")


def _refuse_ratio(info: zipfile.ZipInfo) -> None:
    """Refuse a file that says it unpacks to much more than images and rotations can."""
    if info.file_size > _MAX_RATIO * info.compress_size + _RATIO_SLACK:
        raise ValueError(f"is of {info.file_size} bytes in {info.compress_size}, as only a bomb is packed")


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


def _png_size(data: bytes) -> tuple[int, int]:
    """Return width and height of a PNG, within those that a set may have, before any memory is taken for them."""
    if not data.startswith(_PNG_START) or len(data) < _PNG_HEADER_BYTES:
        raise ValueError("is no PNG")
    width, height = struct.unpack_from(">II", data, len(_PNG_START))
    low, high = SIZE_RANGE
    if not (low <= width <= high and low <= height <= high):
        raise ValueError(f"is {width} x {height} pixels, expected {low} to {high} each way")
    return width, height


def _decoded(data: bytes) -> npt.NDArray[np.uint8]:
    from PIL import Image  # noqa: PLC0415 - slow to import

    with Image.open(io.BytesIO(_plain_png(data)), formats=["PNG"]) as picture:
        if picture.mode not in _MODES:
            raise ValueError(f"is a PNG of mode {picture.mode}, expected 8-bit {' or '.join(_MODES)}")
        return np.asarray(picture.convert("RGB"))


def _plain_png(data: bytes) -> bytes:
    """Return a PNG with the parts alone that decide its pixels: no second header, text, profile or animation."""
    kept, place, kind = [PNG_SIGNATURE], len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, place) if place + 8 <= len(data) else (len(data), b"")
        end = place + 12 + length  # behind length, kind and checksum
        if end > len(data):
            raise ValueError("image file is truncated")
        if kind == b"IHDR" and len(kept) > 1:
            raise ValueError("is a PNG with two headers")
        if kind in _PNG_KEPT:
            kept.append(data[place:end])
        place = end
    return b"".join(kept)


@contextmanager
def _as_data_error(what: str) -> Iterator[None]:
    try:
        yield
    except _READING_ERRORS as error:
        raise DataError(f"{what}: {error or type(error).__name__}") from None
