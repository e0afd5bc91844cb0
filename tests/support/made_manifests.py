"""Manifests of a set that was never made: planned, finished, changed, and sealed again."""

import hashlib
import json
from dataclasses import replace

from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.stated.settings import RenderedSettings

SETTINGS = RenderedSettings(
    object="mug",
    object_sha256="ab" * 32,
    seed=7,
    camera=Camera(4.0, 27.9, 16, 16),
    render=RenderSettings(),
    tolerance_px=5.0,
    annotate="test",
)
PLANNED = Manifest(
    SETTINGS,
    (
        ShardEntry("train-00000-of-00001.h5", "train", 0, 5),
        ShardEntry("test-00000-of-00002.h5", "test", 0, 16),
        ShardEntry("test-00001-of-00002.h5", "test", 16, 3),
    ),
)


def finished(entry):
    number = entry.first_index + entry.images
    return replace(entry, bytes=1000 + number, sha256=f"{number:064x}", content_sha256=f"{number + 100:064x}")


FINISHED = replace(PLANNED, shards=tuple(finished(entry) for entry in PLANNED.shards))


def with_entry(number, **changes):
    """The finished manifest with one shard's entry changed."""
    return FINISHED.with_finished(replace(FINISHED.shards[number], **changes))


def canonical_sha256(document):
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()


def write_sealed(folder, document):
    """Write a manifest whose digest of itself is right, as anyone who edits it can."""
    body = {key: value for key, value in document.items() if key != "manifest_sha256"}
    sealed = {**body, "manifest_sha256": canonical_sha256(body)}
    (folder / "manifest.json").write_text(json.dumps(sealed, indent=1) + "\n")
