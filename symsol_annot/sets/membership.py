"""Whether a shard is the one that a set's manifest lists; opening a shard after that check."""

import contextlib
from collections.abc import Iterator
from pathlib import Path

from symsol_annot.errors import DataError, bulleted
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.shard.laws import label_faults
from symsol_annot.sets.shard.reader import Shard, ShardLabels, header_mismatches, opened_shard


def checked_shard(
    folder: Path, manifest: Manifest, entry: ShardEntry, *, check: bool = True
) -> tuple[Shard, ShardLabels]:
    """Open a shard of a set and read its labels, after checking that it is the manifest's and obeys all laws.

    Args:
        folder: the set's.
        manifest: of the set.
        entry: which shard.
        check: whether its size and SHA-256 are compared with the manifest's, too.

    Returns:
        The shard, and its labels.

    Raises:
        DataError: it is missing, damaged, another set's, or breaks a law; the message lists every fault.
    """
    path = folder / entry.file
    shard = opened_shard(path, entry.sha256, entry.bytes) if check else opened_shard(path)
    with contextlib.ExitStack() as at_an_error:
        at_an_error.callback(shard.file.close)
        labels = shard.labels()
        faults = [*membership_faults(shard, manifest, entry)]
        if faults:
            raise DataError(f"{path}: is no shard of this set:\n" + bulleted(faults))
        faults = [*label_faults(shard, labels)]
        if faults:
            raise DataError(f"{path}: its labels are none of an image set:\n" + bulleted(faults))
        at_an_error.pop_all()
    return shard, labels


def membership_faults(shard: Shard, manifest: Manifest, entry: ShardEntry) -> Iterator[str]:
    """Yield why a shard is not the one that a manifest lists, one line each."""
    found, expected = shard.layout.version, manifest.format_version
    if found != expected:
        yield f"expected format version {expected}, that of the manifest, found {found}: fetch the whole set again"
        return
    yield from header_mismatches(shard, manifest.expected_attributes(entry))
    if len(shard) != entry.images:
        yield f"expected {entry.images} images, found {len(shard)}"
    if shard.is_annotated != manifest.is_annotated(entry.split):
        yield "symmetry_mask: manifest and shard disagree on whether the split has symmetry sets"
    if (shard.depth is not None) != manifest.settings.has_depth:
        yield "depth: manifest and shard disagree on whether images have depth maps"
