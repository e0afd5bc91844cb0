"""Files that are no shards by one fault each: how each is made, and the words of its refusal."""

import hashlib
import os

import h5py
import numpy as np
from made_shards import COUNT, GROUP, HEIGHT, LAYOUT, PICTURES, WIDTH
from tampering import put

from symsol_annot.sets.shard.chunks import stored


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
        chunks = values_there.shape if name not in PICTURES else (1, *values_there.shape[1:])
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
    for name in list(file):
        shape, dtype = file[name].shape, file[name].dtype
        del file[name]
        file.create_dataset(name, (0, *shape[1:]), dtype)


def more_rows_than_memory(file, whole):
    for name in list(file):
        rest = file[name].shape[1:]
        put(file, name, None, shape=(10**12, *rest), dtype=file[name].dtype, chunks=(1, *rest))


def more_images_than_a_shard_has(file, whole):
    for name in list(file):
        rest = file[name].shape[1:]
        rows = 1 if name in PICTURES else 501
        put(file, name, None, shape=(501, *rest), dtype=file[name].dtype, chunks=(rows, *rest))


def group_in_a_data_set(file, whole):
    """As version 1 of the format has it."""
    put(file, "symmetry_group", GROUP)


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
    "too many names": (too_many_names, ["holds 107 names at its root"]),
    "group": (group_in_place_of_a_data_set, ["'rotation' is a group"]),
    "named type": (type_in_place_of_a_data_set, ["'rotation' is a named type"]),
    "more rows than memory": (more_rows_than_memory, ["'rotation'", "1000000000000", "1 to 500 rows"]),
    "more images than a shard has": (more_images_than_a_shard_has, ["'image'", "(501, 3, 3)", "1 to 500 rows"]),
    "group in a data set": (group_in_a_data_set, ["'symmetry_group' is not part of the format, version 2"]),
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
    "another count of parts": (replaced("part_pixels", data=np.ones((COUNT, 3), "f4")), ["'part_pixels'", "(5, 3)"]),
    "float64 depth": (replaced("depth", dtype="f8"), ["'depth'", "expected <f4"]),
    "all depths in a chunk": (
        replaced("depth", chunks=(COUNT, HEIGHT, WIDTH)),
        ["'depth': expected one row per chunk, found (5, 12, 16)"],
    ),
    **{
        f"no {name}": (without(name), [f"{name!r} is missing"])
        for name in LAYOUT
        if name not in ("symmetry_mask", "depth")
    },
}


def group_as(values, **options):
    """A tampering: the group's attribute of other values, type or shape."""

    def tamper(file, whole):
        del file.attrs["symmetry_group"]
        file.attrs.create("symmetry_group", values, **options)
        file.attrs["symmetry_group_sha256"] = hashlib.sha256(np.asarray(values).tobytes()).hexdigest()

    return tamper


def group_of_type(kind, shape=GROUP.shape):
    """A tampering: the group's attribute of a type that h5py has no word for."""

    def tamper(file, whole):
        del file.attrs["symmetry_group"]
        h5py.h5a.create(file.id, b"symmetry_group", kind, h5py.h5s.create_simple(shape)).write(GROUP, mtype=kind)

    return tamper


def flipped_bit_of_the_group(file, whole):
    group = GROUP.copy()
    group[-1, -1, -1] = np.nextafter(1.0, 2.0)
    file.attrs["symmetry_group"] = group


def group_of_references(file, whole):
    del file.attrs["symmetry_group"]
    file.attrs.create("symmetry_group", np.array([file.ref] * 3, dtype=h5py.ref_dtype), dtype=h5py.ref_dtype)


_OTHER_BYTES = "an array in another order of bytes or bits, where an array belongs"
FOREIGN_GROUPS = {
    "float32": (group_as(GROUP.astype("f4")), "expected <f8 of shape (G, 3, 3), found <f4 of shape (4, 3, 3)"),
    "whole numbers": (group_as(GROUP.astype("i8")), "expected <f8 of shape (G, 3, 3), found <i8 of shape (4, 3, 3)"),
    "half precision": (group_as(GROUP.astype("f2")), "found <f2"),
    "big-endian": (group_as(GROUP.astype(">f8")), _OTHER_BYTES),
    "float of other fields": (
        group_of_type(a_float(lambda kind: kind.set_fields(63, 51, 12, 0, 51))),
        _OTHER_BYTES,
    ),
    "float of another bias": (group_of_type(a_float(lambda kind: kind.set_ebias(1000))), _OTHER_BYTES),
    "one rotation": (group_as(GROUP[0]), "found <f8 of shape (3, 3)"),
    "rows of nine": (group_as(GROUP.reshape(-1, 9)), "found <f8 of shape (4, 9)"),
    "two columns": (group_as(GROUP[:, :, :2]), "found <f8 of shape (4, 3, 2)"),
    "another axis": (group_as(GROUP[None]), "found <f8 of shape (1, 4, 3, 3)"),
    "five axes": (group_as(GROUP[None, None]), "an array of shape (1, 1, 4, 3, 3)"),
    "a number": (group_as(1.0), "a number, where an array belongs"),
    "a text": (group_as("identity"), "a string, where an array belongs"),
    "texts": (group_as(["a", "b"], dtype=h5py.string_dtype()), "an array of strings"),
    "booleans": (group_as(GROUP > 0), "an array of enumerations or booleans"),
    "complex numbers": (group_as(GROUP.astype("c16")), "an array of compounds"),
    "references": (group_of_references, "an array of references"),
    "opaque bytes": (group_as(np.zeros(3, "V8")), "an array of opaque bytes"),
    "array type": (
        group_of_type(h5py.h5t.array_create(h5py.h5t.IEEE_F64LE, (3, 3)), shape=(4,)),
        "an array of array types",
    ),
    "nothing": (group_as(h5py.Empty("f8")), "empty, where an array belongs"),
    "no rotation": (group_as(np.zeros((0, 3, 3))), "an array of shape (0, 3, 3)"),
    "more than can be": (group_as(np.zeros((7201, 3, 3))), "expected 1 to 7200 symmetries, found 7201"),
    "more than is read": (group_as(np.zeros((2**16, 3, 3))), "an array of shape (65536, 3, 3), of which 524288 bytes"),
    "a flipped bit": (flipped_bit_of_the_group, "is damaged: it does not have the digest in 'symmetry_group_sha256'"),
    "another count than the masks'": (group_as(GROUP[:3]), "'symmetry_mask': expected |b1 of shape (5, 3)"),
}
