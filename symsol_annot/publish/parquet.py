"""A set as Parquet, for readers that know no HDF5: one file per shard, images as PNG, labels to the bit.

The schema says in Hugging Face's way which columns are images; to other readers they are PNG files as bytes. Depth maps
are left to the shards: no image format that such readers show holds 32-bit numbers to the bit.
"""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from symsol_annot.annotation.volume import Volume
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Sample
from symsol_annot.sets.shard.chunks import deflate_version, deflated
from symsol_annot.sets.shard.volumes import bits_of
from symsol_annot.system.png import to_png

PARQUET_FORMAT_VERSION = 2
ROWS_PER_GROUP = 100  # what a reader of one image has to fetch: about a megabyte
_IMAGE = pa.struct({"bytes": pa.binary(), "path": pa.string()})
_ROTATION = pa.list_(pa.list_(pa.float64()))
_SAMPLE_COLUMNS = {
    "index": pa.int64(),
    "image": _IMAGE,
    "segmentation": _IMAGE,
    "rotation": _ROTATION,
    "symmetry_mask": pa.list_(pa.bool_()),
    "marking_pixels": pa.float32(),
    "marking_visible": pa.bool_(),
    "part_pixels": pa.list_(pa.float32()),
}
_VOLUME_COLUMN = {"volume": pa.int32()}  # of balls alone, whose sets can fill a volume
_VOLUMES_COLUMN = {"volumes": pa.list_(pa.binary())}  # beside the groups, where some set has volumes
_SET_COLUMNS = {"set": pa.string(), "symmetry_group": pa.list_(_ROTATION), "parts": pa.list_(pa.string())}


def samples_to_parquet(
    samples: Iterable[Sample], source: dict[str, str], volumes: Sequence[Volume] | None = None
) -> bytes:
    """Return samples as a Parquet file, a row each.

    Args:
        samples: of one set, in order.
        source: where they come from; goes into the file, under the name symsol_annot, with the software's versions.
        volumes: those that sets of the object fill, into which the column `volume` points, -1 for none; None of an
            object whose sets never do, which has no such column.
    """
    types = _SAMPLE_COLUMNS if volumes is None else {**_SAMPLE_COLUMNS, **_VOLUME_COLUMN}
    columns: dict[str, list[Any]] = {name: [] for name in types}
    for sample in samples:
        mask, part_pixels = sample.symmetry_mask, sample.part_pixels
        columns["index"].append(sample.index)
        for name, pixels in (("image", sample.image), ("segmentation", sample.segmentation)):
            columns[name].append(None if pixels is None else {"bytes": to_png(pixels), "path": None})
        columns["rotation"].append(sample.rotation.tolist())
        columns["symmetry_mask"].append(None if mask is None else mask.tolist())
        columns["marking_pixels"].append(np.float32(sample.marking_pixels))
        columns["marking_visible"].append(sample.marking_visible)
        columns["part_pixels"].append(None if part_pixels is None else part_pixels.tolist())
        if volumes is not None:
            columns["volume"].append(-1 if sample.volume is None else volumes.index(sample.volume))
    return _to_bytes(columns, types, source)


def groups_to_parquet(
    groups: dict[str, Rotations],
    parts: dict[str, tuple[str, ...]],
    volumes: Mapping[str, Sequence[Volume] | None] = MappingProxyType({}),
) -> bytes:
    """Return the symmetry groups (G, 3, 3), the parts' names and the volumes of sets, as a Parquet file.

    Args:
        groups: by the sets' names.
        parts: by the sets' names.
        volumes: by the sets' names; None of a set that has none. Each is bits of the grid's cells, as in a shard, that
            zlib inflates. Where no set has any, neither has the file the column.
    """
    columns = {
        "set": list(groups),
        "symmetry_group": [group.tolist() for group in groups.values()],
        "parts": [list(parts[name]) for name in groups],
    }
    if not any(volumes.values()):
        return _to_bytes(columns, _SET_COLUMNS, {})
    columns["volumes"] = [[deflated(bits_of([one]).tobytes()) for one in volumes.get(name) or ()] for name in groups]
    return _to_bytes(columns, {**_SET_COLUMNS, **_VOLUMES_COLUMN}, {})


def is_made_from(path: Path, source: dict[str, str]) -> bool:
    """Tell whether a file that `samples_to_parquet` wrote has this source, and would get the same bytes today."""
    return bool(pq.read_schema(path).metadata[b"symsol_annot"] == _stamp(source).encode())


def _stamp(source: dict[str, str]) -> str:
    versions = {"pyarrow": pa.__version__, "zlib-ng": deflate_version()}
    return json.dumps({"format_version": PARQUET_FORMAT_VERSION, **source, "versions": versions})


def _to_bytes(columns: dict[str, list[Any]], types: dict[str, Any], source: dict[str, str]) -> bytes:
    images = [name for name, kind in types.items() if kind is _IMAGE]
    metadata = {
        "huggingface": json.dumps({"info": {"features": {name: {"_type": "Image"} for name in images}}}),
        "symsol_annot": _stamp(source),
    }
    schema = pa.schema([*types.items()], metadata=metadata)
    file = io.BytesIO()
    with pq.ParquetWriter(file, schema, compression="zstd", write_page_index=True) as writer:
        writer.write_table(pa.table(columns, schema), row_group_size=ROWS_PER_GROUP)
    return file.getvalue()
