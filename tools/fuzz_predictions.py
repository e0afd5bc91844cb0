"""Damage to predictions files, in bits, bytes, parts and values; `make attack` reads what comes of it."""

import contextlib

import h5py
import numpy as np
from valid_predictions import DATASETS

from symsol_annot.bench.predictions.format import FILE_ATTRIBUTES

# Damage


def flip_bits(content, rng):
    for at in rng.integers(0, 8 * len(content), rng.integers(1, 9)):
        content[at // 8] ^= 1 << (at % 8)


def flip_one_bit(content, rng):
    at = int(rng.integers(0, 8 * len(content)))
    content[at // 8] ^= 1 << (at % 8)


def overwrite_run(content, rng):
    length = int(rng.integers(1, 64))
    at, source = rng.integers(0, max(1, len(content) - length), 2)
    content[at : at + length] = (
        bytes(length),
        b"\xff" * length,
        rng.bytes(length),
        bytes(content[source : source + length]),
    )[rng.integers(4)]


def set_number(content, rng):
    """Overwrite 1 to 8 bytes with a number at which sizes, counts and addresses break."""
    size = int(rng.choice([1, 2, 4, 8]))
    numbers = [0, 1, -1, 2 ** (8 * size - 1), 2 ** (8 * size - 1) - 1, len(content), int(rng.integers(0, len(content)))]
    number = numbers[rng.integers(len(numbers))] % 2 ** (8 * size)
    at = int(rng.integers(0, len(content) - size))
    content[at : at + size] = number.to_bytes(size, "little")


def truncate(content, rng):
    del content[int(rng.integers(0, len(content))) :]


def insert_or_drop(content, rng):
    at, length = int(rng.integers(0, len(content))), int(rng.integers(1, 64))
    if rng.random() < 0.5:
        del content[at : at + length]
    else:
        content[at:at] = rng.bytes(length)


BYTES = (flip_one_bit, flip_one_bit, flip_bits, flip_bits, overwrite_run, set_number, truncate, insert_or_drop)

ODD_VALUES = (
    0,
    -1,
    2**31,
    2**63 - 1,
    True,
    0.5,
    float("nan"),
    float("inf"),
    1e-320,
    "",
    "tetX",
    "cylO",
    "train",
    "..",
    "a/../b",
    "\x1b[2J\x1b]0;owned\x07",
    "\u202egnp.exe",
    "x" * 5000,
    b"\xff\xfe\x00",
    np.longdouble(1) / 3,
    np.arange(3),
    np.zeros((0,)),
    ["a", "b"],
    h5py.Empty("f8"),
    np.void(b"opaque"),
    np.complex128(1j),
)
ODD_NAMES = ("model", "hypotheses ", "hypothèses", "\u202ex", "\x1b[31mred", "a" * 300, ".", "..", b"\xff\xfe")
ODD_NUMBERS = (
    np.nan,
    np.inf,
    -np.inf,
    -1.0,
    0.0,
    -0.0,
    1.0,
    1.5,
    2.0,
    1e-320,
    1e300,
    1e200,
    -800.0,
    -1e308,
    72.0,
    2.0**31,
    2.0**62,
)
TYPES = (">f4", ">f8", "f2", "f4", "f8", "g", "i1", "u2", ">i4", "i8", "u8", "?", "S8", "c16", "V4")


def rename(file, rng):
    file.move(_any(file, rng), _new_name(rng))


def swap(file, rng):
    a, b = _any(file, rng), _any(file, rng)
    if a != b:
        file.move(a, "swapped")
        file.move(b, a)
        file.move("swapped", b)


def remove(file, rng):
    del file[_any(file, rng)]


def copy(file, rng):
    name, other = _any(file, rng), _any(file, rng)
    if name != other:
        del file[other]
        file.copy(name, other)


def retype(file, rng):
    name = _any(file, rng)
    with np.errstate(all="ignore"):
        _replace(file, name, file[name][...].astype(TYPES[rng.integers(len(TYPES))]))


def reshape(file, rng):
    name = _any(file, rng)
    column = file[name][...]
    shapes = (
        column.reshape(-1),
        column[None],
        column[..., None],
        column.T,
        column[:-1],
        column[:0],
        np.concatenate([column, column]),
        column[(0,) * column.ndim] if column.size else column,
        column[..., :1],
        column[..., :0],
        np.repeat(column, 4, axis=-1),
        column.reshape(len(column), -1),
    )
    _replace(file, name, shapes[rng.integers(len(shapes))])


def set_values(file, rng):
    name = _any(file, rng)
    column = file[name][...]
    if column.size:
        with np.errstate(all="ignore"):
            odd = np.array(ODD_NUMBERS)[rng.integers(len(ODD_NUMBERS), size=rng.integers(1, 4))].astype(column.dtype)
        column.reshape(-1)[rng.integers(column.size, size=len(odd))] = odd
        file[name][...] = column


def permute(file, rng):
    name = _any(file, rng)
    file[name][...] = rng.permutation(file[name][...], axis=int(rng.integers(file[name].ndim)))


def set_attribute(file, rng):
    name = list(FILE_ATTRIBUTES)[rng.integers(len(FILE_ATTRIBUTES))]
    name = str(rng.choice([name, "grid_level", "grid_sha256", "group_sha256", "floor", "other"]))
    file.attrs[name] = ODD_VALUES[rng.integers(len(ODD_VALUES))]


def remove_attribute(file, rng):
    del file.attrs[rng.choice(list(file.attrs))]


def swap_attributes(file, rng):
    a, b = rng.choice(list(file.attrs), 2)
    first, second = file.attrs[a], file.attrs[b]
    file.attrs[a], file.attrs[b] = second, first


def put_link(file, rng):
    name = _any(file, rng)
    del file[name]
    links = (
        h5py.SoftLink(f"/{name}"),
        h5py.SoftLink("/elsewhere/x"),
        h5py.ExternalLink("canary.h5", name),
        h5py.ExternalLink("case.h5", name),
        file["/"],
        h5py.h5t.IEEE_F64LE,
    )
    link = links[rng.integers(len(links))]
    file[name] = np.dtype("f8") if isinstance(link, h5py.h5t.TypeID) else link
    if rng.random() < 0.5:
        file["elsewhere"] = h5py.ExternalLink("canary.h5", "/")


def put_elsewhere(file, rng):
    """Keep values in the canary: external storage, or a virtual data set, also one whose shape is asked for there."""
    name = _any(file, rng)
    shape, dtype = file[name].shape, file[name].dtype
    del file[name]
    if rng.random() < 0.5:
        file.create_dataset(name, shape, dtype, external=[("canary.h5", 0, h5py.h5f.UNLIMITED)])
        return
    layout = h5py.VirtualLayout(shape, dtype, maxshape=(None, *shape[1:]))
    source = h5py.VirtualSource("canary.h5", name, shape, dtype, maxshape=(None, *shape[1:]))
    rows = slice(0, h5py.h5s.UNLIMITED if rng.random() < 0.5 else shape[0])
    layout[rows] = source[rows]
    file.create_virtual_dataset(name, layout)


def put_odd(file, rng):
    """Put what is no plain array of numbers."""
    name = _any(file, rng)
    shape, dtype = file[name].shape, file[name].dtype
    del file[name]
    kind = rng.integers(9)
    if kind == 0:
        file.create_dataset(name, shape, h5py.vlen_dtype(dtype))
    elif kind == 1:
        file.create_dataset(name, shape, h5py.ref_dtype)
    elif kind == 2:
        file.create_dataset(name, shape, np.dtype([("a", dtype), ("b", "i4")]))
    elif kind == 3:
        file[name] = h5py.Empty(dtype)
    elif kind == 4:
        file.create_group(name)["inside"] = 1
    elif kind == 5:
        file.create_dataset(name, shape, dtype, compression="lzf", chunks=True)
    elif kind == 6:
        file.create_dataset(name, (2**40, *shape[1:]), dtype, chunks=(1, *shape[1:]))
    elif kind == 7:
        file.create_dataset(name, shape, h5py.string_dtype())
    else:
        file.create_dataset(name, shape, np.dtype((dtype, (2,))))


FIELDS = (
    rename,
    swap,
    remove,
    copy,
    retype,
    reshape,
    set_values,
    set_values,
    permute,
    set_attribute,
    set_attribute,
    remove_attribute,
    swap_attributes,
    put_link,
    put_elsewhere,
    put_odd,
)


def _any(file, rng):
    """Return the name of a data set that can still be changed."""
    there = [(name, file[name]) for name in DATASETS if isinstance(file.get(name), h5py.Dataset)]
    plain = [name for name, data in there if data.shape and data.dtype.kind in "fiu" and data.size < 10**6]
    return str(rng.choice([name for name in plain if not (file[name].is_virtual or file[name].external)]))


def _new_name(rng):
    return (*DATASETS, *ODD_NAMES)[rng.integers(len(DATASETS) + len(ODD_NAMES))]


def _replace(file, name, column):
    del file[name]
    file[name] = column


# Cases


def make_case(path, bases, rng):
    """Write a damaged file; return what was done to it."""
    base = bases[rng.integers(len(bases))]
    path.write_bytes(base)
    done = []
    if rng.random() < 0.45:
        with contextlib.suppress(ValueError, KeyError, OSError, TypeError, RuntimeError), h5py.File(path, "r+") as file:
            for _ in range(rng.integers(1, 4)):  # what cannot be done is left
                change = FIELDS[rng.integers(len(FIELDS))]
                change(file, rng)
                done.append(change.__name__)
        if rng.random() < 0.7:
            return done
    content = bytearray(path.read_bytes())
    damage = BYTES[rng.integers(len(BYTES))]
    damage(content, rng)
    path.write_bytes(content)
    return [*done, damage.__name__]
