"""Reading a stranger's HDF5 file in a process of its own: the program that `sandbox.py` starts.

HDF5 itself crashes or loops on some damaged files, so this process has a limit on memory and one on the time
of each request, and its death is a message in the parent. It describes the file without reading a data set, and
then reads the rows it is asked for. It follows no link and opens no other file.

It imports nothing of this package, so that it starts fast. Requests are lines of JSON on standard input; an answer
is the length of a JSON header (8 bytes, little-endian), the header, and the bytes that it announces.
"""

import json
import signal
import sys
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

MAX_LINKS = 64
MAX_ATTRIBUTES = 64
MAX_ATTRIBUTE_BYTES = 65536
CHUNK_CACHE_BYTES = 2**28
_KINDS = {
    h5py.h5t.STRING: "strings",
    h5py.h5t.BITFIELD: "bit fields",
    h5py.h5t.OPAQUE: "opaque bytes",
    h5py.h5t.COMPOUND: "compounds",
    h5py.h5t.REFERENCE: "references",
    h5py.h5t.ENUM: "enumerations or booleans",
    h5py.h5t.VLEN: "variable-length rows",
    h5py.h5t.ARRAY: "array types",
}
_HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)


def main(path: str, seconds: float, memory_bytes: int) -> None:
    """Describe the file at `path`, then answer requests until standard input ends."""
    _limit_memory(memory_bytes)
    _allow(seconds)
    try:
        file = h5py.File(path, "r", rdcc_nbytes=CHUNK_CACHE_BYTES)
    except _HDF5_ERRORS as error:
        _answer({"error": f"cannot be read as HDF5: {error}"})
        return
    except MemoryError:
        _answer({"error": "cannot be opened within the memory allowed"})
        return
    _answer(_attempt(_describe, file))
    _allow(0)
    for line in sys.stdin:
        request = json.loads(line)
        _allow(seconds)
        answer = _attempt(_read, file, request)
        _answer(*answer if isinstance(answer, tuple) else (answer,))
        _allow(0)


def _attempt(function: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except _HDF5_ERRORS as error:
        return {"error": f"is damaged: {error}"}
    except MemoryError:
        return {"error": "needs more memory than a row of such a file should"}


def _read(file: h5py.File, request: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    rows = np.ascontiguousarray(file[request["dataset"]][request["start"] : request["stop"]])
    rows = rows.astype(rows.dtype.newbyteorder("<"), copy=False)
    return {"dtype": rows.dtype.str, "shape": rows.shape}, rows.data.cast("B") if rows.size else b""


def _describe(file: h5py.File) -> dict[str, Any]:
    count = len(file)
    if count > MAX_LINKS:
        return {"error": f"holds {count} links at its root; a predictions file holds at most 10 data sets"}
    return {"attributes": _attributes(file), "datasets": {name: _dataset(file, name) for name in file}}


def _attributes(file: h5py.File) -> dict[str, Any]:
    count = h5py.h5a.get_num_attrs(file.id)
    if count > MAX_ATTRIBUTES:
        raise ValueError(f"{count} attributes; at most {MAX_ATTRIBUTES} are looked at")
    return {name: _attribute(file, name) for name in file.attrs}


def _attribute(file: h5py.File, name: str) -> dict[str, Any]:
    """Return an attribute's value where it is one string or one number, else what it is instead."""
    attribute = file.attrs.get_id(name)
    kind = attribute.get_type().get_class()
    if attribute.shape != ():
        return {"found": f"an array of shape {attribute.shape}"}
    if kind not in (h5py.h5t.STRING, h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        return {"found": _KINDS.get(kind, "an unknown type")}
    if attribute.get_storage_size() > MAX_ATTRIBUTE_BYTES:
        return {"found": f"{attribute.get_storage_size()} bytes"}
    value = file.attrs[name]
    if isinstance(value, h5py.Empty):
        return {"found": "empty"}
    value = value.decode(errors="replace") if isinstance(value, bytes) else value
    return {"value": value.item() if isinstance(value, np.generic) else str(value)}


def _dataset(file: h5py.File, name: str) -> dict[str, Any]:
    """Return what a data set is, without reading it; `found` says why it is none that could be read."""
    link = file.get(name, getlink=True)
    if isinstance(link, h5py.ExternalLink):
        return {"found": f"a link into another file, {link.filename!r}"}
    if not isinstance(link, h5py.HardLink):
        return {"found": f"a soft link to {getattr(link, 'path', '?')!r}"}
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        return {"found": "a group" if isinstance(dataset, h5py.Group) else "a named type"}
    kind = dataset.id.get_type().get_class()
    if kind not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        return {"found": f"a data set of {_KINDS.get(kind, 'an unknown type')}"}
    plist = dataset.id.get_create_plist()
    return {
        "shape": dataset.shape,
        "dtype": dataset.dtype.newbyteorder("<").str,
        "virtual": bool(dataset.is_virtual),
        "external": bool(dataset.external),
        "filters": [int(plist.get_filter(i)[0]) for i in range(plist.get_nfilters())],
        "chunk_bytes": int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize if dataset.chunks else 0,
    }


def _answer(header: dict[str, Any], data: Any = b"") -> None:
    text = json.dumps(header).encode()
    sys.stdout.buffer.write(len(text).to_bytes(8, "little") + text)
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


def _limit_memory(memory_bytes: int) -> None:
    if sys.platform == "linux":
        import resource  # noqa: PLC0415 - is not everywhere

        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _allow(seconds: float) -> None:
    """Let the kernel end this process if what follows takes longer; 0 takes the limit away."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds)


if __name__ == "__main__":
    main(sys.argv[1], float(sys.argv[2]), int(sys.argv[3]))
