"""Checking a set on disk: that it is whole and consistent. Nothing is written."""

import itertools
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import DataError, first_of
from symsol_annot.rendering.renderer import BACKGROUND
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.manifest import Manifest, ShardEntry, read_manifest, shards_in
from symsol_annot.sets.membership import membership_faults
from symsol_annot.sets.shard.laws import label_faults, stabiliser_of
from symsol_annot.sets.shard.reader import Shard, ShardLabels, content_sha256, open_shard
from symsol_annot.system.reading import file_sha256

Flags: TypeAlias = npt.NDArray[np.bool_]

_LISTED_ROWS = 5


def verify(folder: Path, on_shard: Callable[[], object] = lambda: None) -> list[str]:
    """Return all faults of a set, one line each; none for a good one.

    Checksums are compared before HDF5 opens a file, so a damaged shard is named as that and read no further.

    Args:
        folder: the set's folder.
        on_shard: called after each shard.

    Raises:
        DataError: the folder holds no readable manifest, so there is nothing to check against.
    """
    manifest = read_manifest(folder)
    faults = _folder_faults(folder, manifest)
    common = _Common()
    for entry in manifest.shards:
        faults += [f"{entry.file}: {fault}" for fault in _shard_faults(folder, manifest, entry, common)]
        on_shard()
    return faults


def _folder_faults(folder: Path, manifest: Manifest) -> list[str]:
    expected = {entry.file for entry in manifest.shards}
    found = set(shards_in(folder))
    faults = [f"{name}: is no shard of this set; move it elsewhere" for name in sorted(found - expected)]
    faults += [
        f"{entry.file}: was never finished; the same render command makes it"
        for entry in manifest.shards
        if not entry.is_finished
    ]
    return faults


def _shard_faults(folder: Path, manifest: Manifest, entry: ShardEntry, common: "_Common") -> list[str]:
    if not entry.is_finished:
        return []
    path = folder / entry.file
    try:
        found_bytes = path.stat().st_size
        if path.is_file() and found_bytes != entry.bytes:  # so no more is read than the manifest says
            return [f"is damaged: expected {entry.bytes} bytes, found {found_bytes}"]
        sha256 = file_sha256(path)
    except OSError as error:
        return [f"is missing or cannot be read: {error.strerror}"]
    if sha256 != entry.sha256:
        return [f"is damaged: expected SHA-256 {entry.sha256}, found {sha256}"]
    faults: list[str] = []
    try:
        with open_shard(path) as shard:
            faults += membership_faults(shard, manifest, entry)
            labels = shard.labels()
            faults += label_faults(shard, labels)
            faults += _content_faults(shard, entry)
            faults += common.faults_of(shard, labels)
            if manifest.is_annotated(entry.split):
                faults += common.stabiliser_faults(entry.file, shard, labels)
                faults += common.volume_faults(entry.file, labels)
    except DataError as error:
        faults.append(str(error))
    return faults


def _content_faults(shard: Shard, entry: ShardEntry) -> Iterator[str]:
    """Yield what the pixels of no image set can be, and whether the arrays are those that the manifest lists."""
    if shard.segmentation is not None:
        yield from _map_faults(shard)
    if content_sha256(shard) != entry.content_sha256:
        yield f"its arrays do not have the digest content_sha256 {entry.content_sha256}"


def _map_faults(shard: Shard) -> Iterator[str]:
    """Yield which segmentations and depths no image can have."""
    parts, stray, no_depth = len(shard.parts), [], []
    depths = shard.rows("depth") if shard.depth is not None else itertools.repeat(None, len(shard))
    for row, (ids, depth) in enumerate(zip(shard.rows("segmentation"), depths, strict=True)):
        if not BACKGROUND < int(ids.max()) <= parts:
            stray.append(str(shard.first_index + row))
        if depth is not None and not _is_depth(depth, ids):
            no_depth.append(str(shard.first_index + row))
    if stray:
        known = ", ".join(str(number) for number in range(parts + 1))
        yield f"segmentation: image {first_of(stray, _LISTED_ROWS)}: holds an id outside {known}, or no object"
    if no_depth:
        yield (
            f"depth: image {first_of(no_depth, _LISTED_ROWS)}: is not finite and above 0 where the segmentation has "
            "the object, and 0 elsewhere"
        )


def _is_depth(depth: npt.NDArray[np.float32], ids: npt.NDArray[np.uint8]) -> bool:
    """Tell whether depths (H, W) are those of an object where ids (H, W) have one, and the background's elsewhere."""
    return bool(np.isfinite(depth).all() and ((depth > 0) == (ids != BACKGROUND)).all() and (depth >= 0).all())


class _Common:
    """What the shards of a set have in common, as the first that was read and has it says."""

    def __init__(self) -> None:
        self._group: Rotations | None = None
        self._versions = ""
        self._stabiliser: tuple[str, Flags] | None = None
        self._volumes: tuple[str, tuple[Volume, ...]] | None = None

    def faults_of(self, shard: Shard, labels: ShardLabels) -> Iterator[str]:
        """Yield in what a shard is not like the first one."""
        if self._group is None:
            self._group, self._versions = labels.symmetry_group, shard.versions_text
        if not np.array_equal(self._group, labels.symmetry_group):
            yield "symmetry_group: is not that of the set's first shard"
        if shard.versions_text != self._versions:
            yield f"versions: made with other software than the set's first shard: {shard.versions_text}"

    def volume_faults(self, file: str, labels: ShardLabels) -> Iterator[str]:
        """Yield whether images of a shard that show nothing have another volume than those of shards before it."""
        if not labels.volumes:
            return
        if self._volumes is None:
            self._volumes = file, labels.volumes
        known_from, known = self._volumes
        if labels.volumes != known:
            yield f"volumes: the sets of images that show nothing fill another volume than those of {known_from}"

    def stabiliser_faults(self, file: str, shard: Shard, labels: ShardLabels) -> Iterator[str]:
        """Yield whether a shard with the common group has another stabiliser than those before it.

        Args:
            file: the shard's name, for the message about a later one.
            shard: one that was given to `faults_of`.
            labels: its own.
        """
        stabiliser = stabiliser_of(shard, labels)
        if stabiliser is None or self._group is None or not np.array_equal(self._group, labels.symmetry_group):
            return
        if self._stabiliser is None:
            self._stabiliser = file, stabiliser
        known_from, known = self._stabiliser
        if not np.array_equal(stabiliser, known):
            yield (
                f"symmetry_mask: the set of the images that show the marking is not that of {known_from}: "
                f"{_elements(stabiliser)} of symmetry_group, expected {_elements(known)}"
            )


def _elements(chosen: Flags) -> str:
    numbers = [str(number) for number in np.flatnonzero(chosen)]
    return f"element {first_of(numbers, _LISTED_ROWS)}"
