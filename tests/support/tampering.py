"""Sets that somebody changed and signed again, so that no checksum shows it, and shards put together by hand."""

import hashlib
import shutil
import struct
import zlib
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from symsol_annot.sets.manifest import read_manifest, write_manifest

GROUP = "symmetry_group"  # an attribute, and in version 1 of the format a data set
IN_DIGEST = (
    "image",
    "segmentation",
    "depth",
    "rotation",
    "marking_pixels",
    "part_pixels",
    "symmetry_mask",
    "volume",
    GROUP,
)
ROW_PER_CHUNK = ("image", "segmentation", "depth")
_MOST_BYTES = 2**27  # of an array that is read for its digest
_UNREADABLE = (OSError, KeyError, TypeError, ValueError, RuntimeError, AttributeError)


def content_by_h5py(path):
    """Return the digest of a shard's arrays as docs/format.md defines it; None where h5py cannot read them."""
    digest = hashlib.sha256()
    try:
        with h5py.File(path) as shard:
            for name in (name for name in IN_DIGEST if name in shard):
                if shard[name].nbytes > _MOST_BYTES:
                    return None
                digest.update(f"{name} {shard[name].dtype.str} {shard[name].shape}\n".encode())
                digest.update(shard[name][...].tobytes())
            if GROUP in shard.attrs:
                group = shard.attrs[GROUP]
                digest.update(f"{GROUP} {group.dtype.str} {group.shape}\n".encode() + group.tobytes())
            if "volumes" in shard.attrs:
                bits = zlib.decompress(shard.attrs["volumes"].tobytes())
                digest.update(f"volumes |u1 ({len(bits) // 294912}, 294912)\n".encode() + bits)
    except _UNREADABLE:
        return None
    return digest.hexdigest()


def reseal(folder, *, contents=True, **entry_changes):
    """Make the manifest say that the shards were made as they are now: a tampering that no checksum shows.

    Args:
        folder: the set's.
        contents: whether HDF5 reads the arrays for content_sha256, which is not for files that make it crash.
        entry_changes: shard's file name to what its entry is to say besides.
    """
    manifest = read_manifest(folder)
    for entry in manifest.shards:
        path = folder / entry.file
        content = (content_by_h5py(path) if contents else None) or entry.content_sha256
        data = path.read_bytes()
        sealed = replace(entry, bytes=len(data), sha256=hashlib.sha256(data).hexdigest(), content_sha256=content)
        manifest = manifest.with_finished(replace(sealed, **entry_changes.get(entry.file, {})))
    write_manifest(folder, manifest)


@contextmanager
def tampered(folder, file):
    """Open a shard for editing, and reseal the set."""
    with h5py.File(folder / file, "r+") as shard:
        yield shard
    reseal(folder)


def put(shard, name, values, **options):
    """Put a data set into an open shard as the format stores it, in place of one that may be there.

    Args:
        shard: an h5py file.
        name: of the data set.
        values: an array; None where `options` give a shape and a type.
        options: what is to be otherwise, as h5py's `create_dataset` has it.
    """
    if name in shard:
        del shard[name]
    shape = options.get("shape") or np.shape(values)
    rows = 1 if name in ROW_PER_CHUNK else shape[0]
    stored = {"chunks": (rows, *shape[1:]), "compression": "gzip", "fletcher32": True, "track_times": False}
    shard.create_dataset(name, data=values, **{**stored, **options})


def change_group(shard, change):
    """Put what `change` makes of the symmetry group of an open shard in its stead, with the digest of that."""
    group = np.ascontiguousarray(change(shard.attrs[GROUP]))
    shard.attrs[GROUP] = group
    shard.attrs[f"{GROUP}_sha256"] = hashlib.sha256(group).hexdigest()


def flip_bit(path, bit):
    """Flip one bit of a file."""
    with path.open("r+b") as file:
        file.seek(bit // 8)
        byte = file.read(1)[0]
        file.seek(bit // 8)
        file.write(bytes([byte ^ 1 << bit % 8]))


def flip_chunk(path, name, number=0):
    """Flip a bit in the middle of a chunk."""
    with h5py.File(path) as shard:
        chunk = shard[name].id.get_chunk_info(number)
    flip_bit(path, 8 * (chunk.byte_offset + chunk.size // 2))


class ChunkIndex:
    """The B-tree of a data set's chunks, as the old format has it: one leaf, found by where it says the chunks lie.

    A node is its head (24 bytes, the count of its entries at byte 6), then by turns keys and addresses of chunks; a key
    is the chunk's size (4 bytes), the filters that were left out (4), and its offsets, 8 each, the type's among them.
    """

    def __init__(self, path, name):
        with h5py.File(path) as shard:
            rows = shard[name]
            chunks = [rows.id.get_chunk_info(number) for number in range(rows.id.get_num_chunks())]
            self._entry = 8 + 8 * (rows.ndim + 1) + 8
        self._path = path
        data = path.read_bytes()
        address = struct.pack("<Q", chunks[0].byte_offset)
        starts = [at for at in _all(data, b"TREE\x01\x00") if data[at + 24 + self._entry - 8 :].startswith(address)]
        (self._start,) = starts

    def change_count(self, by):
        """Change how many chunks the node says that there are."""
        self._change(self._start + 6, "<H", lambda count: count + by)

    def change_size(self, number, to):
        """Change the stored size of a chunk."""
        self._change(self._key(number), "<I", lambda _: to)

    def change_mask(self, number, to):
        """Change which filters a chunk says were left out."""
        self._change(self._key(number) + 4, "<I", lambda _: to)

    def change_offset(self, number, axis, to):
        """Change where in the data set a chunk begins."""
        self._change(self._key(number) + 8 + 8 * axis, "<Q", lambda _: to)

    def change_address(self, number, to):
        """Change where in the file a chunk lies."""
        self._change(self._key(number) + self._entry - 8, "<Q", lambda _: to)

    def bits(self, entries):
        """Return the places in the file of all bits of the first entries."""
        return range(8 * self._start, 8 * (self._start + 24 + entries * self._entry))

    def _key(self, number):
        return self._start + 24 + number * self._entry

    def _change(self, at, kind, change):
        with self._path.open("r+b") as file:
            file.seek(at)
            (value,) = struct.unpack(kind, file.read(struct.calcsize(kind)))
            file.seek(at)
            file.write(struct.pack(kind, change(value)))


def links_instead(path, place):
    """Put a file elsewhere and a link in its stead, as stores of data do."""
    elsewhere = place / path.name
    shutil.move(path, elsewhere)
    path.symlink_to(elsewhere)
    return elsewhere


def descriptors(of=None):
    """Return what this process has open: of one file, or all."""
    found = []
    for link in Path("/proc/self/fd").iterdir():
        try:
            found.append(str(link.readlink()))
        except OSError:  # that of the listing itself
            continue
    return [name for name in found if of is None or name == str(of)]


def _all(data, mark):
    at = data.find(mark)
    while at >= 0:
        yield at
        at = data.find(mark, at + 1)


def marked(folder, row, pixels):
    """Give an image of the second shard another marked area, and a set that the one rule allows there."""
    with tampered(folder, "test-00001-of-00003.h5") as file:
        shown = file["marking_pixels"][...] >= 5.0
        stabiliser, free = file["symmetry_mask"][int(np.argmax(shown))], file["symmetry_mask"][int(np.argmin(shown))]
        file["marking_pixels"][row] = file["part_pixels"][row, 1] = pixels
        file["symmetry_mask"][row] = stabiliser if pixels >= 5.0 else free
