"""Predictions files: valid ones of all tracks, stored in several ways, and damage to them; and their readers, forked.

A process per file is started by a fork here, which takes milliseconds; what runs in it is what runs in the product.
`make attack` reads the damaged ones.
"""

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import traceback
import warnings
from pathlib import Path
from types import SimpleNamespace

import h5py
import numpy as np

from symsol_annot import load
from symsol_annot.bench.predictions.format import FILE_ATTRIBUTES
from symsol_annot.bench.predictions.queries import group_sha256, query_count
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.rotations.grid import grid_sha256, grid_size
from symsol_annot.system.sandbox import hdf5_child
from symsol_annot.system.sandbox import hdf5_process as sandbox

IMAGES, LEVEL, HYPOTHESES = 6, 0, 3
DATASETS = ("image_index", *(name for track in TRACKS.values() for name in track.datasets))
STORAGE = {
    "contiguous": {},
    "chunked": {"chunks": True},
    "gzip": {"chunks": True, "compression": "gzip", "shuffle": True, "fletcher32": True},
    "resizable": {"chunks": True, "compression": "gzip", "maxshape": True},
}

# Valid files


def valid_columns(dataset, rng):
    """Return every data set of a file with all tracks, made with numpy alone."""
    labels, size = dataset.labels(), grid_size(LEVEL)
    images, queries = len(labels), query_count(len(labels.symmetry_group))
    listed = [np.sort(rng.choice(size, rng.integers(0, 9), replace=False)) for _ in range(images)]
    offsets = np.concatenate([[0], np.cumsum([len(indices) for indices in listed])])
    indices = np.concatenate(listed).astype(np.int32)
    weights = rng.uniform(0.1, 1.0, (images, HYPOTHESES))
    weights[0, 1] = 0.0
    return {
        "image_index": np.arange(images),
        "hypotheses": np.stack([labels.members(i)[:HYPOTHESES] for i in range(images)]),
        "hypothesis_weights": weights,
        "query_probability": rng.uniform(0.0, 1.0, (images, queries)).astype(np.float32),
        "grid_offsets": offsets,
        "grid_indices": indices,
        "grid_probabilities": rng.uniform(0.2, 1.0, len(indices)).astype(np.float32),
        "density_offsets": offsets,
        "density_indices": indices,
        "density_log_probabilities": np.log(rng.uniform(0.001, 0.1, len(indices))),
    }


def valid_attributes(dataset):
    """Return every attribute of a file with all tracks."""
    return {
        "format": "symsol-annot predictions",
        "format_version": 1,
        "method": "made to be broken",
        "object": dataset.object,
        "split": dataset.split,
        "fingerprint": dataset.fingerprint,
        "group_sha256": group_sha256(dataset.symmetry_group),
        "grid_level": LEVEL,
        "grid_sha256": grid_sha256(LEVEL),
        "floor": 0.1,
    }


def write_file(path, columns, attributes, storage=None, libver=("earliest", "v108")):
    """Write a predictions file with h5py alone."""
    with h5py.File(path, "w", libver=libver) as file:
        file.attrs.update(attributes)
        for name, column in columns.items():
            stored = dict(storage or {})
            if stored.get("maxshape"):
                stored["maxshape"] = (None, *np.shape(column)[1:])
            file.create_dataset(name, data=column, track_times=False, **stored)


# A process a file, by a fork


class ForkedChild:
    """What `subprocess.Popen` is to the sandbox, forked from this process instead of started afresh."""

    stderr = os.devnull  # of the processes

    def __init__(self, command, **_):
        seconds, processor_seconds, memory_bytes = command[-3:]
        requests, self.stdin = _pipe()
        answers = os.pipe()
        self.stdout, self.returncode = os.fdopen(answers[0], "rb"), None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about threads, of which the fork uses none
            self.pid = os.fork()
        if self.pid == 0:
            limits = float(seconds), float(processor_seconds), int(memory_bytes) + _address_space()
            _serve(requests, answers[1], limits)
        os.close(requests)
        os.close(answers[1])

    def kill(self):
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)

    def poll(self):
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def wait(self):
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode


@contextlib.contextmanager
def forked_children(stderr=os.devnull):
    """Let the sandbox fork its processes."""
    ForkedChild.stderr = stderr
    sandbox.subprocess = SimpleNamespace(Popen=ForkedChild, PIPE=subprocess.PIPE, DEVNULL=subprocess.DEVNULL)
    try:
        yield
    finally:
        sandbox.subprocess = subprocess


def _pipe():
    read, write = os.pipe()
    return read, os.fdopen(write, "wb")


def _serve(requests, answers, limits):
    try:
        os.setsid()
        os.dup2(requests, 0)
        os.dup2(answers, 1)
        os.dup2(os.open(ForkedChild.stderr, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), 2)
        os.closerange(3, 256)
        sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w")
        hdf5_child.main(*limits)
        sys.stdout.flush()
    except BaseException:  # noqa: BLE001 - a fork ends here, whatever happens
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(0)


def _address_space():
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


class Opened:
    """Tells which files of a folder were opened since it was last asked (inotify)."""

    _IN_OPEN = 0x20

    def __init__(self, folder):
        libc = ctypes.CDLL(None, use_errno=True)
        self._descriptor = libc.inotify_init1(os.O_NONBLOCK)
        if libc.inotify_add_watch(self._descriptor, os.fsencode(folder), self._IN_OPEN) < 0:
            raise OSError(ctypes.get_errno(), "inotify_add_watch")

    def names(self):
        events, found = b"", set()
        with contextlib.suppress(BlockingIOError):
            while True:
                events += os.read(self._descriptor, 65536)
        while events:
            length = int.from_bytes(events[12:16], sys.byteorder)
            found.add(events[16 : 16 + length].rstrip(b"\0").decode(errors="replace"))
            events = events[16 + length :]
        return found

    def close(self):
        os.close(self._descriptor)


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


def make_bases(folder):
    """Make a set and valid files about it."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
    from made_sets import make_set

    dataset = load(make_set(folder / "data", "tetX", test=IMAGES))
    columns, attributes = valid_columns(dataset, np.random.default_rng(0)), valid_attributes(dataset)
    (folder / "bases").mkdir()
    for name, storage in STORAGE.items():
        for libver in ("earliest", "v108"), ("latest", "latest"):
            for track in ("all", *TRACKS):
                wanted = columns if track == "all" else ("image_index", *TRACKS[track].datasets)
                chosen = {n: c for n, c in columns.items() if n in wanted}
                write_file(folder / "bases" / f"{name}-{libver[0]}-{track}.h5", chosen, attributes, storage, libver)
