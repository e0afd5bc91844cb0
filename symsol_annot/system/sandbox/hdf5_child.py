"""Reading an HDF5 file of unknown origin in a process of its own: the program that `hdf5_process.py` starts.

HDF5 itself crashes or loops on some damaged files, so this process has a limit on memory and two on the time of each
request, and its death is a message in the parent. It describes a file without reading a data set, and then says where
chunks lie or reads the rows that it is asked for. It follows no link and opens no other file; nor could it, for it may
hold only one open.

It imports nothing of this package, so that it starts fast. Requests are lines of JSON on standard input:

    {"open": PATH}                              describe a file; the one that was open before is closed
    {"open": PATH, "attributes": {NAME: KIND}}  describe a file and close it: only these attributes are read, of which
                                                some may be arrays, data sets may be booleans, and where chunks lie is
                                                told, as in `_chunks`
    {"dataset": NAME, "start": N, "stop": N}    rows

An answer is the length of a JSON header (8 bytes, little-endian), the header, and the bytes that it announces.
"""

import contextlib
import encodings.ascii  # noqa: F401 - which h5py needs when no file can be opened any more
import json
import os
import signal
import sys
from collections.abc import Callable
from typing import Any

import h5py
import numpy as np

MAX_LINKS = 64
MAX_ATTRIBUTES = 64
MAX_ATTRIBUTE_BYTES = 65536
MAX_ARRAY_BYTES = 2**19  # of an attribute that is wanted as an array: 7,200 rotations
MAX_AXES = 4
MAX_CHUNKS = 2**12  # of a data set whose places are told
MAX_TEXT = 200  # characters of a name, or of HDF5's words, that a message shows
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
_ATTRIBUTE_KINDS = {"text": h5py.h5t.STRING, "whole": h5py.h5t.INTEGER, "real": h5py.h5t.FLOAT}
_IN_WORDS = {h5py.h5t.STRING: "a string", h5py.h5t.INTEGER: "a whole number", h5py.h5t.FLOAT: "a number"}
_HDF5_ERRORS = (OSError, RuntimeError, KeyError, TypeError, ValueError, OverflowError)


def main(seconds: float, processor_seconds: float, memory_bytes: int) -> None:
    """Answer requests until standard input ends."""
    _limit(memory_bytes)
    file: h5py.File | None = None
    for line in sys.stdin:
        request = json.loads(line)
        _allow(seconds, processor_seconds)
        if "open" in request:
            file, answer = _opened(file, request)
        else:
            answer = _attempt(_read, file, request)
        _answer(*answer if isinstance(answer, tuple) else (answer,))
        _allow(0, 0)


def _opened(before: h5py.File | None, request: dict[str, Any]) -> tuple[h5py.File | None, Any]:
    """Return a file and its description, or None and what is wrong with it."""
    try:
        if before is not None:
            before.close()
        file = h5py.File(request["open"], "r", rdcc_nbytes=CHUNK_CACHE_BYTES, locking=False)
    except _HDF5_ERRORS as error:
        return None, {"error": f"cannot be read as HDF5: {_text(error)}"}
    except MemoryError:
        return None, {"error": "cannot be opened within the memory allowed"}
    wanted = request.get("attributes")
    answer = _attempt(_describe, file, wanted)
    if wanted is None:
        return file, answer
    with contextlib.suppress(*_HDF5_ERRORS):  # all is told; a file that stays open keeps its disk from being unmounted
        file.close()
    return None, answer


def _attempt(function: Callable[..., Any], *arguments: Any) -> Any:
    try:
        return function(*arguments)
    except _HDF5_ERRORS as error:
        return {"error": f"is damaged: {_text(error)}"}
    except MemoryError:
        return {"error": "needs more memory than a row of such a file should"}


def _read(file: h5py.File, request: dict[str, Any]) -> tuple[dict[str, Any], Any]:
    rows = np.ascontiguousarray(file[request["dataset"]][request["start"] : request["stop"]])
    rows = rows.astype(rows.dtype.newbyteorder("<"), copy=False)
    return {"dtype": rows.dtype.str, "shape": rows.shape}, rows.data.cast("B") if rows.size else b""


def _chunks(dataset: h5py.Dataset) -> np.ndarray[Any, Any]:
    """Return where chunks lie that hold whole rows, if there are not too many.

    Returns:
        (k, 4) u8: the first row, the place in the file, the size there, and a mask of filters that were left out.
    """
    most = dataset.shape[0] // dataset.chunks[0] if dataset.chunks and dataset.chunks[0] else 0
    found: list[tuple[int, int, int, int]] = []

    def note(chunk: Any) -> bool | None:
        if any(chunk.chunk_offset[1:]):
            raise ValueError("a chunk does not begin where a row does")
        found.append((chunk.chunk_offset[0], chunk.byte_offset, chunk.size, chunk.filter_mask))
        return True if len(found) > most else None  # ends the iteration

    if 0 < most <= MAX_CHUNKS and dataset.chunks[1:] == dataset.shape[1:]:
        dataset.id.chunk_iter(note)
    return np.array(found, dtype="<u8").reshape(-1, 4)


def _describe(file: h5py.File, wanted: dict[str, str] | None) -> Any:
    """Return what a file is.

    Args:
        file: that was opened.
        wanted: attribute to its kind, "text", "whole", "real" or "array"; None reads all but arrays, and tells of no
            chunks.
    """
    links, attributes = len(file), h5py.h5a.get_num_attrs(file.id)
    if links > MAX_LINKS or attributes > MAX_ATTRIBUTES:
        return {"error": f"holds {links} names at its root and {attributes} attributes, more than its format has"}
    datasets = {_name(name)[:MAX_TEXT]: _attempt_one(_dataset, file, name, wanted is not None) for name in file}
    attributes = {_name(name)[:MAX_TEXT]: _attempt_one(_attribute, file, name, wanted) for name in file.attrs}
    arrays = [facts.pop("places") for facts in datasets.values() if "places" in facts]
    arrays += [facts.pop("array") for facts in attributes.values() if "array" in facts]
    answer = {"attributes": attributes, "datasets": datasets, "identity": _identity(file)}
    return answer, b"".join(array.tobytes() for array in arrays)


def _identity(file: h5py.File) -> list[int]:
    status = os.stat(file.filename) if sys.platform == "win32" else os.fstat(file.id.get_vfd_handle())  # noqa: PTH116
    return [status.st_dev, status.st_ino, status.st_size]


def _name(name: str | bytes) -> str:
    """Return a name, which is bytes where it is no UTF-8, for a message."""
    return name if isinstance(name, str) else name.decode(errors="backslashreplace")


def _attempt_one(
    function: Callable[..., dict[str, Any]], file: h5py.File, name: str | bytes, *arguments: Any
) -> dict[str, Any]:
    """Return what a name is; a damaged one does not hide the others."""
    try:
        return function(file, name, *arguments)
    except _HDF5_ERRORS as error:
        return {"found": f"damaged ({_text(error)})"}
    except MemoryError:
        return {"found": "damaged (it needs more memory than allowed)"}


def _attribute(file: h5py.File, name: str | bytes, wanted: dict[str, str] | None) -> dict[str, Any]:
    """Return an attribute's value where it is one string or number, or an array that is wanted; else what it is."""
    attribute = file.attrs.get_id(name)
    kind, wanted_kind = attribute.get_type().get_class(), (wanted or {}).get(_name(name), "")
    if wanted_kind == "array" and attribute.shape:
        return _array_attribute(attribute, kind)
    if attribute.shape != ():
        return {"found": "empty" if attribute.shape is None else f"an array of shape {attribute.shape}"}
    if kind not in _ATTRIBUTE_KINDS.values():
        return {"found": _KINDS.get(kind, "an unknown type")}
    if wanted is not None and _ATTRIBUTE_KINDS.get(wanted_kind) != kind:
        return {"found": _IN_WORDS[kind]}
    return _one_value(attribute, file.attrs, name, kind)


def _one_value(attribute: Any, attributes: Any, name: str | bytes, kind: int) -> dict[str, Any]:
    """Return an attribute that is one string or one number, unless it is too large."""
    if attribute.get_storage_size() > MAX_ATTRIBUTE_BYTES:
        return {"found": f"{attribute.get_storage_size()} bytes"}
    value = attributes[name]
    if kind == h5py.h5t.STRING:
        value = value.decode(errors="replace") if isinstance(value, bytes) else str(value)
        return {"value": value} if len(value) <= MAX_ATTRIBUTE_BYTES else {"found": f"{len(value)} characters"}
    return {"value": int(value) if kind == h5py.h5t.INTEGER else float(value)}


def _array_attribute(attribute: Any, kind: int) -> dict[str, Any]:
    """Return an attribute that is a small array of numbers in numpy's own bytes; else what it is."""
    shape = attribute.shape
    if kind not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT):
        return {"found": f"an array of {_KINDS.get(kind, 'an unknown type')}"}
    exact = _exact_type(attribute)
    if not exact:
        return {"found": "an array in another order of bytes or bits"}
    size = int(np.prod(shape, dtype=object)) * attribute.dtype.itemsize
    if len(shape) > MAX_AXES or not 0 < size <= MAX_ARRAY_BYTES or attribute.get_storage_size() != size:
        return {"found": f"an array of shape {shape}, of which {MAX_ARRAY_BYTES} bytes are allowed"}
    values = np.zeros(shape, exact)
    attribute.read(values)
    return {"array": values, "dtype": exact, "shape": shape}


def _dataset(file: h5py.File, name: str | bytes, is_whole: bool) -> dict[str, Any]:  # noqa: FBT001
    """Return what a data set is, without reading it; `found` says why it is none that could be read.

    With `is_whole`, it may hold booleans, and is told with the places of its chunks.
    """
    found = _not_here(file, name)
    if found:
        return {"found": found}
    dataset = file[name]
    if not isinstance(dataset, h5py.Dataset):
        return {"found": "a group" if isinstance(dataset, h5py.Group) else "a named type"}
    plist = dataset.id.get_create_plist()
    found = _not_numbers(dataset, plist, has_booleans=is_whole)
    if found:
        return {"found": found}
    places = {"places": _chunks(dataset)} if is_whole else {}
    return {
        **places,
        "places_count": len(places.get("places", ())),
        "shape": dataset.shape,
        "dtype": dataset.dtype.newbyteorder("<").str,
        "exact_type": _exact_type(dataset.id),
        "filters": [int(plist.get_filter(i)[0]) for i in range(plist.get_nfilters())],
        "chunks": dataset.chunks,
        "chunk_bytes": int(np.prod(dataset.chunks, dtype=object)) * dataset.dtype.itemsize if dataset.chunks else 0,
    }


def _exact_type(values: Any) -> str:
    """Return numpy's name of a type whose bytes in the file are numpy's own, in little-endian order; else nothing.

    Args:
        values: the low-level object of a data set or an attribute.
    """
    own = values.dtype.newbyteorder("<")
    return own.str if values.get_type().equal(h5py.h5t.py_create(own, logical=True)) else ""


def _not_here(file: h5py.File, name: str | bytes) -> str:
    """Return what a name is if it is no object at the root of this file; else nothing."""
    if "/" in _name(name):  # only in a forged file; HDF5 takes it for a path, which may lead out of the file
        return "a name with a slash"
    link = file.get(name, getlink=True)
    if isinstance(link, h5py.ExternalLink):
        return f"a link into another file, {link.filename[:MAX_TEXT]!r}"
    if not isinstance(link, h5py.HardLink):
        return f"a soft link to {getattr(link, 'path', '?')[:MAX_TEXT]!r}"
    return ""


def _not_numbers(dataset: h5py.Dataset, plist: Any, *, has_booleans: bool) -> str:
    """Return what a data set holds if not numbers, or booleans where a format has them, in this file; else nothing."""
    if plist.get_layout() == h5py.h5d.VIRTUAL:  # before its shape is asked for: HDF5 may look for that in other files
        return "a virtual data set"
    if plist.get_external_count():
        return "a data set in external storage"
    kind = dataset.id.get_type().get_class()
    is_boolean = has_booleans and kind == h5py.h5t.ENUM and _exact_type(dataset.id) == "|b1"
    if kind not in (h5py.h5t.INTEGER, h5py.h5t.FLOAT) and not is_boolean:
        return f"a data set of {_KINDS.get(kind, 'an unknown type')}"
    return "" if dataset.shape is not None else "a data set without values"


def _answer(header: dict[str, Any], data: Any = b"") -> None:
    text = json.dumps(header).encode()
    sys.stdout.buffer.write(len(text).to_bytes(8, "little") + text)
    sys.stdout.buffer.write(data)
    sys.stdout.buffer.flush()


def _text(error: BaseException) -> str:
    """Return HDF5's words, in which names from the file occur as they are, short and safe for a terminal."""
    text = str(error)
    shown = "".join(c if c.isprintable() else repr(c)[1:-1] for c in text[:MAX_TEXT])
    return shown + ("..." if len(text) > MAX_TEXT else "")


def _limit(memory_bytes: int) -> None:
    """Take from this process what a file that is read by the rules does not need."""
    if sys.platform == "linux":
        import resource  # noqa: PLC0415 - is not everywhere

        next_descriptor = os.open(os.devnull, os.O_RDONLY)
        os.close(next_descriptor)
        resource.setrlimit(resource.RLIMIT_NOFILE, (next_descriptor + 1, next_descriptor + 1))
        resource.setrlimit(resource.RLIMIT_AS, (memory_bytes, memory_bytes))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    for name in ("SIGALRM", "SIGPROF"):
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), signal.SIG_DFL)


def _allow(seconds: float, processor_seconds: float) -> None:
    """Let the kernel end this process if what follows takes longer; 0 takes the limits away."""
    if hasattr(signal, "setitimer"):
        signal.setitimer(signal.ITIMER_REAL, seconds)
        signal.setitimer(signal.ITIMER_PROF, processor_seconds)


if __name__ == "__main__":
    main(float(sys.argv[1]), float(sys.argv[2]), int(sys.argv[3]))
