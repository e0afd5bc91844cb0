"""The file that keeps the answer about one image: a checksum, what each array is, and the arrays, deflated."""

import json
import zlib
from typing import Any

import numpy as np

from symsol_annot.bench.predictions.columns import Array

MAX_ANSWER_BYTES = 2**30

Answer = dict[str, Array]  # what was answered about one image, by data set


def packed(answer: Answer) -> bytes:
    """Return the bytes of an answer's file: a checksum, what each array is, and the arrays, deflated.

    A density of 294,912 cells takes 3.5 MB otherwise, and a split 5,000 times that.
    """
    deflated = {name: zlib.compress(_by_significance(array), 1) for name, array in answer.items()}
    forms = {name: [len(deflated[name]), array.dtype.str, *array.shape] for name, array in answer.items()}
    body = b"".join([json.dumps(forms).encode(), b"\n", *deflated.values()])
    return f"{zlib.crc32(body):08x}\n".encode() + body


def forms_and_data(file: bytes) -> tuple[dict[str, list[Any]], memoryview]:
    """Undo `packed` but for the arrays.

    Raises:
        ValueError: the checksum is another.
    """
    checksum, _, body = file.partition(b"\n")
    if int(checksum, 16) != zlib.crc32(body):
        raise ValueError("its checksum is another")
    head, _, _ = body.partition(b"\n")
    return json.loads(head), memoryview(body)[len(head) + 1 :]


def inflated(data: memoryview, code: str, shape: list[int]) -> Array:
    """Return one array of an answer.

    Args:
        data: its deflated bytes.
        code: numpy's name of its type.
        shape: of it.

    Raises:
        ValueError: it is no such array, or a larger one than an answer may have.
        TypeError: there is no such type.
        zlib.error: the bytes are damaged.
    """
    dtype = np.dtype(code)
    size = dtype.itemsize * int(np.prod(shape, dtype=object))
    if not 0 <= size <= MAX_ANSWER_BYTES:
        raise ValueError(f"it says that an array has {size} bytes")
    found = zlib.decompressobj().decompress(data, size + 1)
    if len(found) != size:
        raise ValueError("an array has another size than it says")
    planes = np.frombuffer(found, np.uint8).reshape(dtype.itemsize, -1)
    return np.ascontiguousarray(planes.T).view(dtype).reshape(shape)


def _by_significance(array: Array) -> bytes:
    flat = np.ascontiguousarray(array).reshape(-1).view(np.uint8)
    return flat.reshape(-1, array.dtype.itemsize).T.tobytes()
