"""The set that is published of a sealed test: its images alone, written anew from their pixels.

A participant's files are a function of the pixels, the object, camera and settings, the software and the commitment.
Nothing else of the set with labels is read to make them, so nothing else can be in them, in their sizes or their order.
"""

import hashlib
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from symsol_annot.errors import SealError
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sealing.secret import COMMITMENT_NAME, Secret
from symsol_annot.sets.manifest import Manifest, ShardEntry, write_manifest
from symsol_annot.sets.shard.header import content_heading
from symsol_annot.sets.shard.layout import GROUP
from symsol_annot.sets.shard.reader import Shard, opened_shard
from symsol_annot.sets.shard.writer import ShardWriter
from symsol_annot.system.files import new_folder, write_atomically


def write_images(secret: Secret, labelled: Path, made: Manifest, symmetry_group: Rotations, folder: Path) -> Manifest:
    """Write the set of a sealed test's images, and return its manifest; the folder appears once it is whole.

    Args:
        secret: of the sealed test.
        labelled: the folder of the set with labels, finished.
        made: that set's manifest.
        symmetry_group: (G, 3, 3) of the object's body, which anybody knows.
        folder: where nothing is.

    Raises:
        DataError: a shard of the set with labels is missing or damaged.
        OutputError: the folder cannot be written.
    """
    manifest = secret.public_manifest()
    with new_folder(folder) as place:
        for entry, source in zip(manifest.shards, made.shards, strict=True):
            shard = opened_shard(labelled / source.file, source.sha256, source.bytes)
            with closing(shard.file):
                manifest = manifest.with_finished(_write_shard(manifest, entry, shard, symmetry_group, place))
        write_manifest(place, manifest)
        write_atomically(place / COMMITMENT_NAME, secret.commitment.to_bytes())
    return manifest


def _write_shard(manifest: Manifest, entry: ShardEntry, shard: Shard, group: Rotations, place: Path) -> ShardEntry:
    header = manifest.header(entry, shard.versions)
    with ShardWriter(header, entry.images, group, annotated=False) as writer:
        for rgb in shard.rows("image"):
            writer.add_sealed(rgb)
        file = writer.finish({})
    write_atomically(place / entry.file, file.data)
    sha256 = hashlib.sha256(file.data).hexdigest()
    return replace(entry, bytes=len(file.data), sha256=sha256, content_sha256=file.content_sha256)


def refuse_other_images(public: Manifest, public_folder: Path, made: Manifest, labelled: Path) -> None:
    """Refuse a set with labels whose images are not those of a sealed set, to the bit.

    Raises:
        SealError: an image differs.
        DataError: a shard of the set with labels is missing or damaged.
    """
    for entry, source in zip(public.shards, made.shards, strict=True):
        shard = opened_shard(labelled / source.file, source.sha256, source.bytes)
        with closing(shard.file):
            if _images_sha256(shard) != entry.content_sha256:
                raise SealError(
                    f"{labelled / source.file}: its images are not those of {public_folder / entry.file}: other "
                    "software drew them, so its labels are not certain to be theirs"
                )


def _images_sha256(shard: Shard) -> str:
    """Return the content_sha256 of the shard that holds a shard's images alone."""
    image = shard.image
    digest = hashlib.sha256(content_heading(image.name, image.dtype, image.shape))
    for rgb in shard.rows("image"):
        digest.update(rgb.tobytes())
    group = shard.array_attributes[GROUP]
    digest.update(content_heading(GROUP, group.dtype.str, group.shape) + group.tobytes())
    return digest.hexdigest()
