"""The HDF5 shard: what it holds, how it is written whole, and how a stranger's file is opened safely.

docs/format.md is the contract. A shard is built in memory and written in one go, so that a full disk is an
ordinary error, and its bytes depend on nothing but its contents and the libraries in `storage_versions`.
"""

import hashlib
import io
import json
import math
import uuid
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from symsol_annot.chunks import (
    DEFLATE,
    FLETCHER32,
    GZIP_LEVEL,
    HDF5_ERRORS,
    SHUFFLE,
    deflate_version,
    filters_of,
    inflated,
    stored,
)
from symsol_annot.errors import DataError, bulleted
from symsol_annot.objects import MAX_GROUP_ORDER
from symsol_annot.scene import View
from symsol_annot.so3 import Rotations

SHARD_FORMAT = "symsol-annot shard"
SHARD_FORMAT_VERSION = 1
_IMAGE_DATASETS = ("image", "segmentation", "rotation", "marking_pixels", "symmetry_mask")  # one row an image
_TEXT, _WHOLE, _REAL = (str,), (int, np.integer), (float, np.floating)
_ATTRIBUTES: dict[str, tuple[type, ...]] = {
    "format": _TEXT,
    "format_version": _WHOLE,
    "object": _TEXT,
    "object_sha256": _TEXT,
    "split": _TEXT,
    "first_index": _WHOLE,
    "seed": _WHOLE,
    "camera": _TEXT,
    "render": _TEXT,
    "engine": _TEXT,
    "tolerance_px": _REAL,
    "versions": _TEXT,
    "candidates_drawn": _WHOLE,
    "candidates_within_tolerance": _WHOLE,
}
_UNKNOWN_WHERE_IMPORTED = (  # attributes and data sets
    "object_sha256",
    "seed",
    "render",
    "engine",
    "tolerance_px",
    "candidates_drawn",
    "candidates_within_tolerance",
    "segmentation",
    "marking_pixels",
)
_MAX_SIDE = 2 * MAX_GROUP_ORDER  # so that a small file cannot ask for all memory
_ALLOWED_FILTERS = {DEFLATE, FLETCHER32, SHUFFLE}


@dataclass(frozen=True)
class ShardHeader:
    """A shard's attributes: all that is needed to make it again; None where that is not known, in imported shards.

    Attributes:
        object: the object's name.
        object_sha256: its digest.
        split: "train" or "test".
        first_index: the index within the split of the shard's first image.
        seed: the set's.
        camera: as `Camera.to_dict`.
        render: as `RenderSettings.to_dict`.
        tolerance_px: the object's T; NaN without a marking.
        versions: the software that decides the bytes.
        source: where an imported shard is from; None for a rendered one.
    """

    object: str
    object_sha256: str | None
    split: str
    first_index: int
    seed: int | None
    camera: dict[str, Any]
    render: dict[str, Any] | None
    tolerance_px: float | None
    versions: dict[str, str]
    source: dict[str, Any] | None = None

    def to_attributes(self) -> dict[str, Any]:
        """Return the HDF5 attributes; what is not known has none."""
        attributes = {
            "format": SHARD_FORMAT,
            "format_version": SHARD_FORMAT_VERSION,
            "object": self.object,
            "object_sha256": self.object_sha256,
            "split": self.split,
            "first_index": self.first_index,
            "seed": self.seed,
            "camera": json.dumps(self.camera, sort_keys=True),
            "render": self.render and json.dumps(self.render, sort_keys=True),
            "engine": self.render and self.render["engine"],
            "tolerance_px": self.tolerance_px,
            "versions": json.dumps(self.versions, sort_keys=True),
            "source": self.source and json.dumps(self.source, sort_keys=True),
        }
        return {name: value for name, value in attributes.items() if value is not None}


@dataclass(frozen=True)
class ImageRecord:
    """What a shard holds of one image.

    Attributes:
        view: the picture and its segmentation.
        R_m2c: (3, 3) the rotation it was drawn at.
        marking_pixels: p(R_m2c).
        symmetry_mask: (G,) bool, or None in a split without annotation.
    """

    view: View
    R_m2c: Rotations
    marking_pixels: float
    symmetry_mask: npt.NDArray[np.bool_] | None


@dataclass(frozen=True)
class ShardFile:
    """A finished shard in memory: its bytes, and the digest of what it holds whatever HDF5 makes of it."""

    data: bytes
    content_sha256: str


class ShardWriter:
    """Builds one shard, image by image; the chunks are made here, not by HDF5, so that threads do so at once."""

    def __init__(self, header: ShardHeader, count: int, symmetry_group: Rotations, *, annotated: bool) -> None:
        in_memory = f"shard-{uuid.uuid4()}"  # HDF5 tells files that are open at the same time apart by name
        self._file = h5py.File(in_memory, "w", driver="core", backing_store=False, libver=("earliest", "v108"))
        self._count, self._written = count, 0
        self._file.attrs.update(header.to_attributes())
        size = (header.camera["height"], header.camera["width"])
        self._image = self._create("image", (count, *size, 3), "u1", chunk_rows=1)
        self._segmentation = None
        self._labels = {"rotation": np.zeros((count, 3, 3))}
        if header.source is None:
            self._segmentation = self._create("segmentation", (count, *size), "u1", chunk_rows=1)
            self._labels["marking_pixels"] = np.zeros(count, dtype="f4")
        if annotated:
            self._labels["symmetry_mask"] = np.zeros((count, len(symmetry_group)), dtype=bool)
        self._labels["symmetry_group"] = symmetry_group
        self._content = hashlib.sha256(_content_heading(self._image))
        self._segmentations: list[bytes] = []  # as they are stored, until their turn in the digest

    def add(self, record: ImageRecord) -> None:
        """Append one rendered image."""
        row = self._written
        self.add_imported(record.view.rgb, record.R_m2c, record.symmetry_mask)
        self._segmentations.append(_store(self._segmentation, row, record.view.segmentation[None]))
        self._labels["marking_pixels"][row] = record.marking_pixels

    def add_imported(self, rgb: npt.NDArray[np.uint8], R: Rotations, mask: npt.NDArray[np.bool_] | None) -> None:
        """Append one image (H, W, 3) of which nothing is known but its rotation (3, 3) and its set (G,), if that."""
        row = self._written
        _store(self._image, row, rgb[None])
        self._content.update(rgb.tobytes())
        self._labels["rotation"][row] = R
        if mask is not None:
            self._labels["symmetry_mask"][row] = mask
        self._written += 1

    def finish(self, notes: dict[str, int]) -> ShardFile:
        """Return the shard; `notes` become attributes."""
        if self._written != self._count:
            raise ValueError(f"the shard was made for {self._count} images and holds {self._written}")
        self._file.attrs.update(notes)
        if self._segmentation is not None:
            self._content.update(_content_heading(self._segmentation))
            for chunk in self._segmentations:
                self._content.update(inflated(chunk, math.prod(self._segmentation.chunks)))
        for name, values in self._labels.items():
            dataset = self._create(name, values.shape, values.dtype.str)
            _store(dataset, 0, values)
            self._content.update(_content_heading(dataset) + values.tobytes())
        self._file.flush()
        return ShardFile(self._file.id.get_file_image(), self._content.hexdigest())

    def close(self) -> None:
        """Let go of the memory."""
        self._file.close()

    def _create(self, name: str, shape: tuple[int, ...], dtype: str, chunk_rows: int | None = None) -> h5py.Dataset:
        return self._file.create_dataset(
            name,
            shape,
            dtype,
            chunks=(chunk_rows or shape[0], *shape[1:]),
            compression="gzip",
            compression_opts=GZIP_LEVEL,
            fletcher32=True,
            track_times=False,
        )


def _store(dataset: h5py.Dataset, row: int, values: npt.NDArray[Any]) -> bytes:
    """Write the chunk that begins at a row, and return its bytes."""
    if values.shape != dataset.chunks or values.dtype != dataset.dtype:
        expected, found = f"{dataset.dtype} {dataset.chunks}", f"{values.dtype} {values.shape}"
        raise ValueError(f"{dataset.name}: expected {expected}, found {found}")
    chunk = stored(values)
    dataset.id.write_direct_chunk((row, *[0] * (values.ndim - 1)), chunk)
    return chunk


def versions_of(shard: h5py.File) -> dict[str, str]:
    """Return the software that an open shard was made with: name to version.

    Raises:
        DataError: the attribute is no JSON object.
    """
    try:
        return dict(json.loads(shard.attrs["versions"]))
    except (TypeError, ValueError) as error:
        raise DataError(f"{shard.filename}: attribute 'versions' is no JSON object: {error}") from None


def storage_versions() -> dict[str, str]:
    """Return the libraries that decide a shard's bytes: name to version."""
    versions = {"numpy": np.__version__, "h5py": h5py.__version__, "hdf5": h5py.version.hdf5_version}
    return {**versions, "zlib-ng": deflate_version()}


def content_sha256(file: h5py.File) -> str:
    """Return the digest of a shard's arrays, one that another HDF5 library or compression does not change."""
    digest = hashlib.sha256()
    for name in (*_IMAGE_DATASETS, "symmetry_group"):
        if name in file:
            dataset = file[name]
            digest.update(_content_heading(dataset))
            for start in range(0, len(dataset), 64):
                digest.update(np.ascontiguousarray(dataset[start : start + 64]).tobytes())
    return digest.hexdigest()


def _content_heading(dataset: h5py.Dataset) -> bytes:
    return f"{dataset.name.strip('/')} {dataset.dtype.str} {dataset.shape}\n".encode()


@contextmanager
def open_shard(path: Path, in_memory: io.BytesIO | None = None) -> Iterator[h5py.File]:
    """Open a shard for reading after checking that it holds what the format says and nothing else.

    Args:
        path: its place, or where it will be.
        in_memory: its bytes, where it is not on disk yet.

    Raises:
        DataError: the file is missing, is no HDF5, or is no shard; the message lists every fault.
    """
    try:
        if in_memory is None and not path.is_file():
            raise DataError(f"{path}: {'is no regular file' if path.exists() else 'no such shard'}")
        file = h5py.File(in_memory or path, "r")
    except OSError as error:
        raise DataError(f"{path}: cannot be read as HDF5: {error}") from None
    with file:
        faults = _structure_faults(file)
        if faults:
            raise DataError(f"{path}: is no valid shard:\n" + bulleted(faults))
        yield file


def header_mismatches(file: h5py.File, expected: dict[str, Any]) -> list[str]:
    """Say which attributes of an open shard are not the expected ones, as `ShardHeader.to_attributes` names them."""
    return [
        f"attribute {name!r}: expected {value!r}, found {file.attrs[name]!r}"
        for name, value in expected.items()
        if file.attrs[name] != value and not (value != value and np.isnan(file.attrs[name]))  # noqa: PLR0124 - NaN
    ]


def _structure_faults(file: h5py.File) -> list[str]:
    """List what keeps a file from being a shard, without reading a data set: links, types, shapes, filters."""
    try:
        if _format_faults(file):
            return _format_faults(file)
        faults = _attribute_faults(file)
        for name in file:
            if not isinstance(file.get(name, getlink=True), h5py.HardLink):
                faults.append(f"{name!r} is a link to somewhere else")
            elif name not in _IMAGE_DATASETS and name != "symmetry_group":
                faults.append(f"{name!r} is not part of the format")
            elif _is_imported(file) and name in _UNKNOWN_WHERE_IMPORTED:
                faults.append(f"{name!r} is not part of an imported shard")
        if not faults:
            camera = json.loads(file.attrs["camera"])
            for name, (shape, dtype) in _expected_datasets(file, camera["height"], camera["width"]).items():
                faults += _dataset_faults(file, name, shape, dtype)
    except HDF5_ERRORS as error:
        return [f"is damaged: {error}"]
    return faults


def _format_faults(file: h5py.File) -> list[str]:
    for name, expected in (("format", SHARD_FORMAT), ("format_version", SHARD_FORMAT_VERSION)):
        found = file.attrs.get(name)
        if not isinstance(found, _ATTRIBUTES[name]) or found != expected:
            if name == "format_version" and isinstance(found, np.integer) and found > expected:
                return [
                    f"is of format version {found}, newer than {expected}, which this symsol-annot reads: update it"
                ]
            return [f"attribute {name!r}: this version reads {expected}, found {found}"]
    return []


def _attribute_faults(file: h5py.File) -> list[str]:
    expected = dict(_ATTRIBUTES)
    if _is_imported(file):
        expected = {name: types for name, types in expected.items() if name not in _UNKNOWN_WHERE_IMPORTED}
        expected["source"] = _TEXT
    faults = [
        f"attribute {name!r} is missing or of a wrong type: found {file.attrs.get(name)!r}"
        for name, types in expected.items()
        if not isinstance(file.attrs.get(name), types)
    ]
    if _is_imported(file):
        stray = [name for name in _UNKNOWN_WHERE_IMPORTED if name in file.attrs]
        faults += [f"attribute {name!r} is not part of an imported shard" for name in stray]
    return faults or _camera_faults(file.attrs["camera"])


def _camera_faults(text: str) -> list[str]:
    try:
        camera = json.loads(text)
        is_camera = all(isinstance(camera[side], int) and camera[side] > 0 for side in ("width", "height"))
    except (KeyError, TypeError, ValueError, RecursionError):
        is_camera = False
    return [] if is_camera else [f"attribute 'camera' is no JSON with width and height: {text[:80]!r}"]


def _expected_datasets(file: h5py.File, height: int, width: int) -> dict[str, tuple[tuple[int, ...], str]]:
    count = _rows_of(file, "rotation")
    group = _rows_of(file, "symmetry_group")
    expected: dict[str, tuple[tuple[int, ...], str]] = {
        "image": ((count, height, width, 3), "|u1"),
        "segmentation": ((count, height, width), "|u1"),
        "rotation": ((count, 3, 3), "<f8"),
        "marking_pixels": ((count,), "<f4"),
        "symmetry_group": ((group, 3, 3), "<f8"),
    }
    if file.get("symmetry_mask", getlink=True) is not None:
        expected["symmetry_mask"] = ((count, group), "|b1")
    if _is_imported(file):
        expected = {name: what for name, what in expected.items() if name not in _UNKNOWN_WHERE_IMPORTED}
    return expected


def _is_imported(file: h5py.File) -> bool:
    return "source" in file.attrs


def _rows_of(file: h5py.File, name: str) -> int:
    if not isinstance(file.get(name, getlink=True), h5py.HardLink):
        return 0
    dataset = file[name]
    return int(dataset.shape[0]) if isinstance(dataset, h5py.Dataset) and dataset.shape else 0


def _dataset_faults(file: h5py.File, name: str, shape: tuple[int, ...], dtype: str) -> list[str]:
    dataset = file.get(name)
    if not isinstance(dataset, h5py.Dataset):
        return [f"{name!r} is no data set" if name in file else f"data set {name!r} is missing"]
    try:
        _ = dataset.dtype
    except TypeError as error:
        return [f"{name!r} has a type that is not part of the format: {error}"]
    if max(shape) > _MAX_SIDE:
        return [f"{name!r}: its shape {dataset.shape} is beyond the format's limits"]
    if dataset.shape != shape or dataset.dtype.str != dtype or 0 in shape:
        return [f"{name!r}: expected {dtype} of shape {shape}, found {dataset.dtype.str} of shape {dataset.shape}"]
    if dataset.is_virtual or dataset.external or not set(filters_of(dataset)) <= _ALLOWED_FILTERS:
        return [f"{name!r} is stored outside the file or with a filter that is not allowed"]
    return []
