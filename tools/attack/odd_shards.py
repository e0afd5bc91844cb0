"""Shards written anew with h5py, with what no shard of ours has: links, storage, filters, types, shapes, attributes."""

import contextlib
import os
import zlib

import h5py
import numpy as np

from attack.damage import ODD_VALUES
from attack.odd_values import VALUES, taken
from attack.signing import sign_group

_COMPRESSED = {"compression": "gzip", "fletcher32": True, "track_times": False}
_OLD = ("earliest", "v108")
WRITE_ERRORS = (OSError, ValueError, TypeError, KeyError, RuntimeError, OverflowError)  # what h5py will not write


def rewrite(path, place, rng):
    """Write a shard anew with one or two oddities; return which."""
    version = (_OLD, _OLD, ("earliest", "latest"), ("latest", "latest"))[rng.integers(4)]
    userblock = int(rng.choice([0, 0, 0, 0, 512]))
    changes = [CHANGES[rng.integers(len(CHANGES))] for _ in range(rng.choice([1, 1, 2]))]
    whole, beside = path.with_suffix(".whole"), path.with_suffix(".odd")
    path.rename(whole)
    try:
        with (
            h5py.File(whole, "r") as source,
            h5py.File(beside, "w", libver=version, userblock_size=userblock) as file,
        ):
            file.attrs.update(source.attrs)
            for name in source:
                source.copy(name, file)
            done = [f"{version[0]}, user block {userblock}"]
            for change in changes:
                with contextlib.suppress(*WRITE_ERRORS):  # what cannot be written is left
                    change(file, place, rng)
                    done.append(change.__name__)
            with contextlib.suppress(*WRITE_ERRORS):
                sign_group(file)
        beside.rename(path)
    finally:
        whole.unlink()
    return done


def _any(file, rng):
    names = [name for name in file if isinstance(file.get(name, getlink=True), h5py.HardLink)]
    names = [name for name in names if isinstance(file[name], h5py.Dataset) and file[name].size]
    return names[rng.integers(len(names))]


def _labels(file, rng):
    labels = ("rotation", "symmetry_group", "symmetry_mask", "marking_pixels", "part_pixels")
    names = [name for name in labels if name in file]
    return names[rng.integers(len(names))]


# Storage


def other_storage(file, place, rng):
    name = _any(file, rng)
    values = taken(file, name)
    ways = (
        {},
        {"chunks": True},
        {"chunks": values.shape},
        {"chunks": tuple(max(1, side // 2) for side in values.shape)},
        {"chunks": (1,) * values.ndim} if values.size < 5000 else {"chunks": True, "shuffle": True},
        {"chunks": True, "compression": "lzf"},
        {"chunks": True, "maxshape": (None,) * values.ndim, "compression": "gzip"},
        {"chunks": True, "scaleoffset": 2},
        {"chunks": True, "fletcher32": True, "shuffle": True, "compression": 9},
    )
    way = ways[rng.integers(len(ways))]
    file.create_dataset(name, data=values, **way)


def compact_storage(file, place, rng):
    name = _labels(file, rng)
    values = taken(file, name)
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_layout(h5py.h5d.COMPACT)
    space, kind = h5py.h5s.create_simple(values.shape), h5py.h5t.py_create(values.dtype)
    h5py.h5d.create(file.id, name.encode(), kind, space, plist).write(h5py.h5s.ALL, h5py.h5s.ALL, values)


def chunk_with_other_filters(file, place, rng):
    """A chunk says that some of its filters were not applied."""
    name = _any(file, rng)
    values = taken(file, name)
    rows = file.create_dataset(name, values.shape, values.dtype, chunks=values.shape, **_COMPRESSED)
    data = np.ascontiguousarray(values).tobytes()
    mask = int(rng.choice([1, 2, 3, 7, 2**32 - 1]))
    rows.id.write_direct_chunk((0,) * values.ndim, zlib.compress(data) if rng.random() < 0.5 else data, mask)


def chunk_of_another_size(file, place, rng):
    """A chunk inflates to fewer bytes than it should, or to a thousand times as many."""
    name = _any(file, rng)
    values = taken(file, name)
    rows = file.create_dataset(name, values.shape, values.dtype, chunks=values.shape, compression="gzip")
    data = np.ascontiguousarray(values).tobytes()
    data = data[: len(data) // 2] if rng.random() < 0.5 else data + bytes(min(1000 * len(data), 2**26))
    rows.id.write_direct_chunk((0,) * values.ndim, zlib.compress(data))


def missing_chunk(file, place, rng):
    name = _any(file, rng)
    values = taken(file, name)
    file.create_dataset(name, values.shape, values.dtype, chunks=(1, *values.shape[1:]), **_COMPRESSED)
    for row in np.flatnonzero(rng.random(len(values)) < 0.5):
        file[name][row] = values[row]


def filter_without_a_name(file, place, rng):
    name = _any(file, rng)
    values = taken(file, name)
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk(values.shape)
    plist.set_filter(int(rng.choice([4, 5, 6, 305, 32000, 32015])), h5py.h5z.FLAG_OPTIONAL, (1, 2, 3))
    space, kind = h5py.h5s.create_simple(values.shape), h5py.h5t.py_create(values.dtype)
    rows = h5py.h5d.create(file.id, name.encode(), kind, space, plist)
    h5py.Dataset(rows).id.write_direct_chunk((0,) * values.ndim, np.ascontiguousarray(values).tobytes())


# Other files, and other places in this one


def link_elsewhere(file, place, rng):
    name = _any(file, rng)
    del file[name]
    canary = str(place.outside / "canary.h5")
    links = (h5py.ExternalLink(canary, name), h5py.ExternalLink("../../../outside/canary.h5", "/"), h5py.SoftLink("/"))
    more = (h5py.SoftLink(f"/{name}"), h5py.SoftLink("/rotation"), file["/"])
    every = (*links, *more)
    file[name] = every[rng.integers(len(every))]


def one_for_another(file, place, rng):
    a, b = _any(file, rng), _any(file, rng)
    if a != b:
        rows = file[b]
        del file[a]
        file[a] = rows


def stored_elsewhere(file, place, rng):
    name = _any(file, rng)
    values = taken(file, name)
    canary = str(place.outside / "canary.h5")
    file.create_dataset(name, values.shape, values.dtype, external=[(canary, 0, h5py.h5f.UNLIMITED)])


def virtual(file, place, rng):
    """A virtual data set; the shape of one without end is asked for in the other file."""
    name = _any(file, rng)
    values = taken(file, name)
    other = str(place.outside / "canary.h5")
    if rng.random() < 0.3:
        other = place.case / "fifo"
        if not other.exists():
            os.mkfifo(other)
    ends = (None, *values.shape[1:])
    layout = h5py.VirtualLayout(values.shape, values.dtype, maxshape=ends)
    source = h5py.VirtualSource(str(other), name, values.shape, values.dtype, maxshape=ends)
    rows = slice(0, h5py.h5s.UNLIMITED if rng.random() < 0.5 else values.shape[0])
    layout[rows] = source[rows]
    file.create_virtual_dataset(name, layout)


def cyclic_groups(file, place, rng):
    group = file.create_group(str(rng.choice(["other", "extra"])))
    group["up"], group["self"] = file["/"], group


# Types and shapes


def other_type(file, place, rng):
    name = _any(file, rng)
    kinds = ("<f4", ">f8", "<f2", "g", "i1", ">i4", "u8", "S8", "c16", "V4")
    values = taken(file, name)
    with np.errstate(all="ignore"):
        file.create_dataset(name, data=values.astype(kinds[rng.integers(len(kinds))]))


def strange_type(file, place, rng):
    name = _any(file, rng)
    shape, dtype = file[name].shape, file[name].dtype
    del file[name]
    kinds = (
        h5py.vlen_dtype(dtype),
        h5py.ref_dtype,
        h5py.regionref_dtype,
        h5py.string_dtype(),
        np.dtype([("a", dtype), ("b", "i4")]),
        np.dtype((dtype, (2,))),
        h5py.enum_dtype({"RED": 0, "GREEN": 1}, basetype="i1"),
        h5py.opaque_dtype(np.dtype("M8[s]")),
    )
    file.create_dataset(name, shape, kinds[rng.integers(len(kinds))])


def committed_type(file, place, rng):
    name = _any(file, rng)
    values = taken(file, name)
    file["kind"] = values.dtype
    file.create_dataset(name, data=values, dtype=file["kind"])


def no_data_set(file, place, rng):
    name = _any(file, rng)
    dtype = file[name].dtype
    del file[name]
    kind = rng.integers(4)
    if kind == 0:
        file.create_group(name)["rotation"] = 1.0
    elif kind == 1:
        file[name] = h5py.Empty(dtype)
    elif kind == 2:
        file[name] = dtype.type(1)
    else:
        file[name] = dtype


def other_shape(file, place, rng):
    name = _any(file, rng)
    values = taken(file, name)
    shapes = (values[:-1], values[:0], values[None], values.reshape(-1), values.T, np.concatenate([values, values]))
    file.create_dataset(name, data=shapes[rng.integers(len(shapes))], chunks=True, **_COMPRESSED)


def huge_shape(file, place, rng):
    """Rows for all memory there is, of which none is in the file."""
    name = _any(file, rng)
    values = taken(file, name)
    count = int(rng.choice([7000, 2**20, 2**31, 2**40]))
    chunk = (int(rng.choice([1, 64, 2**20])), *values.shape[1:])
    file.create_dataset(name, (count, *values.shape[1:]), values.dtype, chunks=chunk, **_COMPRESSED)


def huge_everywhere(file, place, rng):
    """All data sets of one row per image agree on a count that nobody can read."""
    count = int(rng.choice([7000, 2**20, 2**31]))
    for name in list(file):
        if name != "symmetry_group" and isinstance(file[name], h5py.Dataset):
            values = taken(file, name)
            file.create_dataset(name, (count, *values.shape[1:]), values.dtype, chunks=(1, *values.shape[1:]))


# Other data sets


def without_a_data_set(file, place, rng):
    del file[_any(file, rng)]


def another_data_set(file, place, rng):
    names = ("other", "image2", "\u202ex", "\x1b[31mred", "a" * 300, "symmetry_mask ")
    file[names[rng.integers(len(names))]] = np.arange(3)


# Attributes


def odd_attribute(file, place, rng):
    names = list(file.attrs)
    value = ODD_VALUES[rng.integers(len(ODD_VALUES))]
    file.attrs[names[rng.integers(len(names))]] = h5py.Empty("f8") if value is None else value


def strange_attribute(file, place, rng):
    names = [*file.attrs, "other"]
    values = (
        np.arange(3),
        np.zeros(0),
        h5py.Empty("S1"),
        np.void(b"opaque"),
        np.complex128(1j),
        b"\xff\xfe\x00",
        np.array(["a", "b"], dtype=h5py.string_dtype()),
        np.longdouble(1) / 3,
        np.float16(3.0),
        np.zeros(2**13),
    )
    name = names[rng.integers(len(names))]
    if name in file.attrs:
        del file.attrs[name]
    file.attrs[name] = values[rng.integers(len(values))]


def reference_attribute(file, place, rng):
    names = list(file.attrs)
    file.attrs[names[rng.integers(len(names))]] = file["rotation"].ref


def missing_attribute(file, place, rng):
    names = list(file.attrs)
    del file.attrs[names[rng.integers(len(names))]]


def thousand_attributes(file, place, rng):
    holder = file if rng.random() < 0.5 else file[_any(file, rng)]
    for number in range(1000):
        holder.attrs[f"a{number}"] = number


def long_attribute(file, place, rng):
    """A text of tens of MB."""
    file.attrs["versions"] = '{"a": "' + "x" * int(rng.choice([10_000, 2**25])) + '"}'


def odd_camera(file, place, rng):
    texts = (
        '{"width": 1e400, "height": 16}',
        '{"width": true, "height": 16}',
        '{"width": 16}',
        "[" * 3000,
        '{"width": -1, "height": -1}',
        '{"width": 1' + "0" * 5000 + "}",
        "null",
        "\x1b[2J",
        '{"width": 16, "height": 16, "distance": NaN, "focal_px": Infinity}',
    )
    file.attrs["camera"] = texts[rng.integers(len(texts))]


CHANGES = (
    other_storage,
    other_storage,
    compact_storage,
    chunk_with_other_filters,
    chunk_of_another_size,
    missing_chunk,
    filter_without_a_name,
    link_elsewhere,
    link_elsewhere,
    one_for_another,
    stored_elsewhere,
    virtual,
    cyclic_groups,
    other_type,
    strange_type,
    committed_type,
    no_data_set,
    other_shape,
    huge_shape,
    huge_everywhere,
    *VALUES,
    without_a_data_set,
    another_data_set,
    odd_attribute,
    odd_attribute,
    strange_attribute,
    reference_attribute,
    missing_attribute,
    thousand_attributes,
    long_attribute,
    odd_camera,
)
