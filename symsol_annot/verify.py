"""Checking a set on disk: that it is whole, and that what it says holds together. It reads and never writes."""

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeAlias

import h5py
import numpy as np
import numpy.typing as npt

from symsol_annot.chunks import HDF5_ERRORS
from symsol_annot.errors import DataError, first_of
from symsol_annot.files import file_sha256
from symsol_annot.manifest import Manifest, ShardEntry, read_manifest
from symsol_annot.scene import MARKING
from symsol_annot.shards import content_sha256, header_mismatches, open_shard
from symsol_annot.so3 import ORTHONORMAL_TOLERANCE, Rotations, rotation_deviation

Flags: TypeAlias = npt.NDArray[np.bool_]

_ROWS_AT_ONCE = 64
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
    first = _FirstShard()
    for entry in manifest.shards:
        faults += [f"{entry.file}: {fault}" for fault in _shard_faults(folder, manifest, entry, first)]
        on_shard()
    return faults


def _folder_faults(folder: Path, manifest: Manifest) -> list[str]:
    expected = {entry.file for entry in manifest.shards}
    found = {path.name for path in folder.glob("*.h5")}
    faults = [f"{name}: is no shard of this set; move it elsewhere" for name in sorted(found - expected)]
    faults += [
        f"{entry.file}: was never finished; the same render command makes it"
        for entry in manifest.shards
        if not entry.is_finished
    ]
    return faults


def _shard_faults(folder: Path, manifest: Manifest, entry: ShardEntry, first: "_FirstShard") -> list[str]:
    if not entry.is_finished:
        return []
    path = folder / entry.file
    try:
        sha256 = file_sha256(path)
    except OSError as error:
        return [f"is missing or cannot be read: {error.strerror}"]
    if path.stat().st_size != entry.bytes:
        return [f"is damaged: expected {entry.bytes} bytes, found {path.stat().st_size}"]
    if sha256 != entry.sha256:
        return [f"is damaged: expected SHA-256 {entry.sha256}, found {sha256}"]
    faults: list[str] = []
    try:
        with open_shard(path) as shard:
            for found in (_header_faults(manifest, entry, shard), _content_faults(shard), first.faults_of(shard)):
                faults += found
    except DataError as error:
        faults.append(str(error))
    except HDF5_ERRORS as error:
        faults.append(f"cannot be read, though its checksum is right: {error}")
    return faults


def _header_faults(manifest: Manifest, entry: ShardEntry, shard: h5py.File) -> Iterator[str]:
    yield from header_mismatches(shard, manifest.expected_attributes(entry))
    if len(shard["rotation"]) != entry.images:
        yield f"the manifest says {entry.images} images, the shard holds {len(shard['rotation'])}"
    if ("symmetry_mask" in shard) != manifest.is_annotated(entry.split):
        yield "symmetry_mask: manifest and shard disagree on whether the split has symmetry sets"
    if content_sha256(shard) != entry.content_sha256:
        yield f"its arrays do not have the digest content_sha256 {entry.content_sha256}"


def _content_faults(shard: h5py.File) -> Iterator[str]:
    """Yield what no image set can hold, whatever its checksums say."""
    first = int(shard.attrs["first_index"])

    def images(bad: Flags) -> str:
        listed = [str(first + int(row)) for row in np.flatnonzero(bad)]
        return f"image {first_of(listed, _LISTED_ROWS)}"

    no_rotation = ~(rotation_deviation(shard["rotation"][...]) <= ORTHONORMAL_TOLERANCE)
    if no_rotation.any():
        yield f"rotation: {images(no_rotation)}: is no rotation (R^T R = I, det R = 1 to {ORTHONORMAL_TOLERANCE:g})"
    if "source" not in shard.attrs:
        yield from _rendering_faults(shard, images)
    yield from _group_faults(shard["symmetry_group"][...])
    if "symmetry_mask" in shard:
        yield from _mask_faults(shard, images)


def _rendering_faults(shard: h5py.File, images: Callable[[Flags], str]) -> Iterator[str]:
    """Yield what no rendered shard can hold; an imported one has none of it."""
    stray = _segmentation_is_bad(shard)
    if stray.any():
        yield f"segmentation: {images(stray)}: holds an id outside 0, 1, 2, or no object"
    no_area = ~(np.isfinite(shard["marking_pixels"][...]) & (shard["marking_pixels"][...] >= 0))
    if no_area.any():
        yield f"marking_pixels: {images(no_area)}: is no area"


def _group_faults(group: Rotations) -> Iterator[str]:
    bad = ~(rotation_deviation(group) <= ORTHONORMAL_TOLERANCE)
    if bad.any():
        yield f"symmetry_group: element {int(np.argmax(bad))} is no rotation"
    if np.abs(group[0] - np.eye(3)).max() > ORTHONORMAL_TOLERANCE:
        yield "symmetry_group: element 0 is not the identity"


class _FirstShard:
    """What the first shard that was read holds and all others must hold too."""

    def __init__(self) -> None:
        self._group: Rotations | None = None
        self._versions = ""

    def faults_of(self, shard: h5py.File) -> Iterator[str]:
        group, versions = shard["symmetry_group"][...], str(shard.attrs["versions"])
        if self._group is None:
            self._group, self._versions = group, versions
        if not np.array_equal(self._group, group):
            yield "symmetry_group: is not that of the set's first shard"
        if versions != self._versions:
            yield f"versions: made with other software than the set's first shard: {versions}"


def _mask_faults(shard: h5py.File, images: Callable[[Flags], str]) -> Iterator[str]:
    mask = shard["symmetry_mask"][...]
    if not mask[:, 0].all():
        yield f"symmetry_mask: {images(~mask[:, 0])}: the set lacks R_gt, the image's own rotation"
    if np.isnan(shard.attrs.get("tolerance_px", np.nan)):
        if not mask.all():
            yield f"symmetry_mask: {images(~mask.all(axis=1))}: a body without marking has its whole group"
        return
    shown = shard["marking_pixels"][...] >= float(shard.attrs["tolerance_px"])
    if shown.any() and (mask[shown] != mask[shown][0]).any():
        yield "symmetry_mask: images that show the marking have different sets, expected the stabiliser in each"
    elif shown.any() and not mask[~shown][:, mask[shown][0]].all():
        yield "symmetry_mask: a set of a hidden marking lacks a rotation that maps the marking onto itself"


def _segmentation_is_bad(shard: h5py.File) -> Flags:
    segmentation = shard["segmentation"]
    bad = np.zeros(len(segmentation), dtype=bool)
    for start in range(0, len(bad), _ROWS_AT_ONCE):
        ids = segmentation[start : start + _ROWS_AT_ONCE].reshape(-1, segmentation.shape[1] * segmentation.shape[2])
        bad[start : start + _ROWS_AT_ONCE] = (ids.max(axis=1) > MARKING) | (ids.max(axis=1) == 0)
    return bad
