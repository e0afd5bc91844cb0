"""Files of safetensors from any source: what their headers say is checked before memory is taken for it.

A file is opened once and read through that, so that a header and its tensors are those of one file, whatever becomes
of its name meanwhile. Nothing is mapped into memory: a file cut off while it is mapped would end the process.
"""

import hashlib
import io
import json
import math
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO, TypeAlias

import torch

from symsol_annot.system.reading import open_regular

StateDict: TypeAlias = dict[str, torch.Tensor]

MAX_HEADER_BYTES = 2**24  # the figures of 10,000 epochs take a quarter of it
MAX_FILE_BYTES = 2**30  # a network of 10,000 hypotheses with Adam's means has half of that
_MAX_TENSORS, _MAX_DIMENSIONS = 4096, 8
_LENGTH_BYTES = 8
_DTYPES = {
    "F64": torch.float64,
    "F32": torch.float32,
    "F16": torch.float16,
    "BF16": torch.bfloat16,
    "C64": torch.complex64,
    "I64": torch.int64,
    "I32": torch.int32,
    "I16": torch.int16,
    "I8": torch.int8,
    "U8": torch.uint8,
}


@dataclass(frozen=True)
class Content:
    """What a file holds.

    Attributes:
        metadata: texts by their names.
        tensors: by their names, on the CPU.
        sha256: of the bytes that were read.
    """

    metadata: Mapping[str, str]
    tensors: StateDict
    sha256: str


@dataclass(frozen=True)
class _Place:
    """Where a tensor lies behind the header."""

    name: str
    dtype: torch.dtype
    shape: tuple[int, ...]
    begin: int
    end: int


def read_metadata(path: Path) -> Mapping[str, str]:
    """Return a file's metadata, without reading its tensors.

    Raises:
        OSError: it is missing, unreadable, or no regular file.
        ValueError: it is damaged, or no file of safetensors.
    """
    with os.fdopen(open_regular(path), "rb") as file:
        return _read_header(file, os.fstat(file.fileno()).st_size)[0]


def read_content(path: Path) -> Content:
    """Return all that a file holds.

    Raises:
        OSError: it is missing, unreadable, or no regular file.
        ValueError: it is damaged, or no file of safetensors.
    """
    with os.fdopen(open_regular(path), "rb") as file:
        return _read(file, os.fstat(file.fileno()).st_size)


def parse_content(data: bytes) -> Content:
    """Return all that a file's bytes hold.

    Raises:
        ValueError: they are damaged, or no file of safetensors.
    """
    return _read(io.BytesIO(data), len(data))


def _read(file: BinaryIO, size: int) -> Content:
    metadata, places, start = _read_header(file, size)
    file.seek(0)
    digest = hashlib.sha256(_exactly(file, start))
    tensors: StateDict = {}
    for place in places:
        data = _exactly(file, place.end - place.begin)
        digest.update(data)
        values = torch.frombuffer(data, dtype=place.dtype) if data else torch.empty(0, dtype=place.dtype)
        tensors[place.name] = values.reshape(place.shape)
    return Content(metadata, tensors, digest.hexdigest())


def _read_header(file: BinaryIO, size: int) -> tuple[Mapping[str, str], list[_Place], int]:
    """Return the metadata, the tensors' places in the order in which they lie, and where the first byte lies."""
    if size > MAX_FILE_BYTES:
        raise ValueError(f"it has {size:,} bytes, more than the {MAX_FILE_BYTES:,} that are read")
    length = int.from_bytes(_exactly(file, _LENGTH_BYTES), "little")
    if length > size - _LENGTH_BYTES:
        raise ValueError(f"its header is said to have {length:,} bytes, in a file of {size:,}")
    if length > MAX_HEADER_BYTES:
        raise ValueError(f"its header has {length:,} bytes, more than the {MAX_HEADER_BYTES:,} that are read")
    header = _parsed_header(bytes(_exactly(file, length)))
    metadata = header.pop("__metadata__", {})
    if not isinstance(metadata, dict) or not all(isinstance(value, str) for value in metadata.values()):
        raise ValueError("its metadata are expected to be texts by their names")
    if len(header) > _MAX_TENSORS:
        raise ValueError(f"it holds {len(header):,} tensors, more than the {_MAX_TENSORS:,} that are read")
    places = sorted((_place(name, said) for name, said in header.items()), key=lambda place: (place.begin, place.end))
    start = _LENGTH_BYTES + length
    end = 0
    for place in places:
        if place.begin != end:
            raise ValueError(f"tensor {place.name!r:.80} begins at {place.begin}, expected {end}, where another ends")
        end = place.end
    if start + end != size:
        raise ValueError(f"its header tells of {start + end:,} bytes, the file has {size:,}")
    return metadata, places, start


def _parsed_header(text: bytes) -> dict[str, Any]:
    try:
        header = json.loads(text.decode())
    except RecursionError:
        raise ValueError("its header is nested too deep") from None
    if type(header) is not dict:
        raise ValueError("its header is expected to be tensors by their names")
    return header


def _place(name: str, said: Any) -> _Place:
    """Return a tensor's place from what the header says of it."""
    is_known = isinstance(said, dict) and set(said) == {"dtype", "shape", "data_offsets"}
    if not is_known or not isinstance(said["dtype"], str) or said["dtype"] not in _DTYPES:
        raise ValueError(f"tensor {name!r:.80} is expected to have a type of {', '.join(_DTYPES)}, a shape and offsets")
    shape, offsets, dtype = said["shape"], said["data_offsets"], _DTYPES[said["dtype"]]
    if not _are_sizes(shape) or len(shape) > _MAX_DIMENSIONS or not _are_sizes(offsets) or len(offsets) != 2:
        raise ValueError(f"tensor {name!r:.80} is expected to have a shape of up to {_MAX_DIMENSIONS} whole numbers")
    begin, end = offsets
    expected = math.prod(shape) * dtype.itemsize
    if end - begin != expected:
        raise ValueError(
            f"tensor {name!r:.80} is expected to have {expected:,} bytes by its shape, found {end - begin:,}"
        )
    return _Place(name, dtype, tuple(shape), begin, end)


def _are_sizes(values: Any) -> bool:
    return isinstance(values, list) and all(type(value) is int and 0 <= value <= MAX_FILE_BYTES for value in values)


def _exactly(file: BinaryIO, size: int) -> bytearray:
    data = bytearray(size)
    if file.readinto(data) != size:  # type: ignore[attr-defined]
        raise ValueError("it ends before its last byte, or was changed while it was read")
    return data
