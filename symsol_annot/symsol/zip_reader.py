"""The original SYMSOL zip, read as a file of unknown origin: nothing is unpacked to disk, or beyond the limits.

    {train,test}/images/{object}_{index:05d}.png
    {train,test}/rotations.npz      an array (n, m, 3, 3) per object: m rotations per image, the first the rendered one

The npz is a zip inside the zip, and is read through both, row after row. The zip's file is opened once.
"""

import hashlib
import io
import os
import re
import zipfile
from collections import defaultdict
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from threading import Lock

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError, bulleted
from symsol_annot.importing.pictures import PNG_HEADER_BYTES, decoded_png, most_bytes
from symsol_annot.importing.reading_errors import as_data_error
from symsol_annot.symsol.bounded_zip import member_faults, opened_zip, refuse_larger, refuse_ratio
from symsol_annot.symsol.rotation_table import RotationTable, TableHeader
from symsol_annot.system.closing import Closing
from symsol_annot.system.reading import open_regular
from symsol_annot.system.text.names import SPLITS

OBJECTS = ("tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO", "sphereX")
_IMAGE_NAME = re.compile(rf"({'|'.join(SPLITS)})/images/({'|'.join(OBJECTS)})_([0-9]{{5}})\.png")
_MAX_TABLE_BYTES = 2**34  # SYMSOL's would be 4 GB in float64


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
            with as_data_error(f"{path}: cannot be read as a zip"):
                self._zip = stack.enter_context(opened_zip(self._file))
            self._tables: dict[str, zipfile.ZipFile] = {}
            self._headers: dict[tuple[str, str], TableHeader] = {}
            faults = member_faults(self._zip) or self._open_tables(stack) or self._table_faults()
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
        with self._lock, as_data_error(what):
            info = self._tables[split].getinfo(f"{name}.npy")
            refuse_ratio(info)
            file = self._tables[split].open(info)
        with file:
            yield RotationTable(file, what)

    def image(self, name: str, split: str, index: int) -> npt.NDArray[np.uint8]:
        """Return an image (H, W, 3) as RGB; an alpha channel is left out. Any thread may ask.

        Raises:
            DataError: it is no PNG, damaged, of another kind of colour, or of a size that no set has.
        """
        member = f"{split}/images/{name}_{index:05d}.png"
        with as_data_error(f"{self.path}: {member}"):
            with self._lock:
                data = self._read_member(member)
            return decoded_png(data)

    def sha256(self) -> str:
        """Return the SHA-256 of the file, as hexadecimal.

        Raises:
            DataError: it cannot be read.
        """
        with self._lock, as_data_error(str(self.path)):
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
        refuse_ratio(info)
        with self._zip.open(info) as file:
            start = file.read(PNG_HEADER_BYTES)
            refuse_larger(info, most_bytes(start))
            return start + file.read(info.file_size)

    def _open_tables(self, stack: ExitStack) -> list[str]:
        faults = []
        for split in SPLITS:
            name = f"{split}/rotations.npz"
            if name not in self._zip.namelist():
                faults.append(f"{name} is missing")
                continue
            with as_data_error(f"{self.path}: {name}"):
                info = self._zip.getinfo(name)
                refuse_larger(info, _MAX_TABLE_BYTES)
                refuse_ratio(info)
                inner = stack.enter_context(self._zip.open(name))
                table = self._tables[split] = stack.enter_context(opened_zip(inner))
            faults += [f"{name}: {fault}" for fault in member_faults(table)]
            unknown = sorted(set(table.namelist()) - {f"{known}.npy" for known in OBJECTS})
            if unknown:
                faults.append(f"{name}: holds {', '.join(map(ascii, unknown[:5]))}, which is none of SYMSOL's objects")
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
