"""The HDF5 shard, opened safely: a stranger's file is held against docs/format.md before anything of it is read."""

import hashlib
import io
import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import h5py
import numpy as np

from symsol_annot.chunks import DEFLATE, FLETCHER32, HDF5_ERRORS, SHUFFLE, filters_of
from symsol_annot.errors import DataError, bulleted
from symsol_annot.objects import MAX_GROUP_ORDER
from symsol_annot.shard_header import (
    DATASETS_NOT_IMPORTED,
    IMAGE_DATASETS,
    SHARD_FORMAT,
    SHARD_FORMAT_VERSION,
    attribute_types,
    content_heading,
)

_MAX_SIDE = 2 * MAX_GROUP_ORDER  # so that a small file cannot ask for all memory
_ALLOWED_FILTERS = {DEFLATE, FLETCHER32, SHUFFLE}


def versions_of(shard: h5py.File) -> dict[str, str]:
    """Return the software that an open shard was made with: name to version.

    Raises:
        DataError: the attribute is no JSON object.
    """
    try:
        return dict(json.loads(shard.attrs["versions"]))
    except (TypeError, ValueError) as error:
        raise DataError(f"{shard.filename}: attribute 'versions' is no JSON object: {error}") from None


def content_sha256(file: h5py.File) -> str:
    """Return the digest of a shard's arrays, one that another HDF5 library or compression does not change."""
    digest = hashlib.sha256()
    for name in (*IMAGE_DATASETS, "symmetry_group"):
        if name in file:
            dataset = file[name]
            digest.update(content_heading(dataset))
            for start in range(0, len(dataset), 64):
                digest.update(np.ascontiguousarray(dataset[start : start + 64]).tobytes())
    return digest.hexdigest()


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
            elif name not in IMAGE_DATASETS and name != "symmetry_group":
                faults.append(f"{name!r} is not part of the format")
            elif _is_imported(file) and name in DATASETS_NOT_IMPORTED:
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
        if not isinstance(found, attribute_types(is_imported=False)[name]) or found != expected:
            if name == "format_version" and isinstance(found, np.integer) and found > expected:
                return [
                    f"is of format version {found}, newer than {expected}, which this symsol-annot reads: update it"
                ]
            return [f"attribute {name!r}: this version reads {expected}, found {found}"]
    return []


def _attribute_faults(file: h5py.File) -> list[str]:
    expected = attribute_types(is_imported=_is_imported(file))
    faults = [
        f"attribute {name!r} is missing or of a wrong type: found {file.attrs.get(name)!r}"
        for name, types in expected.items()
        if not isinstance(file.attrs.get(name), types)
    ]
    if _is_imported(file):
        rendered = attribute_types(is_imported=False)
        stray = [name for name in rendered if name not in expected and name in file.attrs]
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
        expected = {name: what for name, what in expected.items() if name not in DATASETS_NOT_IMPORTED}
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
