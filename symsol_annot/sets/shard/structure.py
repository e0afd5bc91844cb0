"""Whether an HDF5 file, as the child process describes it, has the structure of a shard: docs/format.md, nothing else.

What its arrays hold is for `laws` to say.
"""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.spec import MAX_GROUP_ORDER
from symsol_annot.rendering.camera import SIZE_RANGE
from symsol_annot.sets.shard.chunks import DEFLATE, FLETCHER32, Place, StoredArray, largest_chunk
from symsol_annot.sets.shard.header import (
    DATASETS_NOT_IMPORTED,
    GROUP,
    IMAGE_DATASETS,
    MAX_IMAGES_PER_SHARD,
    ROW_PER_CHUNK,
    SHARD_FORMAT,
    SHARD_FORMAT_VERSION,
    attribute_kinds,
)
from symsol_annot.system.sandbox.hdf5_process import DatasetFacts, Description

_FILTERS = (DEFLATE, FLETCHER32)
_IN_WORDS = {"text": "a string", "whole": "a whole number", "real": "a number"}
_SHOWN_CHARACTERS = 80


def structure_of(described: Description, file_bytes: int) -> tuple[list[str], dict[str, StoredArray]]:
    """Return what keeps a file from being a shard, and its arrays, which are all there where nothing does.

    Args:
        described: what the file says of itself.
        file_bytes: its size.

    Returns:
        The faults, one line each, and the data sets by name.
    """
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
            return [f"attribute {name!r}: this version reads {expected}, found {odd or shown(found)}"]
    return []


def _attribute_faults(described: Description, *, is_imported: bool) -> list[str]:
    expected, kind_of = attribute_kinds(is_imported=is_imported), "an imported shard" if is_imported else "the format"
    found, odd = described.attributes, described.odd_attributes
    faults = [
        f"attribute {name!r} is {odd.get(name, 'missing')}, where {_IN_WORDS[kind]} belongs"
        for name, kind in expected.items()
        if name not in found
    ]
    faults += [f"attribute {shown(name)} is not part of {kind_of}" for name in (*found, *odd) if name not in expected]
    return faults or _camera_faults(found["camera"])


def _camera_faults(text: str) -> list[str]:
    try:
        camera = json.loads(text)
        is_camera = all(type(camera[side]) is int and 0 < camera[side] <= SIZE_RANGE[1] for side in ("width", "height"))
    except (KeyError, TypeError, ValueError, RecursionError):
        is_camera = False
    return [] if is_camera else [f"attribute 'camera' is no JSON with width and height: {shown(text)}"]


def _name_faults(datasets: Mapping[str, DatasetFacts], *, is_imported: bool) -> list[str]:
    faults = []
    for name, facts in datasets.items():
        if name not in (*IMAGE_DATASETS, GROUP):
            faults.append(f"{shown(name)} is not part of the format")
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


def shown(value: Any) -> str:
    """Return a value from a file for a message: in Python's notation, cut where it is long."""
    text = repr(value)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."
