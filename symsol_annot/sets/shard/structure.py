"""Whether an HDF5 file, as the child process describes it, has the structure of a shard: docs/format.md, nothing else.

What its arrays hold is for `laws` to say.
"""

import hashlib
import json
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.group_toml import MAX_GROUP_ORDER
from symsol_annot.objects.parts import MAX_PARTS
from symsol_annot.rendering.camera import SIZE_RANGE
from symsol_annot.sets.shard.chunks import DEFLATE, FLETCHER32, Place, StoredArray, largest_chunk
from symsol_annot.sets.shard.header import MAX_IMAGES_PER_SHARD, SHARD_FORMAT
from symsol_annot.sets.shard.layout import (
    EQUALITY,
    GROUP,
    GROUP_SHA256,
    LAYOUTS,
    NEWEST,
    PARTS,
    RENDERED,
    SEALED,
    SYMMETRY_MASK,
    VOLUME,
    VOLUMES,
    VOLUMES_SHA256,
    Column,
    ShardKind,
    ShardLayout,
)
from symsol_annot.sets.shard.volumes import volumes_stated
from symsol_annot.sets.stated.equality import equality_stated
from symsol_annot.system.sandbox.hdf5_process import DatasetFacts, Description

MAX_SYMMETRIES = 2 * MAX_GROUP_ORDER
_FILTERS = (DEFLATE, FLETCHER32)
_IN_WORDS = {"text": "a string", "whole": "a whole number", "real": "a number", "array": "an array"}
_SHOWN_CHARACTERS = 80
_PART_CHARACTERS = 64


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
    layout = LAYOUTS[described.attributes["format_version"]]
    kind = layout.kind_of(described.attributes.keys() | described.odd_attributes.keys())
    faults = _attribute_faults(described, layout, kind)
    faults += _name_faults(described.datasets, layout, kind)
    if faults:
        return faults, {}
    faults = _volume_faults(described)
    if faults:
        return faults, {}
    arrays = {}
    for column, shape in _expected_columns(described, layout, kind):
        facts = described.datasets.get(column.name)
        found = _dataset_faults(column, facts, shape)
        if facts and not found:
            rows_per_chunk = 1 if column.is_picture else shape[0]
            array = StoredArray(column.name, shape, column.dtype, rows_per_chunk, _in_order(facts.places))
            arrays[column.name] = array
            found = _place_faults(array, facts.places, file_bytes)
        faults += found
    return faults, arrays


def parts_stated(text: str) -> tuple[str, ...]:
    """Return the names of parts that the attribute `parts` states.

    Raises:
        ValueError: it is no JSON list of 1 to 255 names, each another one.
    """
    try:
        names = json.loads(text)
    except RecursionError:
        names = None
    is_list = isinstance(names, list) and 0 < len(names) <= MAX_PARTS and all(isinstance(name, str) for name in names)
    if not is_list or len(set(names)) < len(names):
        raise ValueError(f"no JSON list of 1 to {MAX_PARTS} names of parts, each another one: {shown(text)}")
    if not all(name.isprintable() and 0 < len(name) <= _PART_CHARACTERS for name in names):
        raise ValueError(
            f"a name of a part is not 1 to {_PART_CHARACTERS} characters that can be printed: {shown(text)}"
        )
    return tuple(names)


def _format_faults(described: Description) -> list[str]:
    names = {name: described.attributes.get(name) for name in ("format", "format_version")}
    odd = described.odd_attributes
    if names["format"] != SHARD_FORMAT:
        found = odd.get("format") or shown(names["format"])
        return [f"attribute 'format': this version reads {SHARD_FORMAT}, found {found}"]
    version = names["format_version"]
    if type(version) is int and version > NEWEST:
        return [f"is of format version {version}, newer than {NEWEST}, which this symsol-annot reads: update it"]
    if type(version) is not int or version not in LAYOUTS:
        found, known = odd.get("format_version") or shown(version), " and ".join(map(str, LAYOUTS))
        return [f"attribute 'format_version': this version reads {known}, found {found}"]
    return []


def _attribute_faults(described: Description, layout: ShardLayout, kind: ShardKind) -> list[str]:
    expected, optional = layout.attribute_kinds(kind), layout.optional_attributes(kind)
    whose = f"format version {layout.version}" if kind is RENDERED else kind.title
    odd, arrays = described.odd_attributes, described.arrays
    found = {**described.attributes, **arrays}
    faults = [
        f"attribute {name!r} is {odd.get(name, 'missing')}, where {_IN_WORDS[value]} belongs"
        for name, value in expected.items()
        if name not in found
    ]
    known = {*expected, *optional}
    faults += [f"attribute {shown(name)} is not part of {whose}" for name in (*found, *odd) if name not in known]
    faults += [
        f"attribute {name!r} is {odd[name]}, where {_IN_WORDS[value]} belongs"
        for name, value in optional.items()
        if name in odd
    ]
    if faults:
        return faults
    if PARTS in expected:
        faults += _parts_faults(described.attributes[PARTS], described.attributes.get(EQUALITY))
    if layout.has_group_attribute:
        faults += _group_faults(arrays[GROUP], described.attributes[GROUP_SHA256])
    return faults + _camera_faults(described.attributes["camera"])


def _parts_faults(text: str, equality: str | None) -> list[str]:
    try:
        names = parts_stated(text)
    except ValueError as error:
        return [f"attribute 'parts': {error}"]
    if equality is None:
        return []
    try:
        stated = equality_stated(equality)
    except ValueError as error:
        return [f"attribute {error}"]
    return [] if stated.parts == names else ["attribute 'equality' is of other parts than the attribute 'parts' names"]


def _group_faults(group: npt.NDArray[Any], sha256: str) -> list[str]:
    if group.dtype.str != "<f8" or group.ndim != 3 or group.shape[1:] != (3, 3):
        expected, found = "expected <f8 of shape (G, 3, 3)", f"found {group.dtype.str} of shape {group.shape}"
        return [f"attribute {GROUP!r}: {expected}, {found}"]
    if not 0 < len(group) <= MAX_SYMMETRIES:
        return [f"attribute {GROUP!r}: expected 1 to {MAX_SYMMETRIES} symmetries, found {len(group)}"]
    if hashlib.sha256(group.tobytes()).hexdigest() != sha256:
        return [f"attribute {GROUP!r}: is damaged: it does not have the digest in {GROUP_SHA256!r}"]
    return []


def _volume_faults(described: Description) -> list[str]:
    """Say where volumes are stated of sets that can have none, or not of those that can, or are damaged."""
    attributes, arrays, names = described.attributes, described.arrays, described.datasets
    text = attributes.get(EQUALITY)
    is_ball = text is not None and equality_stated(text).has_all_rotations
    expected = is_ball and SYMMETRY_MASK in names
    there = {VOLUME: VOLUME in names, VOLUMES: VOLUMES in arrays, VOLUMES_SHA256: VOLUMES_SHA256 in attributes}
    whose = "an annotated split of a ball" if expected else "a set without volumes"
    faults = [
        f"{name!r} is {'missing' if expected else 'there'}, in {whose}"
        for name, is_there in there.items()
        if is_there != expected
    ]
    if faults or not expected:
        return faults
    try:
        volumes_stated(arrays[VOLUMES], attributes[VOLUMES_SHA256])
    except ValueError as error:
        return [f"attribute {VOLUMES!r}: {error}"]
    return []


def _camera_faults(text: str) -> list[str]:
    try:
        camera = json.loads(text)
        is_camera = all(type(camera[side]) is int and 0 < camera[side] <= SIZE_RANGE[1] for side in ("width", "height"))
    except (KeyError, TypeError, ValueError, RecursionError):
        is_camera = False
    return [] if is_camera else [f"attribute 'camera' is no JSON with width and height: {shown(text)}"]


def _name_faults(datasets: Mapping[str, DatasetFacts], layout: ShardLayout, kind: ShardKind) -> list[str]:
    known = {column.name for column in layout.columns}
    there = {column.name for column in layout.columns_of(kind)}
    faults = []
    for name, facts in datasets.items():
        if name not in known:
            faults.append(f"{shown(name)} is not part of the format, version {layout.version}")
        elif name not in there:
            faults.append(f"{name!r} is not part of {kind.title}")
        elif facts.found:
            faults.append(f"{name!r} is {facts.found}, where a data set in this file belongs")
    return faults


def _expected_columns(
    described: Description, layout: ShardLayout, kind: ShardKind
) -> Iterator[tuple[Column, tuple[int, ...]]]:
    """Yield each data set with its shape, given how many images, parts and symmetries there are."""
    camera, datasets = json.loads(described.attributes["camera"]), described.datasets
    group = described.arrays.get(GROUP)
    sizes = {
        "images": _rows_of(datasets.get("image" if kind is SEALED else "rotation")),
        "height": camera["height"],
        "width": camera["width"],
        "parts": len(parts_stated(described.attributes[PARTS])) if PARTS in described.attributes else 0,
        "symmetries": _rows_of(datasets.get(GROUP)) if group is None else len(group),
    }
    for column in layout.columns_of(kind):
        if column.name in datasets or not column.is_optional:
            yield column, tuple(sizes[axis] if isinstance(axis, str) else axis for axis in column.axes)


def _rows_of(facts: DatasetFacts | None) -> int:
    return facts.shape[0] if facts and facts.shape else 0


def _dataset_faults(column: Column, facts: DatasetFacts | None, shape: tuple[int, ...]) -> list[str]:
    name = column.name
    if facts is None:
        return [f"data set {name!r} is missing"]
    most = MAX_SYMMETRIES if name == GROUP else MAX_IMAGES_PER_SHARD
    if not 0 < shape[0] <= most or 0 in shape or (column.axes[-1] == "symmetries" and shape[-1] > MAX_SYMMETRIES):
        return [f"{name!r}: its shape {facts.shape} is beyond the format's limits: 1 to {most} rows"]
    if facts.shape != shape or facts.exact_type != column.dtype:
        found = facts.exact_type or f"{facts.dtype} in another order of bytes or bits"
        return [f"{name!r}: expected {column.dtype} of shape {shape}, found {found} of shape {facts.shape}"]
    if facts.filters != _FILTERS:
        return [f"{name!r}: expected the filters gzip and fletcher32, found those of the numbers {facts.filters}"]
    if facts.chunks != (1 if column.is_picture else shape[0], *shape[1:]):
        expected = "one row per chunk" if column.is_picture else "all rows in one chunk"
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
