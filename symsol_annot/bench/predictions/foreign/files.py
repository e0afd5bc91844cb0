"""Arrays in files of unknown origin: .npz, .npy and CSV, read without running code and within limits."""

import csv
import io
import math
import zipfile
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import IO, Any

import numpy as np

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.errors import PredictionsError
from symsol_annot.system.reading import read_bytes, read_text

_MAX_BYTES = 2**32  # of a file, and of what it unpacks to
_MAX_ARRAYS = 64
_FORMAT: Any = np.lib.format  # whose functions have no types
_MAX_CSV_BYTES = 2**29
_BROKEN = (OSError, ValueError, EOFError, KeyError, NotImplementedError, RuntimeError, zipfile.BadZipFile, zlib.error)


def read_arrays(path: Path) -> dict[str, Array]:
    """Return the arrays of a file by their names; the one of a .npy is called "hypotheses".

    Raises:
        PredictionsError: it is missing, damaged, too large, or holds something else than numbers.
    """
    try:
        if path.suffix == ".csv":
            return _of_csv(path)
        data = io.BytesIO(read_bytes(path, _MAX_BYTES))
        if path.suffix == ".npy":
            return {"hypotheses": _array(data, len(data.getbuffer()))}
        return _of_npz(data)
    except OSError as error:
        raise _error(path, f"cannot be read: {error.strerror or error}") from None
    except PredictionsError:
        raise
    except _BROKEN as error:
        reason = str(error).strip().partition("\n")[0]
        raise _error(path, f"is no such file, or damaged: {reason or type(error).__name__}") from None


def _of_npz(data: IO[bytes]) -> dict[str, Array]:
    with zipfile.ZipFile(data) as file:
        members = [member for member in file.infolist() if member.filename.endswith(".npy")]
        if not members or len(members) > _MAX_ARRAYS:
            raise ValueError(f"expected 1 to {_MAX_ARRAYS} arrays, found {len(members)}")
        if sum(member.file_size for member in members) > _MAX_BYTES:
            raise ValueError(f"its arrays have more than {_MAX_BYTES:,} bytes")
        found = {}
        for member in members:
            with file.open(member) as opened:
                found[member.filename.removesuffix(".npy")] = _array(opened, member.file_size)
        return found


def _array(file: IO[bytes], size: int) -> Array:
    """Return the array of a .npy, given how many bytes that has."""
    version = _FORMAT.read_magic(file)
    read = {(1, 0): _FORMAT.read_array_header_1_0, (2, 0): _FORMAT.read_array_header_2_0}.get(version)
    if read is None:
        raise ValueError(f"version {version} of NumPy's format is not read")
    shape, is_fortran, dtype = read(file)
    if dtype.hasobject:
        raise ValueError("it holds Python objects, which are not read; save arrays of numbers")
    needed = math.prod(shape) * dtype.itemsize
    if needed > size:
        raise ValueError(f"an array of shape {shape} needs {needed:,} bytes, more than the {size:,} that are there")
    values = file.read(needed)
    if len(values) != needed:
        raise ValueError("an array ends too early")
    array: Array = np.frombuffer(bytearray(values), dtype)
    return array.reshape(shape, order="F" if is_fortran else "C")


def _of_csv(path: Path) -> dict[str, Array]:
    """Return a CSV's columns: image_index, weight if there is one, and the others, in their order, as "hypotheses"."""
    try:
        text = read_text(path, _MAX_CSV_BYTES)
    except UnicodeDecodeError:
        raise _error(path, "is no text in UTF-8, where a CSV belongs") from None
    rows = csv.reader(io.StringIO(text))
    header = [name.strip() for name in next(rows, [])]
    if "image_index" not in header or len(set(header)) < len(header):
        raise _error(
            path,
            "expected a first line of column names, each once, with image_index among them, found "
            f"{','.join(header)[:80]!r}",
        )
    table = []
    for number, row in enumerate(rows, 2):
        if not row:
            continue
        try:
            values = [float(value) for value in row]
        except ValueError as error:
            raise _error(path, f"line {number}: expected numbers: {error}") from None
        if len(values) != len(header):
            raise _error(path, f"line {number}: expected {len(header)} numbers, found {len(values)}")
        table.append(values)
    if not table:
        raise _error(path, "has no row of numbers below its first line")
    columns = dict(zip(header, np.array(table).T, strict=True))
    index = columns.pop("image_index")
    if not (np.isfinite(index).all() and (index == np.rint(index)).all()):
        raise _error(path, "image_index: expected whole numbers")
    weight = columns.pop("weight", None)
    if not columns:
        raise _error(path, "has no columns of rotations beside image_index")
    found = {"image_index": index.astype(np.int64), "hypotheses": np.stack(list(columns.values()), axis=1)}
    return found if weight is None else {**found, "hypothesis_weights": weight}


def by_image(index: Array, rows: Array) -> Mapping[int, Array]:
    """Return image to its rows, in their order."""
    order = np.argsort(index, kind="stable")
    images, starts = np.unique(index[order], return_index=True)
    return dict(zip(images.tolist(), np.split(rows[order], starts[1:]), strict=True))


def _error(path: Path, fault: str) -> PredictionsError:
    return PredictionsError(str(path), [f"the file: {fault}"])
