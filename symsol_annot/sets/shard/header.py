"""What a shard says of itself: its file's name, and its attributes but for the symmetry group."""

import json
import math
from dataclasses import dataclass
from typing import Any

from symsol_annot.sets.shard.layout import EQUALITY, FROM_SECRET, LAYOUTS, NEWEST, PARTS, RENDERED
from symsol_annot.sets.stated.settings import ImportedSettings, RenderedSettings, SealedSettings, SetSettings
from symsol_annot.sets.stated.values import MAX_SEED, seed_to_json

SHARD_FORMAT = "symsol-annot shard"
MAX_IMAGES_PER_SHARD = 500


@dataclass(frozen=True)
class ShardHeader:
    """What a shard says of itself: with the settings of its set, all that is needed to make it again.

    Attributes:
        settings: of the set.
        split: "train" or "test".
        first_index: the index within the split of the shard's first image.
        versions: the software that decides the bytes: name to version.
        format_version: of the shard's format, one of `LAYOUTS`.
    """

    settings: SetSettings
    split: str
    first_index: int
    versions: dict[str, str]
    format_version: int = NEWEST

    def to_attributes(self) -> dict[str, Any]:
        """Return the HDF5 attributes, in the order in which they are written; what is not known has none."""
        settings = self.settings
        start = {"format": SHARD_FORMAT, "format_version": self.format_version, "object": settings.object}
        place = {"split": self.split, "first_index": self.first_index}
        versions = {"versions": _as_text(self.versions)}
        if isinstance(settings, ImportedSettings):
            known = {"camera": _as_text(settings.camera_to_json())}
            return {**start, **place, **known, **versions, "source": _as_text(settings.source.to_json())}
        if isinstance(settings, SealedSettings):
            known = {"camera": _as_text(settings.camera.to_dict()), "render": _as_text(settings.render.to_dict())}
            sealed = {"object_sha256": settings.object_sha256, "commitment": settings.commitment}
            return {**start, **place, **known, **versions, **sealed}
        if not isinstance(settings, RenderedSettings):
            kinds = "a rendered, an imported or a sealed set"
            raise TypeError(f"expected the settings of {kinds}, found {type(settings).__name__}")
        kind = RENDERED if settings.seed <= MAX_SEED else FROM_SECRET
        drawing = {
            kind.mark: seed_to_json(settings.seed),
            "camera": _as_text(settings.camera.to_dict()),
            "render": _as_text(settings.render.to_dict()),
            "engine": settings.render.engine,
            "tolerance_px": math.nan if settings.tolerance_px is None else settings.tolerance_px,
        }
        parts = {PARTS: json.dumps(settings.parts)} if LAYOUTS[self.format_version].has_parts else {}
        equality = {} if settings.equality is None else {EQUALITY: settings.equality.to_text()}
        return {**start, "object_sha256": settings.object_sha256, **place, **drawing, **parts, **equality, **versions}


def shard_file_name(split: str, number: int, shards: int) -> str:
    """Return the file's name of a split's shard, counted from 0, of so many."""
    return f"{split}-{number:05d}-of-{shards:05d}.h5"


def content_heading(name: str, dtype: str, shape: tuple[int, ...]) -> bytes:
    """Return what precedes the values of a data set or an array in the digest of a shard's contents."""
    return f"{name} {dtype} {shape}\n".encode()


def _as_text(values: dict[str, Any]) -> str:
    return json.dumps(values, sort_keys=True)
