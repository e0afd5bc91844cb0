"""What a shard says of itself: its file's name, its attributes, and the names of its data sets."""

import json
import math
from dataclasses import dataclass
from typing import Any

from symsol_annot.sets.settings import ImportedSettings, RenderedSettings, SetSettings

SHARD_FORMAT = "symsol-annot shard"
SHARD_FORMAT_VERSION = 1
IMAGE_DATASETS = ("image", "segmentation", "rotation", "marking_pixels", "symmetry_mask")  # one row per image
GROUP = "symmetry_group"  # one for all images
ROW_PER_CHUNK = ("image", "segmentation")  # of the others, all rows are one chunk
DATASETS_NOT_IMPORTED = ("segmentation", "marking_pixels")
_ATTRIBUTES_NOT_IMPORTED = (
    *("object_sha256", "seed", "render", "engine", "tolerance_px"),
    *("candidates_drawn", "candidates_within_tolerance"),
)
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
    """What a shard says of itself: with the settings of its set, all that is needed to make it again.

    Attributes:
        settings: of the set.
        split: "train" or "test".
        first_index: the index within the split of the shard's first image.
        versions: the software that decides the bytes: name to version.
    """

    settings: SetSettings
    split: str
    first_index: int
    versions: dict[str, str]

    def to_attributes(self) -> dict[str, Any]:
        """Return the HDF5 attributes, in the order in which they are written; what is not known has none."""
        settings = self.settings
        start = {"format": SHARD_FORMAT, "format_version": SHARD_FORMAT_VERSION, "object": settings.object}
        place = {"split": self.split, "first_index": self.first_index}
        versions = {"versions": _as_text(self.versions)}
        if isinstance(settings, ImportedSettings):
            known = {"camera": _as_text(settings.camera_to_json())}
            return {**start, **place, **known, **versions, "source": _as_text(settings.source.to_json())}
        if not isinstance(settings, RenderedSettings):
            raise TypeError(f"expected the settings of a rendered or an imported set, found {type(settings).__name__}")
        drawing = {
            "seed": settings.seed,
            "camera": _as_text(settings.camera.to_dict()),
            "render": _as_text(settings.render.to_dict()),
            "engine": settings.render.engine,
            "tolerance_px": math.nan if settings.tolerance_px is None else settings.tolerance_px,
        }
        return {**start, "object_sha256": settings.object_sha256, **place, **drawing, **versions}


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


def _as_text(values: dict[str, Any]) -> str:
    return json.dumps(values, sort_keys=True)
