"""Sets with right digests that take all memory, all time, or another file: each a few megabytes at most."""

import json
import os
import struct
import zlib
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from attack.places import CASES
from attack.signing import read_document, sign

SHARD = "test-00000-of-00001.h5"
IMAGES = 8  # of cases/shard.h5
_COMPRESSED = {"compression": "gzip", "fletcher32": True, "track_times": False}
_OLD, _NEW = ("earliest", "v108"), "latest"
_BLOCK = 2**24


def put_whole(folder):
    """Put the whole set that the others are made of into a folder; return its folder."""
    to = folder / "tetX"
    to.mkdir(parents=True)
    (to / "manifest.json").write_bytes((CASES / "manifest.json").read_bytes())
    (to / SHARD).write_bytes((CASES / "shard.h5").read_bytes())
    return to


def damaged_shards():
    """Return the shards that were found to hang or crash HDF5, or to be read wrongly: name to bytes."""
    found, whole = {}, (CASES / "shard.h5").read_bytes()
    for name, runs in json.loads((CASES / "shards.json").read_text()).items():
        content = bytearray(whole)
        for at, data in runs:
            content[at : at + len(data) // 2] = bytes.fromhex(data)
        found[name] = bytes(content)
    return found


@dataclass
class _Set:
    """A set that is being made: the whole shard, the new one, and the manifest."""

    folder: Path
    whole: h5py.File
    file: h5py.File
    document: dict

    def copy_all_but(self, *names):
        for name in self.whole:
            if name not in names:
                self.whole.copy(name, self.file)

    def put_chunk(self, rows, stream, offset=0):
        """Store a chunk that is compressed already."""
        checked = stream + fletcher32(stream).to_bytes(4, "little")
        rows.id.write_direct_chunk((offset,) + (0,) * (rows.ndim - 1), checked)

    def of_size(self, images, side):
        """Let manifest and shard say that there are so many images of so many pixels."""
        self.document["camera"] |= {"width": side, "height": side}
        self.file.attrs["camera"] = json.dumps(self.document["camera"], sort_keys=True)
        split = self.document["splits"]["test"]
        split["images"] = split["shards"][0]["images"] = images


def huge_chunk(made, gibibytes=3.9):
    """One chunk of almost 4 GiB for 8 rotations."""
    made.copy_all_but("rotation")
    rows = int(gibibytes * 2**30 / 72)
    head = made.whole["rotation"][...].tobytes()
    rotation = made.file.create_dataset(
        "rotation", (IMAGES, 3, 3), "f8", chunks=(rows, 3, 3), maxshape=(None, 3, 3), **_COMPRESSED
    )
    made.put_chunk(rotation, zeros_after(head, rows * 72 - len(head)))


def endless_stream(made, gibibytes=3.9):
    """A chunk of the right size whose stream goes on."""
    made.copy_all_but("rotation")
    rotation = made.file.create_dataset("rotation", (IMAGES, 3, 3), "f8", chunks=(IMAGES, 3, 3), **_COMPRESSED)
    made.put_chunk(rotation, zeros_after(made.whole["rotation"][...].tobytes(), int(gibibytes * 2**30)))


def endless_image(made, gibibytes=3.9):
    """The same for an image."""
    made.copy_all_but("image")
    image = made.file.create_dataset("image", data=made.whole["image"][...], chunks=(1, 48, 48, 3), **_COMPRESSED)
    made.put_chunk(image, zeros_after(made.whole["image"][0].tobytes(), int(gibibytes * 2**30)))


def huge_images(made, side=4000, images=64):
    """Images of which 64 at once are 3 GiB, and each is a few KiB in the file."""
    made.copy_all_but("image", "segmentation", "rotation", "marking_pixels", "symmetry_mask")
    for name, shape in (("image", (images, side, side, 3)), ("segmentation", (images, side, side))):
        rows = made.file.create_dataset(name, shape, "u1", chunks=(1, *shape[1:]), **_COMPRESSED)
        stream = zeros_after(b"\1", int(np.prod(shape[1:])) - 1)
        for image in range(images):
            made.put_chunk(rows, stream, image)
    for name in ("rotation", "marking_pixels", "symmetry_mask"):
        values = np.repeat(made.whole[name][:1], images, axis=0)
        made.file.create_dataset(name, data=values, chunks=values.shape, **_COMPRESSED)
    made.of_size(images, side)


def chunk_for_each_value(made, images=500, order=3600):
    """A mask of 1.8 million chunks, none with an index entry."""
    group = np.broadcast_to(np.eye(3), (order, 3, 3))
    made.file.create_dataset("image", (images, 1, 1, 3), "u1")
    made.file.create_dataset("segmentation", (images, 1, 1), "u1")
    made.file["rotation"], made.file["symmetry_group"] = group[:images], group
    made.file["marking_pixels"] = np.zeros(images, "f4")
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk((1, 1))
    plist.set_alloc_time(h5py.h5d.ALLOC_TIME_EARLY)
    plist.set_fill_time(h5py.h5d.FILL_TIME_NEVER)
    space = h5py.h5s.create_simple((images, order))
    h5py.h5d.create(made.file.id, b"symmetry_mask", h5py.h5t.py_create(np.dtype(bool)), space, plist)
    made.of_size(images, 1)


def shape_from_a_pipe(made):
    """A virtual data set without end over a FIFO: asking for its shape opens that."""
    made.copy_all_but("rotation")
    os.mkfifo(made.folder / "other")
    layout = h5py.VirtualLayout((IMAGES, 3, 3), "f8", maxshape=(None, 3, 3))
    source = h5py.VirtualSource("./other", "x", (IMAGES, 3, 3), "f8", maxshape=(None, 3, 3))
    layout[0 : h5py.h5s.UNLIMITED] = source[0 : h5py.h5s.UNLIMITED]
    made.file.create_virtual_dataset("rotation", layout)


_TEXTS, _TEXT_BYTES = 4000, 2**20


def one_text_many_times(made):
    """An attribute of 4,000 texts, which `_refer_to_one` makes one text of a MiB."""
    made.copy_all_but()
    texts = np.array(["x" * _TEXT_BYTES, *["y"] * (_TEXTS - 1)], dtype=object)
    del made.file.attrs["format"]
    made.file.attrs.create("format", texts, dtype=h5py.string_dtype())


def _refer_to_one(content):
    """Overwrite each reference to a short text by that to the long one."""
    content, long, short = bytearray(content), struct.pack("<I", _TEXT_BYTES), struct.pack("<I", 1)
    at = next(i for i in range(len(content)) if content[i : i + 4] == long and content[i + 16 : i + 20] == short)
    reference, here = content[at : at + 16], at + 16
    while content[here : here + 4] == short:
        content[here : here + 16] = reference
        here += 16
    return content


BOMBS = {
    huge_chunk: _OLD,
    endless_stream: _OLD,
    endless_image: _OLD,
    huge_images: _OLD,
    chunk_for_each_value: _NEW,
    shape_from_a_pipe: _NEW,
    one_text_many_times: _NEW,
}


def put_bomb(bomb, folder):
    """Make a set with a bomb in it, all digests right; return its folder."""
    to = put_whole(folder)
    shard, beside = to / SHARD, to / "made"
    with h5py.File(shard, "r") as whole, h5py.File(beside, "w", libver=BOMBS[bomb]) as file:
        file.attrs.update(whole.attrs)
        made = _Set(to, whole, file, read_document(to))
        bomb(made)
    beside.replace(shard)
    if bomb is one_text_many_times:
        shard.write_bytes(_refer_to_one(shard.read_bytes()))
    sign(to, made.document, contents=False)
    return to


def zeros_after(head, count):
    """Return the zlib stream of some bytes and of so many zeros after them, made without compressing them all."""
    begin = zlib.compressobj(9, zlib.DEFLATED, -15)
    parts = [b"\x78\xda", begin.compress(head), begin.flush(zlib.Z_FULL_FLUSH)]
    block = zlib.compressobj(9, zlib.DEFLATED, -15)
    parts += [block.compress(bytes(_BLOCK)) + block.flush(zlib.Z_FULL_FLUSH)] * (count // _BLOCK)
    rest = zlib.compressobj(9, zlib.DEFLATED, -15)
    parts += [rest.compress(bytes(count % _BLOCK)), rest.flush()]
    adler = zlib.adler32(head)
    low, high = adler & 0xFFFF, adler >> 16
    return b"".join([*parts, struct.pack(">I", (high + count * low) % 65521 << 16 | low)])


def fletcher32(data):
    """Return HDF5's checksum of a chunk (H5checksum.c)."""
    words = np.frombuffer(data + bytes(len(data) % 2), ">u2").astype(np.uint64)
    first = second = 0
    for start in range(0, len(words), 2**16):
        block = words[start : start + 2**16]
        second += len(block) * first + int((block * np.arange(len(block), 0, -1, dtype=np.uint64)).sum())
        first += int(block.sum())
    return _folded(second) << 16 | _folded(first)


def _folded(total):
    return (total - 1) % 65535 + 1 if total else 0
