"""What a shard says of itself: its file's name, its attributes, and the names of its data sets."""

import json
from dataclasses import dataclass
from typing import Any

SHARD_FORMAT = "symsol-annot shard"
SHARD_FORMAT_VERSION = 1
IMAGE_DATASETS = ("image", "segmentation", "rotation", "marking_pixels", "symmetry_mask")  # one row an image
UNKNOWN_WHERE_IMPORTED = ("object_sha256", "seed", "render", "tolerance_px")  # of a header, and of a set's recipe
DATASETS_NOT_IMPORTED = ("segmentation", "marking_pixels")
_ATTRIBUTES_NOT_IMPORTED = (*UNKNOWN_WHERE_IMPORTED, "engine", "candidates_drawn", "candidates_within_tolerance")
MAX_IMAGES_PER_SHARD = 500
_ATTRIBUTES = {
    "format": "text",
    "format_version": "whole",
    "object": "text",
    "object_sha256": "text",
    "split": "text",
    "first_index": "whole",
    "seed": "whole",
    "camera": "text",
    "render": "text",
    "engine": "text",
    "tolerance_px": "real",
    "versions": "text",
    "candidates_drawn": "whole",
    "candidates_within_tolerance": "whole",
}
_SOURCE = {"source": "text"}
ALL_ATTRIBUTES = {**_ATTRIBUTES, **_SOURCE}  # name to kind, of rendered and imported shards


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


def attribute_kinds(*, is_imported: bool) -> dict[str, str]:
    """Return the attributes that a shard has, with their kinds: "text", "whole" or "real"."""
    if not is_imported:
        return dict(_ATTRIBUTES)
    return {name: kind for name, kind in _ATTRIBUTES.items() if name not in _ATTRIBUTES_NOT_IMPORTED} | _SOURCE


def shard_file_name(split: str, number: int, shards: int) -> str:
    """Return the file's name of a split's shard, counted from 0, of so many."""
    return f"{split}-{number:05d}-of-{shards:05d}.h5"


def content_heading(name: str, dtype: str, shape: tuple[int, ...]) -> bytes:
    """Return what precedes the values of a data set in the digest of a shard's contents."""
    return f"{name} {dtype} {shape}\n".encode()
