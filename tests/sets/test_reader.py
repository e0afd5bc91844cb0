"""The shard: what h5py alone reads from it, which bytes it is, and which files are refused as one."""

import hashlib
import json
import os
import random
import re
import shutil
import threading
import time
import tracemalloc
import zlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
from tampering import ChunkIndex, descriptors, links_instead, put

from symsol_annot.errors import DataError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.settings import RenderedSettings
from symsol_annot.sets.shard import reader as shards
from symsol_annot.sets.shard.chunks import stored
from symsol_annot.sets.shard.header import ShardHeader
from symsol_annot.sets.shard.reader import content_sha256, open_shard, opened_shard
from symsol_annot.sets.shard.writer import ImageRecord, ShardWriter

COUNT, HEIGHT, WIDTH = 5, 12, 16  # not square, so that height and width cannot be swapped
GROUP = np.array([[[c, -s, 0], [s, c, 0], [0, 0, 1]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))], dtype=float)
SETTINGS = RenderedSettings(
    object="mug",
    object_sha256="ab" * 32,
    seed=7,
    camera=Camera(4.0, 27.9, WIDTH, HEIGHT),
    render=RenderSettings("cycles", ambient=0.5),
    tolerance_px=0.25,
    annotate="all",
)
HEADER = ShardHeader(SETTINGS, "test", 32, versions={"renderer": "none", "hdf5": "0"})


def header(**changes):
    """The header of a shard whose set has other settings."""
    return replace(HEADER, settings=replace(SETTINGS, **changes))


NOTES = {"candidates_drawn": 11, "candidates_within_tolerance": 2}
LAYOUT = {
    "image": ("|u1", (COUNT, HEIGHT, WIDTH, 3)),
    "segmentation": ("|u1", (COUNT, HEIGHT, WIDTH)),
    "rotation": ("<f8", (COUNT, 3, 3)),
    "marking_pixels": ("<f4", (COUNT,)),
    "symmetry_mask": ("|b1", (COUNT, len(GROUP))),
    "symmetry_group": ("<f8", (len(GROUP), 3, 3)),
}


def records(annotated=True):
    """Arbitrary contents: a shard stores what it is given."""
    rng = np.random.default_rng(0)
    return [
        ImageRecord(
            view=View(
                rng.integers(256, size=(HEIGHT, WIDTH, 3), dtype=np.uint8),
                rng.integers(3, size=(HEIGHT, WIDTH), dtype=np.uint8),
                0.0,
            ),
            R_m2c=rng.standard_normal((3, 3)),
            coset_px=float(np.float32(rng.random())),
            symmetry_mask=rng.random(len(GROUP)) < 0.5 if annotated else None,
        )
        for _ in range(COUNT)
    ]


def build(header=HEADER, annotated=True, before_image=lambda: None):
    writer = ShardWriter(header, COUNT, GROUP, annotated=annotated)
    try:
        for record in records(annotated):
            before_image()
            writer.add(record)
        return writer.finish(NOTES)
    finally:
        writer.close()


@pytest.fixture
def shard(tmp_path):
    """A good shard that a test may damage."""
    path = tmp_path / "test-00002-of-00003.h5"
    path.write_bytes(build().data)
    return path


def refusal(path):
    """Open a shard that must be refused, and return why."""
    with pytest.raises(DataError) as refused, open_shard(path):
        pass
    assert str(path) in str(refused.value)
    return str(refused.value)


def read_all(path):
    """Open a shard and read every value of it: name to array."""
    with open_shard(path) as shard:
        whole = {name: shard.read(name) for name in shard.arrays}
        for name in ("image", "segmentation"):
            np.testing.assert_array_equal(np.stack(list(shard.rows(name))), whole[name])
        return whole


def test_h5py_alone_reads_what_was_written(shard):
    expected = records()
    with h5py.File(shard) as file:
        assert {name: (file[name].dtype.str, file[name].shape) for name in file} == LAYOUT
        for row, record in enumerate(expected):
            np.testing.assert_array_equal(file["image"][row], record.view.rgb)
            np.testing.assert_array_equal(file["segmentation"][row], record.view.segmentation)
            np.testing.assert_array_equal(file["rotation"][row], record.R_m2c)
            assert file["marking_pixels"][row] == record.coset_px
            np.testing.assert_array_equal(file["symmetry_mask"][row], record.symmetry_mask)
        np.testing.assert_array_equal(file["symmetry_group"][...], GROUP)


def test_split_without_annotation_has_no_symmetry_mask_and_is_valid(tmp_path):
    path = tmp_path / "train-00000-of-00001.h5"
    path.write_bytes(build(annotated=False).data)
    with open_shard(path) as shard:
        assert set(shard.arrays) == set(LAYOUT) - {"symmetry_mask"}
        assert not shard.is_annotated


def test_what_is_read_is_what_h5py_reads(shard):
    found = read_all(shard)
    with h5py.File(shard) as file:
        assert set(found) == set(file)
        for name, values in found.items():
            assert (values.dtype, values.shape) == (file[name].dtype, file[name].shape)
            np.testing.assert_array_equal(values, file[name][...])
        with open_shard(shard) as opened:
            assert opened.attributes == dict(file.attrs)
            assert opened.versions == HEADER.versions
            assert len(opened) == COUNT


def test_attributes_say_everything_needed_to_make_the_shard_again(shard):
    with h5py.File(shard) as file:
        found = {name: file.attrs[name] for name in file.attrs}
    for name in ("camera", "render", "versions"):
        found[name] = json.loads(found[name])
    assert found == {
        "format": "symsol-annot shard",
        "format_version": 1,
        "object": "mug",
        "object_sha256": "ab" * 32,
        "split": "test",
        "first_index": 32,
        "seed": 7,
        "camera": {"distance": 4.0, "focal_px": 27.9, "width": WIDTH, "height": HEIGHT},
        "render": {
            "engine": "cycles",
            "samples_per_axis": 2,
            "body_colour": [0.72, 0.80, 0.94],
            "marking_colour": [0.95, 0.16, 0.04],
            "background_colour": [1.0, 1.0, 1.0],
            "ambient": 0.5,
            "diffuse": 0.96,
        },
        "engine": "cycles",
        "tolerance_px": 0.25,
        "versions": HEADER.versions,
        **NOTES,
    }


def test_tolerance_of_an_object_without_marking_is_nan(tmp_path):
    path = tmp_path / "plain.h5"
    path.write_bytes(build(header(tolerance_px=None)).data)
    with open_shard(path) as shard:
        assert np.isnan(shard.attributes["tolerance_px"])


def test_chunk_holds_one_image(shard):
    with h5py.File(shard) as file:
        assert file["image"].chunks == (1, HEIGHT, WIDTH, 3)
        assert file["segmentation"].chunks == (1, HEIGHT, WIDTH)


def test_every_data_set_has_gzip_and_fletcher32_and_no_other_filter(shard):
    with h5py.File(shard) as file:
        for name in file:
            plist = file[name].id.get_create_plist()
            filters = [plist.get_filter(i)[0] for i in range(plist.get_nfilters())]
            assert filters == [h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32], name


def test_file_is_of_the_oldest_format_so_that_old_readers_read_it(shard):
    data = shard.read_bytes()
    assert data[:8] == b"\x89HDF\r\n\x1a\n"
    assert data[8] == 0, "superblock version"
    newer_structures = (b"OHDR", b"BTHD", b"FRHP", b"FADB", b"EAHD", b"FAHD", b"SMTB")
    assert not [mark for mark in newer_structures if mark in data]


def test_no_data_set_carries_a_time(shard):
    with h5py.File(shard) as file:
        assert {name: h5py.h5g.get_objinfo(file[name].id).mtime for name in file} == dict.fromkeys(LAYOUT, 0)


def test_shard_that_lacks_images_is_not_finished():
    writer = ShardWriter(HEADER, COUNT, GROUP, annotated=True)
    writer.add(records()[0])
    with pytest.raises(ValueError, match=f"made for {COUNT} images and holds 1"):
        writer.finish(NOTES)
    writer.close()


def test_image_of_another_size_or_type_is_refused():
    good = records()[0]
    writer = ShardWriter(HEADER, COUNT, GROUP, annotated=True)
    for view in (
        replace(good.view, rgb=good.view.rgb[:-1]),
        replace(good.view, rgb=good.view.rgb.astype("f4")),
        replace(good.view, segmentation=good.view.segmentation.T),
    ):
        with pytest.raises(ValueError, match=r"expected uint8 \(1, 12, 16"):
            writer.add(replace(good, view=view))
    writer.close()


def test_shard_of_one_image_is_valid(tmp_path):
    writer = ShardWriter(HEADER, 1, GROUP, annotated=True)
    writer.add(records()[0])
    made = writer.finish(NOTES)
    writer.close()
    path = tmp_path / "test-00000-of-00001.h5"
    path.write_bytes(made.data)
    with open_shard(path) as shard:
        assert content_sha256(shard) == made.content_sha256
        np.testing.assert_array_equal(next(shard.rows("image")), records()[0].view.rgb)


def test_same_contents_give_the_same_bytes_at_another_time():
    first = build()
    time.sleep(1.1)  # HDF5's times are in seconds
    assert build() == first


def test_same_contents_give_the_same_bytes_in_two_threads_at_once():
    both = threading.Barrier(2, timeout=30)
    with ThreadPoolExecutor(2) as pool:
        shards = [pool.submit(build, before_image=both.wait) for _ in range(2)]
        assert [shard.result() for shard in shards] == [build()] * 2


def digest_of(path):
    with open_shard(path) as shard:
        return content_sha256(shard)


def test_content_digest_is_over_names_types_shapes_and_values(shard):
    digest = hashlib.sha256()
    with h5py.File(shard) as file:
        for name, (dtype, shape) in LAYOUT.items():
            digest.update(f"{name} {dtype} {shape}\n".encode() + file[name][...].tobytes())
    assert digest_of(shard) == digest.hexdigest() == build().content_sha256


@pytest.mark.parametrize("version", ["earliest", "v108", "latest"])
def test_content_digest_does_not_depend_on_compression_and_library(shard, tmp_path, version):
    with h5py.File(shard) as file, h5py.File(tmp_path / "other.h5", "w", libver=version) as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...], compression_opts=9)
    assert (tmp_path / "other.h5").read_bytes() != shard.read_bytes()
    assert digest_of(tmp_path / "other.h5") == digest_of(shard)


@pytest.mark.parametrize("name", LAYOUT)
def test_content_digest_depends_on_every_value(shard, name):
    with h5py.File(shard, "r+") as file:
        values = file[name][...]
        last = values.reshape(-1)[-1:]
        last[...] = ~last if values.dtype == bool else last + 1
        file[name][...] = values
    assert digest_of(shard) != build().content_sha256


def test_content_digest_does_not_depend_on_the_header():
    assert build(header(seed=8)).content_sha256 == build().content_sha256


# What is not as the format has it is refused, and nothing of it is read


def replaced(name, **how):
    """A tampering: the same values, or others, stored in another way."""

    def tamper(file, whole):
        put(file, name, how.pop("data", file[name][...]) if "shape" not in how else None, **how)

    return tamper


def plain(name, **how):
    """A tampering: the values stored without chunks and filters, or with those given alone."""

    def tamper(file, whole):
        values = file[name][...]
        del file[name]
        file.create_dataset(name, **{"data": values, **how})

    return tamper


def of_type(name, kind, values=None):
    """A tampering: a data set of a type that h5py has no word for, with such values as it would take."""

    def tamper(file, whole):
        values_there = file[name][...]
        del file[name]
        chunks = values_there.shape if name not in ("image", "segmentation") else (1, *values_there.shape[1:])
        plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
        plist.set_chunk(chunks)
        plist.set_deflate(4)
        plist.set_fletcher32()
        rows = h5py.h5d.create(file.id, name.encode(), kind, h5py.h5s.create_simple(values_there.shape), plist)
        data = values_there if values is None else values
        chunk = stored(np.ascontiguousarray(data))
        rows.write_direct_chunk((0,) * len(chunks), chunk)

    return tamper


def external_link(file, whole):
    del file["image"]
    file["image"] = h5py.ExternalLink(str(whole), "/image")


def soft_link(file, whole):
    file.move("image", "elsewhere")
    file["image"] = h5py.SoftLink("/elsewhere")


def soft_link_to_itself(file, whole):
    del file["image"]
    file["image"] = h5py.SoftLink("/image")


def dangling_link(file, whole):
    del file["symmetry_mask"]
    file["symmetry_mask"] = h5py.SoftLink("/nowhere")


def root_in_itself(file, whole):
    file["loop"] = file["/"]


def root_in_place_of_a_data_set(file, whole):
    del file["image"]
    file["image"] = file["/"]


def external_storage(file, whole):
    shape, size = file["image"].shape, file["image"].nbytes
    del file["image"]
    file.create_dataset("image", shape, "u1", external=[(str(whole), 0, size)])


def virtual(file, whole):
    shape = file["image"].shape
    del file["image"]
    layout = h5py.VirtualLayout(shape, "u1")
    layout[:] = h5py.VirtualSource(str(whole), "image", shape)
    file.create_virtual_dataset("image", layout)


def virtual_without_end(file, whole):
    """HDF5 opens the other file, here a pipe that nobody writes to, when it is asked for the shape."""
    del file["rotation"]
    os.mkfifo(whole.with_name("fifo"))
    layout = h5py.VirtualLayout((COUNT, 3, 3), "f8", maxshape=(None, 3, 3))
    source = h5py.VirtualSource(str(whole.with_name("fifo")), "x", (COUNT, 3, 3), "f8", maxshape=(None, 3, 3))
    layout[0 : h5py.h5s.UNLIMITED] = source[0 : h5py.h5s.UNLIMITED]
    file.create_virtual_dataset("rotation", layout)


def compact(file, whole):
    values = file["marking_pixels"][...]
    del file["marking_pixels"]
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_layout(h5py.h5d.COMPACT)
    space = h5py.h5s.create_simple(values.shape)
    h5py.h5d.create(file.id, b"marking_pixels", h5py.h5t.IEEE_F32LE, space, plist)


def extra_data_set(file, whole):
    file["thumbnail"] = np.zeros(3)


def too_many_names(file, whole):
    for number in range(100):
        file.create_group(f"group {number}")


def group_in_place_of_a_data_set(file, whole):
    del file["rotation"]
    file.create_group("rotation")


def type_in_place_of_a_data_set(file, whole):
    del file["rotation"]
    file["rotation"] = np.dtype("f8")


def no_rows(file, whole):
    for name in set(file) - {"symmetry_group"}:
        shape, dtype = file[name].shape, file[name].dtype
        del file[name]
        file.create_dataset(name, (0, *shape[1:]), dtype)


def more_rows_than_memory(file, whole):
    for name in set(file) - {"symmetry_group"}:
        rest = file[name].shape[1:]
        put(file, name, None, shape=(10**12, *rest), dtype=file[name].dtype, chunks=(1, *rest))


def more_images_than_a_shard_has(file, whole):
    for name in set(file) - {"symmetry_group"}:
        rest = file[name].shape[1:]
        rows = 1 if name in ("image", "segmentation") else 501
        put(file, name, None, shape=(501, *rest), dtype=file[name].dtype, chunks=(rows, *rest))


def group_larger_than_memory(file, whole):
    del file["symmetry_mask"]
    put(file, "symmetry_group", None, shape=(40_000_000, 3, 3), dtype="f8", chunks=(4096, 3, 3))


def chunk_larger_than_memory(file, whole):
    """A chunk of almost 4 GiB for 5 rotations, in 4 MB."""
    values = file["rotation"][...]
    rows = 2**32 // 72 - 1
    put(file, "rotation", None, shape=values.shape, dtype="f8", chunks=(rows, 3, 3), maxshape=(None, 3, 3))
    file["rotation"].id.write_direct_chunk((0, 0, 0), stored(values))


def a_chunk_for_each_truth_value(file, whole):
    plain("symmetry_mask", chunks=(1, 1), compression="gzip", fletcher32=True)(file, whole)


def without(name):
    def tamper(file, whole):
        del file[name]

    return tamper


def a_float(change):
    """An 8-byte float with other bits than numpy's."""
    kind = h5py.h5t.IEEE_F64LE.copy()
    change(kind)
    return kind


def an_enumeration(base, **members):
    kind = h5py.h5t.enum_create(base)
    for name, value in members.items():
        kind.enum_insert(name.encode(), value)
    return kind


def seven_bits():
    kind = h5py.h5t.STD_U8LE.copy()
    kind.set_precision(7)
    return kind


GZIP = "those of the numbers"
FOREIGN_FILES = {
    "external link": (external_link, ["'image' is a link into another file", "where a data set in this file belongs"]),
    "soft link": (soft_link, ["'image' is a soft link to '/elsewhere'", "'elsewhere' is not part of the format"]),
    "soft link to itself": (soft_link_to_itself, ["'image' is a soft link to '/image'"]),
    "link to nowhere": (dangling_link, ["'symmetry_mask' is a soft link to '/nowhere'"]),
    "root in itself": (root_in_itself, ["'loop' is not part of the format"]),
    "root": (root_in_place_of_a_data_set, ["'image' is a group"]),
    "external storage": (external_storage, ["'image' is a data set in external storage"]),
    "virtual data set": (virtual, ["'image' is a virtual data set"]),
    "virtual data set without end": (virtual_without_end, ["'rotation' is a virtual data set"]),
    "extra data set": (extra_data_set, ["'thumbnail' is not part of the format"]),
    "too many names": (too_many_names, ["holds 106 names at its root"]),
    "group": (group_in_place_of_a_data_set, ["'rotation' is a group"]),
    "named type": (type_in_place_of_a_data_set, ["'rotation' is a named type"]),
    "more rows than memory": (more_rows_than_memory, ["'rotation'", "1000000000000", "1 to 500 rows"]),
    "more images than a shard has": (more_images_than_a_shard_has, ["'image'", "(501, 3, 3)", "1 to 500 rows"]),
    "group larger than memory": (group_larger_than_memory, ["'symmetry_group'", "beyond the format's limits"]),
    "no rows": (no_rows, ["'rotation'", "(0, 3, 3)"]),
    "float32 labels": (replaced("rotation", dtype="f4"), ["'rotation'", "<f8", "<f4"]),
    "float64 areas": (replaced("marking_pixels", dtype="f8"), ["'marking_pixels'", "<f4", "<f8"]),
    "big-endian labels": (replaced("rotation", dtype=">f8"), ["'rotation'", "<f8 in another order of bytes"]),
    "wide pixels": (replaced("image", dtype="u2"), ["'image'", "expected |u1", "found <u2 of shape"]),
    "signed pixels": (replaced("image", dtype="i1"), ["'image'", "expected |u1", "found |i1 of shape"]),
    "pixels of seven bits": (
        of_type("segmentation", seven_bits()),
        ["'segmentation'", "another order of bytes or bits"],
    ),
    "integer mask": (replaced("symmetry_mask", dtype="u1"), ["'symmetry_mask'", "|b1", "|u1"]),
    "float of other fields": (
        of_type("rotation", a_float(lambda kind: kind.set_fields(63, 51, 12, 0, 51))),
        ["'rotation'", "another order of bytes or bits"],
    ),
    "float of another bias": (
        of_type("rotation", a_float(lambda kind: kind.set_ebias(1000))),
        ["'rotation'", "another order of bytes or bits"],
    ),
    "vax float": (of_type("rotation", a_float(lambda kind: kind.set_order(h5py.h5t.ORDER_VAX))), ["'rotation'"]),
    "enumeration": (
        of_type("symmetry_mask", an_enumeration(h5py.h5t.STD_I8LE, NO=0, YES=1)),
        ["'symmetry_mask' is a data set of enumerations or booleans"],
    ),
    "enumeration the wrong way round": (
        of_type("symmetry_mask", an_enumeration(h5py.h5t.STD_I8LE, FALSE=1, TRUE=0)),
        ["'symmetry_mask' is a data set of enumerations or booleans"],
    ),
    "wide booleans": (
        of_type("symmetry_mask", an_enumeration(h5py.h5t.STD_I32LE, FALSE=0, TRUE=1), np.ones((COUNT, 4), "<i4")),
        ["'symmetry_mask' is a data set of enumerations or booleans"],
    ),
    "booleans where numbers belong": (
        replaced("segmentation", data=np.zeros((COUNT, HEIGHT, WIDTH), bool)),
        ["'segmentation'", "expected |u1", "found |b1"],
    ),
    "bit field": (of_type("image", h5py.h5t.STD_B8LE), ["'image' is a data set of bit fields"]),
    "opaque bytes": (replaced("segmentation", data=np.zeros((COUNT, 3), "V12")), ["'segmentation' is a data set of"]),
    "array type": (
        of_type("rotation", h5py.h5t.array_create(h5py.h5t.IEEE_F64LE, (2,)), np.zeros((COUNT, 3, 3, 2))),
        ["'rotation' is a data set of array types"],
    ),
    "strings": (
        plain("marking_pixels", data=["1"] * COUNT, dtype=h5py.string_dtype()),
        ["'marking_pixels' is a data set of strings"],
    ),
    "variable-length rows": (
        plain("marking_pixels", data=None, shape=(COUNT,), dtype=h5py.vlen_dtype("f4")),
        ["'marking_pixels' is a data set of variable-length rows"],
    ),
    "compound type": (
        replaced("marking_pixels", data=np.zeros(COUNT, dtype=[("px", "<f4")])),
        ["'marking_pixels' is a data set of compounds"],
    ),
    "complex numbers": (
        replaced("rotation", data=np.zeros((COUNT, 3, 3), "c16")),
        ["'rotation' is a data set of compounds"],
    ),
    "references": (
        plain("marking_pixels", data=None, shape=(COUNT,), dtype=h5py.ref_dtype),
        ["'marking_pixels' is a data set of references"],
    ),
    "time": (of_type("marking_pixels", h5py.h5t.UNIX_D64LE, np.zeros(COUNT)), ["'marking_pixels' is a data set of"]),
    "transposed images": (
        replaced("image", data=np.zeros((COUNT, WIDTH, HEIGHT, 3), "u1")),
        ["'image'", "(5, 16, 12, 3)"],
    ),
    "short mask": (replaced("symmetry_mask", data=np.ones((COUNT, 3), bool)), ["'symmetry_mask'", "(5, 3)"]),
    "long segmentation": (
        replaced("segmentation", data=np.zeros((COUNT + 1, HEIGHT, WIDTH), "u1")),
        ["'segmentation'", "(6, 12, 16)"],
    ),
    "scalar": (plain("marking_pixels", data=np.float32(1)), ["'marking_pixels'", "()"]),
    "empty": (plain("marking_pixels", data=h5py.Empty("f4")), ["'marking_pixels' is a data set without values"]),
    "contiguous": (plain("rotation"), ["'rotation'", "expected the filters gzip and fletcher32"]),
    "compact": (compact, ["'marking_pixels'", "expected the filters gzip and fletcher32"]),
    "no filter": (plain("rotation", chunks=(COUNT, 3, 3)), ["'rotation'", GZIP]),
    "gzip alone": (replaced("image", fletcher32=False), ["'image'", f"{GZIP} (1,)"]),
    "fletcher32 alone": (replaced("image", compression=None), ["'image'", f"{GZIP} (3,)"]),
    "shuffle": (replaced("image", shuffle=True), ["'image'", f"{GZIP} (2, 1, 3)"]),
    "lzf": (replaced("image", compression="lzf"), ["'image'", "filters gzip and fletcher32"]),
    "scaleoffset": (plain("image", scaleoffset=0, chunks=(1, HEIGHT, WIDTH, 3)), ["'image'", GZIP]),
    "several images per chunk": (
        replaced("image", chunks=(2, HEIGHT, WIDTH, 3)),
        ["'image': expected one row per chunk, found (2, 12, 16, 3)"],
    ),
    "half an image per chunk": (
        replaced("segmentation", chunks=(1, 6, WIDTH)),
        ["'segmentation': expected one row per chunk, found (1, 6, 16)"],
    ),
    "one label per chunk": (
        replaced("rotation", chunks=(1, 3, 3)),
        ["'rotation': expected all rows in one chunk, found (1, 3, 3)"],
    ),
    "chunk longer than its data set": (
        replaced("rotation", chunks=(COUNT + 1, 3, 3), maxshape=(None, 3, 3)),
        ["'rotation': expected all rows in one chunk, found (6, 3, 3)"],
    ),
    "chunk larger than memory": (chunk_larger_than_memory, ["'rotation': expected all rows in one chunk"]),
    "a chunk for each truth value": (a_chunk_for_each_truth_value, ["'symmetry_mask': expected all rows in one chunk"]),
    **{f"no {name}": (without(name), [f"{name!r} is missing"]) for name in LAYOUT if name != "symmetry_mask"},
}


@pytest.mark.parametrize("case", FOREIGN_FILES)
def test_foreign_file_is_refused_by_the_name_of_its_fault(shard, tmp_path, case):
    tamper, words = FOREIGN_FILES[case]
    whole = Path(shutil.copy(shard, tmp_path / "whole.h5"))  # so that what a link leads to is as expected
    with h5py.File(shard, "r+") as file:
        tamper(file, whole)
    message = refusal(shard)
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("name", LAYOUT)
def test_tampering_itself_is_not_what_is_refused(shard, name):
    expected = read_all(shard)
    with h5py.File(shard, "r+") as file:
        replaced(name)(file, None)
    found = read_all(shard)
    assert set(found) == set(expected)
    for each, values in found.items():
        np.testing.assert_array_equal(values, expected[each])


@pytest.mark.parametrize("name", [*HEADER.to_attributes(), *NOTES])
def test_missing_attribute_is_refused(shard, name):
    with h5py.File(shard, "r+") as file:
        del file.attrs[name]
    assert f"'{name}'" in refusal(shard)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format", "another format"),
        ("format", ["symsol-annot shard", "symsol-annot shard"]),
        ("format", 1),
        ("format_version", 0),
        ("format_version", [1, 2]),
        ("format_version", "1"),
        ("format_version", 1.0),
        ("format_version", True),
        ("object", 3),
        ("object", h5py.Empty("S1")),
        ("object", np.void(b"tetX")),
        ("split", [1.0, 2.0]),
        ("first_index", "first"),
        ("first_index", [0, 1]),
        ("first_index", np.bool_(True)),
        ("first_index", 32.0),
        ("seed", [0, 1]),
        ("seed", np.zeros((), dtype=[("seed", "i8")])),
        ("tolerance_px", "five"),
        ("tolerance_px", 5),
        ("tolerance_px", 1j),
        ("candidates_drawn", "many"),
        ("versions", np.array("{}", dtype=h5py.string_dtype()).reshape(1)),
    ],
)
def test_attribute_of_a_wrong_value_or_type_is_refused(shard, name, value):
    with h5py.File(shard, "r+") as file:
        file.attrs[name] = value
    assert f"'{name}'" in refusal(shard)


@pytest.mark.parametrize("name", ["note", "source", "FORMAT", "\x1b[2J", "x" * 5000])
def test_attribute_that_the_format_does_not_list_is_refused(shard, name):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs[name] = "mine"
    message = refusal(shard)
    assert "is not part of" in message
    assert "\x1b" not in message
    assert len(message) < 2000


@pytest.mark.parametrize(
    "camera",
    [
        "",
        "four",
        "[]",
        "3",
        "{}",
        '{"width": 16}',
        '{"width": 16, "height": null}',
        '{"width": 16, "height": Infinity}',
        '{"width": 16, "height": true}',
        '{"width": 16, "height": 12.0}',
        '{"width": 16, "height": 1e999}',
        '{"width": 4000, "height": 4000}',
        '{"width": 16, "height": -12}',
        "[" * 60_000,
        "9" * 60_000,
        7,
        ["{}", "{}"],
    ],
)
def test_camera_that_is_no_json_with_a_size_is_refused(shard, camera):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs["camera"] = camera
    message = refusal(shard)
    assert "'camera'" in message
    assert len(message) < 500


@pytest.mark.parametrize("versions", ["", "[]", "null", '{"hdf5": 1}', '{"hdf5": {"a": "b"}}', "[" * 60_000])
def test_versions_that_are_no_json_of_texts_are_an_error(shard, versions):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs["versions"] = versions
    with open_shard(shard) as opened, pytest.raises(DataError, match="'versions' is no JSON object of texts"):
        _ = opened.versions


def test_newer_format_is_refused_with_both_versions(shard):
    with h5py.File(shard, "r+") as file:
        file.attrs["format_version"] = 2
    with pytest.raises(DataError, match=r"of format version 2, newer than 1, .* update it"), open_shard(shard):
        pass


def test_all_faults_are_listed_not_the_first(shard):
    with h5py.File(shard, "r+") as file:
        for name in ("seed", "engine"):
            del file.attrs[name]
        extra_data_set(file, None)
        soft_link(file, None)
    message = refusal(shard)
    assert [word for word in ("seed", "engine", "thumbnail", "'image'", "elsewhere") if word not in message] == []


def test_all_faults_of_storage_are_listed_not_the_first(shard):
    with h5py.File(shard, "r+") as file:
        for name in ("rotation", "marking_pixels"):
            plain(name)(file, None)
        replaced("image", shuffle=True)(file, None)
    message = refusal(shard)
    assert [
        name for name in ("rotation", "marking_pixels", "image") if f"{name!r}: expected the filters" not in message
    ] == []


# Time and memory


def peak_bytes(pid):
    """Return the most memory that a process has held since `reset_peak`."""
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next(int(line.split()[1]) * 1024 for line in lines if line.startswith("VmHWM"))


def reset_peak(pid):
    Path(f"/proc/{pid}/clear_refs").write_text("5")


def huge_attribute(file):
    file.attrs["note"] = "x" * 2**26


def huge_attribute_in_place_of_a_number(file):
    file.attrs["seed"] = "x" * 2**26


def many_references_to_one_text(file):
    file.attrs.create("format", np.array(["x" * 2**16] * 1000, dtype=object), dtype=h5py.string_dtype())


def huge_data_set(file):
    file["note"] = np.zeros(2**23)


def huge_labels(file):
    put(file, "rotation", np.zeros((2**20, 3, 3)), chunks=(2**20, 3, 3))


@pytest.mark.skipif(not Path("/proc/self/clear_refs").exists(), reason="the peak of memory is told by Linux")
@pytest.mark.parametrize(
    "put_in",
    [
        huge_attribute,
        huge_attribute_in_place_of_a_number,
        many_references_to_one_text,
        huge_data_set,
        huge_labels,
    ],
    ids=lambda function: function.__name__,
)
def test_what_the_format_does_not_have_is_refused_unread(shard, tmp_path, put_in):
    read_all(shard)  # so that the process is there
    pid, odd = shards._DESCRIBER._process.pid, tmp_path / "odd.h5"
    with h5py.File(shard) as file, h5py.File(odd, "w", libver="latest") as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...])
        put_in(other)
    reset_peak(pid)
    before = peak_bytes(pid)
    refusal(odd)
    assert shards._DESCRIBER._process.pid == pid
    assert peak_bytes(pid) < before + 2**23


def test_attribute_that_hdf5_cannot_hold_in_the_memory_allowed_is_refused(shard, tmp_path, monkeypatch):
    """HDF5 reads the values of an array with what it says of them."""
    with h5py.File(shard) as file, h5py.File(tmp_path / "odd.h5", "w", libver="latest") as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...])
        other.attrs["tolerance_px"] = np.zeros(2**25)
    monkeypatch.setattr(shards, "_LIMITS", replace(shards._LIMITS, memory_bytes=2**29))
    with closing(shards._Describer()) as describer:
        monkeypatch.setattr(shards, "_DESCRIBER", describer)
        expected = read_all(shard)  # the limit suffices for a shard
        assert re.search("memory|allocat|damaged", refusal(tmp_path / "odd.h5"))
        assert set(read_all(shard)) == set(expected)


def test_text_of_an_attribute_has_a_limit(shard):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs["versions"] = "x" * 2**24
    assert "attribute 'versions' is 16777216 characters, where a string belongs" in refusal(shard)


@pytest.mark.parametrize("name", LAYOUT)
def test_stream_that_is_longer_than_its_chunk_is_not_inflated(shard, name):
    bomb = zlib.compress(bytes(2**28))
    with h5py.File(shard, "r+") as file:
        file[name].id.write_direct_chunk((0,) * file[name].ndim, bomb + bytes(4))
    tracemalloc.start()
    try:
        with pytest.raises(DataError, match=r"found more|chunk lies outside the file, or is too large"):
            read_all(shard)
        assert tracemalloc.get_traced_memory()[1] < 2**23
    finally:
        tracemalloc.stop()


def test_deep_or_long_names_cost_little(shard):
    with h5py.File(shard, "r+", libver="latest") as file:
        for number in range(40):
            file["x" * 50_000 + str(number)] = np.zeros(1)
    assert len(refusal(shard)) < 40 * 200


# The index of chunks


def chunk_missing(index, path):
    index.change_count(-1)


def chunk_twice(index, path):
    index.change_offset(2, 0, 1)


def chunk_that_begins_inside_a_row(index, path):
    index.change_offset(2, 1, 4)


def chunk_of_a_row_that_is_not_there(index, path):
    index.change_offset(COUNT - 1, 0, 2**40)


def chunk_outside(index, path):
    index.change_address(3, path.stat().st_size - 10)


def chunk_far_outside(index, path):
    index.change_address(3, 2**62)


def chunk_without_an_address(index, path):
    index.change_address(3, 2**64 - 1)


def chunk_too_large(index, path):
    index.change_size(3, 2**31)


def chunk_a_little_too_large(index, path):
    index.change_size(3, 3 * HEIGHT * WIDTH + 400)


def chunk_without_bytes(index, path):
    index.change_size(3, 0)


def chunk_that_is_its_checksum(index, path):
    index.change_size(3, 4)


def chunk_without_gzip(index, path):
    index.change_mask(3, 1)


def chunk_without_fletcher32(index, path):
    index.change_mask(3, 2)


def chunk_with_odd_filters(index, path):
    index.change_mask(3, 2**32 - 1)


DAMAGES = [
    chunk_missing,
    chunk_twice,
    chunk_that_begins_inside_a_row,
    chunk_of_a_row_that_is_not_there,
    chunk_outside,
    chunk_far_outside,
    chunk_without_an_address,
    chunk_too_large,
    chunk_a_little_too_large,
    chunk_without_bytes,
    chunk_that_is_its_checksum,
    chunk_without_gzip,
    chunk_without_fletcher32,
    chunk_with_odd_filters,
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda function: function.__name__)
def test_damaged_index_of_chunks_is_refused(shard, damage):
    """HDF5 itself gives zeros for a chunk that it does not find."""
    damage(ChunkIndex(shard, "image"), shard)
    assert "'image'" in refusal(shard)


@pytest.mark.parametrize("name", ["rotation", "symmetry_mask", "symmetry_group", "marking_pixels"])
@pytest.mark.parametrize("damage", [lambda index: index.change_offset(0, 0, 5), lambda index: index.change_count(-1)])
def test_labels_whose_chunk_is_not_found_are_refused(shard, name, damage):
    damage(ChunkIndex(shard, name))
    assert f"{name!r}" in refusal(shard)


def test_flipped_bit_in_the_index_of_chunks_gives_the_right_values_or_an_error(shard):
    expected, data = read_all(shard), shard.read_bytes()
    rng, found = random.Random(0), {"right": 0, "error": 0}
    for name in ("image", "rotation"):
        bits = ChunkIndex(shard, name).bits(COUNT if name == "image" else 1)
        for bit in rng.sample(bits, 250):
            changed = bytearray(data)
            changed[bit // 8] ^= 1 << bit % 8
            shard.write_bytes(changed)
            try:
                for each, values in read_all(shard).items():
                    np.testing.assert_array_equal(values, expected[each])
                found["right"] += 1
            except DataError:
                found["error"] += 1
    assert min(found.values()) > 25


def test_chunks_may_lie_in_any_order(shard):
    expected = read_all(shard)
    with h5py.File(shard, "r+") as file:
        images = file["image"][...]
        put(file, "image", None, shape=images.shape, dtype="u1")
        for row in (3, 0, 4, 2, 1):
            file["image"][row] = images[row]
    np.testing.assert_array_equal(read_all(shard)["image"], expected["image"])


@pytest.mark.parametrize("userblock", [512, 4096])
def test_shard_behind_a_user_block_is_read_right_or_refused(shard, tmp_path, userblock):
    """Where chunks lie is told from the file's beginning or from behind the block, by HDF5's version."""
    with h5py.File(shard) as file, h5py.File(tmp_path / "a.h5", "w", userblock_size=userblock) as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...])
    try:
        found = read_all(tmp_path / "a.h5")
    except DataError:
        return
    for name, values in read_all(shard).items():
        np.testing.assert_array_equal(found[name], values)


# What is no shard


@pytest.mark.parametrize(
    "data", [b"", b"P", b"\x89HDF\r\n\x1a\n", b"split,index\n" * 500, b"\x89HDF\r\n\x1a\n" + bytes(4000)]
)
def test_file_that_is_no_hdf5_is_refused(tmp_path, data):
    path = tmp_path / "test-00000-of-00001.h5"
    path.write_bytes(data)
    assert "cannot be read as HDF5" in refusal(path)


def test_folder_missing_file_and_what_is_no_regular_file_are_refused(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "fifo")
    expected = {
        tmp_path: "is a folder, where a file belongs",
        tmp_path / "absent.h5": "no such shard",
        tmp_path / "fifo": "is no regular file",
        tmp_path / "zero": "is no regular file",
        tmp_path / "loop": "Too many levels of symbolic links",
        tmp_path / ("x" * 300): "File name too long",
    }
    assert {path: words for path, words in expected.items() if words not in refusal(path)} == {}


@pytest.mark.parametrize("kept", [0.01, 0.3, 0.5, 0.9, 0.9999])
def test_truncated_shard_is_refused(shard, kept):
    data = shard.read_bytes()
    shard.write_bytes(data[: int(kept * len(data))])
    assert "cannot be read as HDF5" in refusal(shard)


def test_shard_with_a_flipped_bit_opens_or_is_refused_and_nothing_else(shard):
    data = shard.read_bytes()
    rng = random.Random(0)
    raised = {}
    with shard.open("r+b", buffering=0) as file:
        for bit in rng.sample(range(8 * len(data)), 1000):
            byte = bit // 8
            file.seek(byte)
            file.write(bytes([data[byte] ^ 1 << bit % 8]))
            try:
                with open_shard(shard):
                    pass
            except DataError:
                pass
            except Exception as error:  # noqa: BLE001 - which ones there are is what the test is about
                raised.setdefault(type(error).__name__, []).append(bit)
            file.seek(byte)
            file.write(data[byte : byte + 1])
    assert raised == {}
    assert shard.read_bytes() == data


def test_shard_is_closed_after_use_and_after_refusal(shard):
    with open_shard(shard) as opened:
        assert descriptors(shard) == [str(shard)]
    assert descriptors(shard) == []
    with pytest.raises(DataError, match="rotation cannot be read"):
        opened.read("rotation")
    with h5py.File(shard, "r+") as file:
        extra_data_set(file, None)
    with pytest.raises(DataError) as refused, open_shard(shard):
        pass
    assert descriptors(shard) == [], refused.value  # while its traceback keeps what was not closed


# Size and SHA-256


def test_shard_of_the_right_bytes_opens(shard):
    data = shard.read_bytes()
    assert len(opened_shard(shard, hashlib.sha256(data).hexdigest(), len(data))) == COUNT


@pytest.mark.parametrize(
    "change", [lambda data: data + b"\0", lambda data: data[:-1], lambda data: b"", lambda data: b"x"]
)
def test_shard_of_another_size_is_refused_with_both(shard, change):
    data = shard.read_bytes()
    shard.write_bytes(change(data))
    with pytest.raises(
        DataError, match=rf"is damaged: expected {len(data)} bytes, found {len(change(data))}.*--repair"
    ):
        opened_shard(shard, hashlib.sha256(data).hexdigest(), len(data))


def test_any_flipped_bit_is_found_by_the_digest_and_hdf5_never_sees_it(shard, monkeypatch):
    data = shard.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    monkeypatch.setattr(shards._DESCRIBER, "describe", lambda path: pytest.fail(f"HDF5 was given {path}"))
    for bit in random.Random(0).sample(range(8 * len(data)), 200):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        shard.write_bytes(changed)
        with pytest.raises(DataError, match=f"is damaged: expected SHA-256 {sha256}, found .*symsol-annot verify"):
            opened_shard(shard, sha256, len(data))


def test_shard_that_is_replaced_while_it_is_opened_is_an_error(shard, tmp_path, monkeypatch):
    """Else the places of one file's chunks would be read in another."""
    other = tmp_path / "other.h5"
    other.write_bytes(build(header(seed=8)).data)
    describe = shards._DESCRIBER.describe

    def replace_and_describe(path):
        other.replace(path)
        return describe(path)

    monkeypatch.setattr(shards._DESCRIBER, "describe", replace_and_describe)
    with pytest.raises(DataError, match="was replaced while it was opened; try again"):
        opened_shard(shard)


def test_shard_that_is_a_link_is_read_from_where_it_leads(shard, tmp_path):
    expected = read_all(shard)
    (tmp_path / "store").mkdir()
    links_instead(shard, tmp_path / "store")
    for name, values in read_all(shard).items():
        np.testing.assert_array_equal(values, expected[name])
