"""The HDF5 shard, opened safely: a stranger's file is held against docs/format.md before anything of it is read.

HDF5 sees the file in a child process alone, which says what the file is and where its chunks lie. The bytes of the
chunks are read here, from the file itself.
"""

import atexit
import contextlib
import hashlib
import json
import os
import threading
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DamageError, DataError, bulleted
from symsol_annot.objects.spec import MAX_GROUP_ORDER
from symsol_annot.rendering.scene import SIZE_RANGE
from symsol_annot.sets.shard.chunks import DEFLATE, FLETCHER32, ByteFile, Place, StoredArray, largest_chunk
from symsol_annot.sets.shard.header import (
    ALL_ATTRIBUTES,
    DATASETS_NOT_IMPORTED,
    IMAGE_DATASETS,
    MAX_IMAGES_PER_SHARD,
    SHARD_FORMAT,
    SHARD_FORMAT_VERSION,
    attribute_kinds,
    content_heading,
)
from symsol_annot.system.sandbox.hdf5_process import DatasetFacts, Description, Hdf5Process, Limits

GROUP = "symmetry_group"
ROW_PER_CHUNK = ("image", "segmentation")
_LIMITS = Limits(seconds=60.0, processor_seconds=2.0, memory_bytes=2**30)  # a good shard takes 0.01 s
_FILTERS = (DEFLATE, FLETCHER32)
_IN_WORDS = {"text": "a string", "whole": "a whole number", "real": "a number"}
_SHOWN_CHARACTERS = 80


@dataclass(frozen=True, eq=False)
class Shard:
    """An open shard whose structure is the format's; what its arrays hold is for `shard_laws` to say.

    Attributes:
        path: of the file.
        file: of its bytes.
        attributes: as docs/format.md lists them.
        arrays: data sets by name.
    """

    path: Path
    file: ByteFile
    attributes: Mapping[str, Any]
    arrays: Mapping[str, StoredArray]

    def __len__(self) -> int:
        return self.arrays["rotation"].shape[0]

    @property
    def is_imported(self) -> bool:
        """Whether its images are from elsewhere."""
        return "source" in self.attributes

    @property
    def is_annotated(self) -> bool:
        """Whether its images have symmetry sets."""
        return "symmetry_mask" in self.arrays

    @property
    def versions(self) -> dict[str, str]:
        """The software that it was made with: name to version.

        Raises:
            DataError: the attribute is no JSON object of texts.
        """
        try:
            found = json.loads(self.attributes["versions"])
        except (ValueError, RecursionError):
            found = None
        if not isinstance(found, dict) or not all(isinstance(version, str) for version in found.values()):
            raise DataError(f"{self.path}: attribute 'versions' is no JSON object of texts")
        return found

    def read(self, name: str) -> npt.NDArray[Any]:
        """Return a whole data set, of labels.

        Raises:
            DataError: it is damaged.
        """
        with self._damage():
            return self.arrays[name].whole(self.file)

    def rows(self, name: str) -> Iterator[npt.NDArray[Any]]:
        """Yield a data set of images row by row.

        Raises:
            DataError: a row is damaged.
        """
        for row in range(len(self)):
            with self._damage():
                values = self.arrays[name].row(row, self.file)
            yield values

    @contextmanager
    def _damage(self) -> Iterator[None]:
        try:
            yield
        except DamageError as error:
            raise DataError(f"{self.path}: {error}") from None


def content_sha256(shard: Shard) -> str:
    """Return the digest of a shard's arrays, one that another HDF5 library or compression does not change.

    Raises:
        DataError: a chunk is damaged.
    """
    digest = hashlib.sha256()
    for name in (*IMAGE_DATASETS, GROUP):
        if name in shard.arrays:
            array = shard.arrays[name]
            digest.update(content_heading(name, array.dtype, array.shape))
            for values in shard.rows(name) if name in ROW_PER_CHUNK else [shard.read(name)]:
                digest.update(values.tobytes())
    return digest.hexdigest()


@contextmanager
def open_shard(path: Path) -> Iterator[Shard]:
    """Open a shard for reading after checking that it holds what the format says and nothing else.

    Raises:
        DataError: the file is missing, is no HDF5, or is no shard; the message lists every fault.
    """
    shard = opened_shard(path)
    try:
        yield shard
    finally:
        shard.file.close()


def opened_shard(path: Path, sha256: str | None = None, size: int | None = None) -> Shard:
    """Return the same without a `with` block: its file is closed once nobody holds it, or at an error.

    Args:
        path: of the file.
        sha256: what its SHA-256 has to be; None where that is not to be looked at.
        size: how many bytes it has to have, likewise.

    Raises:
        DataError: as `open_shard`; or it is damaged, and HDF5 was not asked about it.
    """
    file = _file_of(path)
    with contextlib.ExitStack() as at_an_error:
        at_an_error.callback(file.close)
        _refuse_other_bytes(path, file, sha256, size)
        try:
            described = _DESCRIBER.describe(path)
        except DamageError as fault:
            raise DataError(f"{path}: {fault}") from None
        if described.identity != file.identity:
            raise DataError(f"{path}: was replaced while it was opened; try again")
        faults, arrays = _structure(described, file.identity[2])
        if faults:
            raise DataError(f"{path}: is no valid shard:\n" + bulleted(faults))
        at_an_error.pop_all()
    return Shard(path, file, described.attributes, arrays)


def header_mismatches(shard: Shard, expected: dict[str, Any]) -> list[str]:
    """Say which attributes of a shard are not the expected ones, as `ShardHeader.to_attributes` names them."""
    found = shard.attributes
    return [
        f"attribute {name!r}: expected {value!r}, found {_shown(found.get(name))}"
        for name, value in expected.items()
        if found.get(name) != value and not (value != value and _is_nan(found.get(name)))  # noqa: PLR0124 - NaN
    ]


def _file_of(path: Path) -> ByteFile:
    try:
        return ByteFile(path)
    except FileNotFoundError:
        raise DataError(f"{path}: no such shard") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be opened: {error.strerror}") from None


def _refuse_other_bytes(path: Path, file: ByteFile, sha256: str | None, size: int | None) -> None:
    advice = (
        "`symsol-annot verify` says what else is wrong with the set, and with --repair makes damaged shards again; "
        "or fetch the file again"
    )
    if size is not None and file.identity[2] != size:
        raise DataError(f"{path}: is damaged: expected {size} bytes, found {file.identity[2]}. {advice}")
    if sha256 is None:
        return
    try:
        found = file.sha256()
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    if found != sha256:
        raise DataError(f"{path}: is damaged: expected SHA-256 {sha256}, found {found}. {advice}")


class _Describer:
    """Asks a child process about shards: one for this process, started when it is first needed."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._process: Hdf5Process | None = None
        self._inherited: list[Hdf5Process] = []  # kept, so that nobody waits for another process's child

    def describe(self, path: Path) -> Description:
        """Return what a file is, and where the chunks of its data sets lie.

        Raises:
            DamageError: it is damaged, describing it crashed or took too long, or the process cannot be started.
        """
        with self._lock:
            process, self._process = self._process, None
            if process and process.has_ended:  # somebody else ended it: no fault of this file's
                process.close()
                process = None
            process = process or Hdf5Process(_LIMITS)
            with contextlib.ExitStack() as at_an_error:
                at_an_error.callback(process.close)  # it may be half-way through an answer, or damaged
                process.begin_to_open(path, ALL_ATTRIBUTES)
                described = process.description()
                at_an_error.pop_all()
            self._process = process
            return described

    def close(self) -> None:
        """End the process."""
        with self._lock:
            if self._process:
                self._process.close()
                self._process = None

    def forget(self) -> None:
        """Leave the process to the parent of this one, which was forked."""
        if self._process:
            self._inherited.append(self._process)
        self._process, self._lock = None, threading.Lock()


_DESCRIBER = _Describer()
atexit.register(_DESCRIBER.close)
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_DESCRIBER.forget)


def _structure(described: Description, file_bytes: int) -> tuple[list[str], dict[str, StoredArray]]:
    """Return what keeps a file from being a shard, and its arrays, which are all there where nothing does."""
    faults = _format_faults(described)
    if faults:
        return faults, {}
    is_imported = "source" in (described.attributes.keys() | described.odd_attributes.keys())
    faults = _attribute_faults(described, is_imported=is_imported)
    faults += _name_faults(described.datasets, is_imported=is_imported)
    if faults:
        return faults, {}
    arrays = {}
    for name, (shape, dtype) in _expected_arrays(described, is_imported=is_imported).items():
        facts = described.datasets.get(name)
        found = _dataset_faults(name, facts, shape, dtype)
        if facts and not found:
            rows_per_chunk = 1 if name in ROW_PER_CHUNK else shape[0]
            arrays[name] = StoredArray(name, shape, dtype, rows_per_chunk, _in_order(facts.places))
            found = _place_faults(arrays[name], facts.places, file_bytes)
        faults += found
    return faults, arrays


def _format_faults(described: Description) -> list[str]:
    for name, expected in (("format", SHARD_FORMAT), ("format_version", SHARD_FORMAT_VERSION)):
        found = described.attributes.get(name)
        if name == "format_version" and type(found) is int and found > SHARD_FORMAT_VERSION:
            return [f"is of format version {found}, newer than {expected}, which this symsol-annot reads: update it"]
        if type(found) is not type(expected) or found != expected:
            odd = described.odd_attributes.get(name)
            return [f"attribute {name!r}: this version reads {expected}, found {odd or _shown(found)}"]
    return []


def _attribute_faults(described: Description, *, is_imported: bool) -> list[str]:
    expected, kind_of = attribute_kinds(is_imported=is_imported), "an imported shard" if is_imported else "the format"
    found, odd = described.attributes, described.odd_attributes
    faults = [
        f"attribute {name!r} is {odd.get(name, 'missing')}, where {_IN_WORDS[kind]} belongs"
        for name, kind in expected.items()
        if name not in found
    ]
    faults += [f"attribute {_shown(name)} is not part of {kind_of}" for name in (*found, *odd) if name not in expected]
    return faults or _camera_faults(found["camera"])


def _camera_faults(text: str) -> list[str]:
    try:
        camera = json.loads(text)
        is_camera = all(type(camera[side]) is int and 0 < camera[side] <= SIZE_RANGE[1] for side in ("width", "height"))
    except (KeyError, TypeError, ValueError, RecursionError):
        is_camera = False
    return [] if is_camera else [f"attribute 'camera' is no JSON with width and height: {_shown(text)}"]


def _name_faults(datasets: Mapping[str, DatasetFacts], *, is_imported: bool) -> list[str]:
    faults = []
    for name, facts in datasets.items():
        if name not in (*IMAGE_DATASETS, GROUP):
            faults.append(f"{_shown(name)} is not part of the format")
        elif is_imported and name in DATASETS_NOT_IMPORTED:
            faults.append(f"{name!r} is not part of an imported shard")
        elif facts.found:
            faults.append(f"{name!r} is {facts.found}, where a data set in this file belongs")
    return faults


def _expected_arrays(described: Description, *, is_imported: bool) -> dict[str, tuple[tuple[int, ...], str]]:
    """Return shape and type of each data set, given how many images and symmetries there are."""
    camera = json.loads(described.attributes["camera"])
    size = (camera["height"], camera["width"])
    count, order = (_rows_of(described.datasets.get(name)) for name in ("rotation", GROUP))
    expected: dict[str, tuple[tuple[int, ...], str]] = {
        "image": ((count, *size, 3), "|u1"),
        "segmentation": ((count, *size), "|u1"),
        "rotation": ((count, 3, 3), "<f8"),
        "marking_pixels": ((count,), "<f4"),
        "symmetry_mask": ((count, order), "|b1"),
        GROUP: ((order, 3, 3), "<f8"),
    }
    left_out = set(DATASETS_NOT_IMPORTED) if is_imported else set()
    left_out |= {"symmetry_mask"} - described.datasets.keys()
    return {name: what for name, what in expected.items() if name not in left_out}


def _rows_of(facts: DatasetFacts | None) -> int:
    return facts.shape[0] if facts and facts.shape else 0


def _dataset_faults(name: str, facts: DatasetFacts | None, shape: tuple[int, ...], dtype: str) -> list[str]:
    if facts is None:
        return [f"data set {name!r} is missing"]
    most = 2 * MAX_GROUP_ORDER if name == GROUP else MAX_IMAGES_PER_SHARD
    if not 0 < shape[0] <= most or 0 in shape or (name == "symmetry_mask" and shape[1] > 2 * MAX_GROUP_ORDER):
        return [f"{name!r}: its shape {facts.shape} is beyond the format's limits: 1 to {most} rows"]
    if facts.shape != shape or facts.exact_type != dtype:
        found = facts.exact_type or f"{facts.dtype} in another order of bytes or bits"
        return [f"{name!r}: expected {dtype} of shape {shape}, found {found} of shape {facts.shape}"]
    if facts.filters != _FILTERS:
        return [f"{name!r}: expected the filters gzip and fletcher32, found those of the numbers {facts.filters}"]
    if facts.chunks != (1 if name in ROW_PER_CHUNK else shape[0], *shape[1:]):
        expected = "one row per chunk" if name in ROW_PER_CHUNK else "all rows in one chunk"
        return [f"{name!r}: expected {expected}, found {facts.chunks or 'no chunks'}"]
    return []


def _in_order(places: npt.NDArray[np.uint64]) -> tuple[Place, ...]:
    return tuple(Place(int(offset), int(size)) for _, offset, size, _ in places[np.argsort(places[:, 0])])


def _place_faults(array: StoredArray, places: npt.NDArray[np.uint64], file_bytes: int) -> list[str]:
    """Say where the index of chunks is damaged: HDF5 would give zeros, other rows or all memory."""
    rows = np.arange(0, array.shape[0], array.rows_per_chunk, dtype=np.uint64)
    if not np.array_equal(np.sort(places[:, 0]), rows):
        return [f"{array.name!r}: the file's index is damaged: a chunk is missing, or there twice"]
    if places[:, 3].any():
        return [f"{array.name!r}: the file's index is damaged: a chunk lacks filters"]
    values_bytes = array.rows_per_chunk * int(np.prod(array.shape[1:])) * np.dtype(array.dtype).itemsize
    is_outside = any(offset + size > file_bytes or size <= 4 for offset, size in array.places)
    if is_outside or max(size for _, size in array.places) > largest_chunk(values_bytes):
        return [f"{array.name!r}: the file's index is damaged: a chunk lies outside the file, or is too large"]
    return []


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."


def _is_nan(value: Any) -> bool:
    return isinstance(value, float) and np.isnan(value).item()
