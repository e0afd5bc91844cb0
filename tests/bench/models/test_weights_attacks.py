"""Files of weights that were made to do harm are refused in bounded time and memory."""

import io
import json
import os
import re
import struct
import subprocess
import sys
import zipfile

import pytest
import torch
from bench_sets import SUPPORT
from torchvision_weights import saved

from symsol_annot.bench.models.weights import state_dicts
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.errors import WeightsError


def file_of(header, data=b"", length=None):
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return struct.pack("<Q", len(text) if length is None else length) + text + data


def one(dtype="F32", shape=(2,), offsets=(0, 8), **more):
    return {"a": {"dtype": dtype, "shape": list(shape), "data_offsets": list(offsets), **more}}


EIGHT = bytes(8)
LIES = {
    "a header longer than the file": (file_of(one(), EIGHT, 2**40), "header is said to have 1,099,511,627,776 bytes"),
    "a header of 2^64 bytes": (file_of(one(), EIGHT, 2**64 - 1), "header is said to have"),
    "a header of 100 MB": (file_of(b" " * 10**8), "more than the 16,777,216 that are read"),
    "no header": (file_of(b""), "Expecting value"),
    "half a length": (b"\1\0\0", "ends before its last byte"),
    "no JSON": (file_of(b"{'a': 1}"), "Expecting property name"),
    "no UTF-8": (file_of(b'{"\xff": 1}'), "codec can't decode"),
    "a list": (file_of([1]), "expected to be tensors by their names"),
    "nested deep": (file_of(b"[" * 200_000), "nested too deep"),
    "a number of 10^5 digits": (file_of(b'{"a": ' + b"9" * 100_000 + b"}"), "Exceeds the limit"),
    "metadata that are no text": (file_of({"__metadata__": {"a": 1}, **one()}, EIGHT), "texts by their names"),
    "metadata that are a list": (file_of({"__metadata__": [], **one()}, EIGHT), "texts by their names"),
    "a tensor that is a list": (file_of({"a": []}), "expected to have a type of"),
    "a type that is none": (file_of(one(dtype="F128"), EIGHT), "expected to have a type of"),
    "a type that is a list": (file_of(one(dtype=["F32"]), EIGHT), "expected to have a type of"),
    "no shape": (file_of({"a": {"dtype": "F32", "data_offsets": [0, 8]}}, EIGHT), "a shape and offsets"),
    "a key too many": (file_of(one(code="x"), EIGHT), "a shape and offsets"),
    "a negative shape": (file_of(one(shape=(-2, -1)), EIGHT), "shape of up to 8"),
    "a shape of true": (file_of(one(shape=(True, 2)), EIGHT), "shape of up to 8"),
    "a shape of fractions": (file_of(one(shape=(2.0,)), EIGHT), "shape of up to 8"),
    "nine dimensions": (file_of(one(shape=(2, *8 * [1])), EIGHT), "shape of up to 8"),
    "2^60 elements": (file_of(one(shape=(2**30, 2**30))), "expected to have 4,611,686,018,427,387,904 bytes"),
    "2^60 elements of none": (file_of(one(shape=(0, 2**60), offsets=(0, 0))), "shape of up to 8"),
    "fewer bytes than its shape": (file_of(one(shape=(3,)), EIGHT), "expected to have 12 bytes by its shape, found 8"),
    "offsets beyond the file": (file_of(one(shape=(200,), offsets=(0, 800)), EIGHT), "header tells of"),
    "offsets backwards": (file_of(one(offsets=(8, 0)), EIGHT), "expected to have 8 bytes by its shape, found -8"),
    "bytes that are no tensor's": (file_of(one(), 2 * EIGHT), "header tells of"),
    "a hole": (file_of(one(offsets=(8, 16)), 2 * EIGHT), "begins at 8, expected 0"),
    "tensors over each other": (
        file_of({**one(), "b": {"dtype": "F32", "shape": [2], "data_offsets": [4, 12]}}, EIGHT + bytes(4)),
        "'b' begins at 4, expected 8",
    ),
    "5,000 tensors": (
        file_of({f"a{i}": {"dtype": "F32", "shape": [0], "data_offsets": [0, 0]} for i in range(5000)}),
        "5,000 tensors, more than the 4,096",
    ),
}


@pytest.mark.parametrize(("data", "said"), LIES.values(), ids=LIES)
def test_a_header_that_lies_is_refused_before_memory_is_taken_for_it(data, said, tmp_path):
    path = tmp_path / "a.safetensors"
    path.write_bytes(data)
    with pytest.raises(WeightsError, match=said) as caught:
        read_weights(path)
    assert len(str(caught.value)) < 1000


def pickled(*parts):
    """A pickle of protocol 2 from opcodes."""
    return b"\x80\x02" + b"".join(parts) + b"."


def called(module, name, *arguments):
    return b"c" + f"{module}\n{name}\n".encode() + b"(" + b"".join(arguments) + b"tR"


def whole(number):
    data = number.to_bytes(8, "little", signed=True)
    return b"\x8a\x08" + data


def torch_zip(pickle_bytes, compression=zipfile.ZIP_STORED, **files):
    data = io.BytesIO()
    with zipfile.ZipFile(data, "w", compression) as file:
        file.writestr("archive/data.pkl", pickle_bytes)
        file.writestr("archive/version", b"3\n")
        file.writestr("archive/byteorder", b"little")
        for name, content in files.items():
            file.writestr(f"archive/data/{name[1:]}", content)
    return data.getvalue()


def a_tuple_of_itself_twice(levels):
    return b"(t" + b"".join(b"2\x86" for _ in range(levels))


STORAGE = b"(X\x07\0\0\0storagectorch\nFloatStorage\nX\x01\0\0\x000X\x03\0\0\0cpu" + whole(2**40) + b"tQ"
BOMBS = {
    "a name that takes for ever to hash": torch_zip(pickled(b"}", a_tuple_of_itself_twice(60), b"Ns")),
    "terabytes of nothing": torch_zip(pickled(called("__builtin__", "bytearray", whole(2**42)))),
    "a gigabyte of nothing": torch_zip(pickled(called("__builtin__", "bytearray", whole(2**30)))),
    "a tensor of terabytes": torch_zip(pickled(called("torch", "Tensor", whole(2**40)))),
    "a storage of terabytes": torch_zip(pickled(STORAGE), _0=b"1234"),
    "a zip bomb": torch_zip(pickled(STORAGE), zipfile.ZIP_DEFLATED, _0=bytes(2**27)),
    "a place of 2^31 in the memo": torch_zip(pickled(b"Nr" + struct.pack("<I", 2**31 - 1))),
    "a pickle of 2^60 bytes": torch_zip(b"\x80\x04\x8d" + struct.pack("<Q", 2**60)),
}
READ = """
import json, resource, sys
from pathlib import Path
from forked_pickles import forked_pickles
from symsol_annot.bench.models.weights import state_dicts
from symsol_annot.bench.models.weights.state_dicts import read_weights
from symsol_annot.errors import WeightsError
forked_pickles().__enter__()
state_dicts._PICKLE_SECONDS = 2.0
for path in map(Path, sys.argv[1:]):
    before = resource.getrusage(resource.RUSAGE_CHILDREN).ru_utime
    try:
        said = f"read {len(read_weights(path))}"
    except WeightsError as error:
        said = str(error)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    print(json.dumps([path.stem, said, used.ru_utime - before, used.ru_maxrss]))
"""


def test_a_pickle_that_asks_for_time_or_memory_without_end_is_refused_in_bounds(tmp_path):
    """In a process of its own, which holds little, for a child is counted with the memory of its parent."""
    for name, data in BOMBS.items():
        (tmp_path / f"{name}.pth").write_bytes(data)
    assert state_dicts._PICKLE_SECONDS < 20.0
    done = subprocess.run(
        [sys.executable, "-c", READ, *(tmp_path / f"{name}.pth" for name in BOMBS)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(SUPPORT), os.environ.get("PYTHONPATH", "")])},
        capture_output=True,
        text=True,
        check=True,
    )
    answers = [json.loads(line) for line in done.stdout.splitlines()]
    assert [name for name, *_ in answers] == list(BOMBS)
    for name, said, seconds, kibibytes in answers:
        assert re.search("is damaged|expected tensors by their names", said), name
        assert len(said) < 500
        assert seconds < 4.0, name
        assert kibibytes < 2**20, name


def test_one_number_that_stands_for_a_gigabyte_is_not_written_out(tmp_path):
    with pytest.raises(WeightsError, match=r"1 tensors of 1,073,741,824 bytes, more than"):
        read_weights(saved(tmp_path, {"a": torch.zeros(1).expand(2**28)}))
