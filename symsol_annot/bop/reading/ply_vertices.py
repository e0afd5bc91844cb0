"""The vertices of a PLY file of unknown origin, ASCII or binary; nothing else of it is read."""

import hashlib
import io
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.bop.reading.json_files import MAX_NUMBER, check_inside
from symsol_annot.errors import DataError
from symsol_annot.system.reading import read_bytes

MAX_PLY_BYTES = 2**28
_MAX_HEADER_BYTES = 2**16
_END = b"end_header"
_TYPES = {
    name: f"{kind}{size}"
    for kind, size, names in (
        *(("i", 1, "char int8"), ("i", 2, "short int16"), ("i", 4, "int int32")),
        *(("u", 1, "uchar uint8"), ("u", 2, "ushort uint16"), ("u", 4, "uint uint32")),
        *(("f", 4, "float float32"), ("f", 8, "double float64")),
    )
    for name in names.split()
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class PlyVertices:
    """The vertices of a file.

    Attributes:
        path: of the file.
        sha256: of its bytes.
        points: (V, 3) at least one.
    """

    path: Path
    sha256: str
    points: npt.NDArray[np.float64]


def read_vertices(root: Path, path: Path) -> PlyVertices:
    """Read the vertices of a PLY file of a dataset.

    Args:
        root: the dataset's folder.
        path: of the file.

    Raises:
        DataError: it is none, damaged, too large, or a link out of the dataset.
    """
    check_inside(root, path)
    try:
        data = read_bytes(path, MAX_PLY_BYTES)
        points = _points(data)
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise DataError(
            f"{path}: cannot be read as PLY: {error}; without this file, models_info.json is asked for the size"
        ) from None
    return PlyVertices(path, hashlib.sha256(data).hexdigest(), points)


def _points(data: bytes) -> npt.NDArray[np.float64]:
    order, count, properties, start = _header(data)
    columns = [name for name, _ in properties]
    if order:
        dtype = np.dtype([(name, order + kind) for name, kind in properties])
        if count * dtype.itemsize > len(data) - start:
            raise ValueError(f"it is too short for its {count:,} vertices")
        table = np.frombuffer(data, dtype, count, start)
        points = np.stack([table[axis].astype(np.float64) for axis in _AXES], axis=1)
    else:
        if 2 * count * len(columns) > len(data) - start + 1:  # a digit and what is behind it
            raise ValueError(f"it is too short for its {count:,} vertices")
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of no lines
            points = np.loadtxt(
                io.BytesIO(data[start:]),
                max_rows=count,
                usecols=[columns.index(axis) for axis in _AXES],
                comments=None,
                ndmin=2,
            )
    if points.shape != (count, 3) or not (np.abs(points) <= MAX_NUMBER).all():  # nor NaN
        raise ValueError(f"expected {count:,} vertices of three numbers within {MAX_NUMBER:g} of 0")
    return points


def _header(data: bytes) -> tuple[str, int, list[tuple[str, str]], int]:
    """Return the order of bytes, "" for ASCII; how many vertices; their properties; where the first one begins."""
    place = data.find(_END, 0, _MAX_HEADER_BYTES)
    end = data.find(b"\n", place, place + len(_END) + 2)
    if not data.startswith(b"ply") or place < 0 or end < 0:
        raise ValueError("it has no header of a PLY file")
    lines = [words for line in data[:place].decode("latin-1").splitlines() if (words := line.split())]
    formats = [line[1] for line in lines if line[0] == "format" and len(line) == 3]
    if len(formats) != 1 or formats[0] not in _FORMATS:
        raise ValueError(f"expected a format of {', '.join(_FORMATS)}")
    elements = [number for number, line in enumerate(lines) if line[0] == "element"]
    first, second = [*elements, len(lines), len(lines)][:2]
    if not elements or lines[first][1:2] != ["vertex"] or len(lines[first]) != 3 or not lines[first][2].isdecimal():
        raise ValueError("expected vertices as its first element")
    properties = [line for line in lines[first + 1 : second] if line[0] == "property"]
    if any(len(line) != 3 or line[1] not in _TYPES for line in properties):
        raise ValueError("a vertex has a property of no known type")
    named = [(name, _TYPES[kind]) for _, kind, name in properties]
    names = [name for name, _ in named]
    if len(set(names)) < len(names) or not set(_AXES) <= set(names):
        raise ValueError("expected x, y and z of a vertex, each property once")
    count = int(lines[first][2][:10])
    if count < 1:
        raise ValueError("it has no vertices")
    return _FORMATS[formats[0]], count, named, end + 1
