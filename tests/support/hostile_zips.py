"""Zips of the original SYMSOL's layout that were damaged, or made to do harm."""

import io
import struct
import zlib

import numpy as np
import pytest
import symsol_source
from imported_sets import imported
from PIL import Image
from symsol_source import npz, write_zip

from symsol_annot.errors import DataError


def npy(array, shape=None, descr=None):
    """An npy file, whose header may lie."""
    header = {"descr": descr or array.dtype.str, "fortran_order": False, "shape": shape or array.shape}
    data = io.BytesIO()
    np.lib.format.write_array_header_1_0(data, header)
    return data.getvalue() + array.tobytes()


def zip_of(files):
    data = io.BytesIO()
    write_zip(data, files)
    return data.getvalue()


def png_of_size(width, height):
    """A header that promises much, and nothing after it."""
    head = b"IHDR" + struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    return b"\x89PNG\r\n\x1a\n" + struct.pack(">I", 13) + head + struct.pack(">I", zlib.crc32(head))


def png_header(width, height):
    return struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)


def with_chunk(data, kind, content):
    """A PNG with one more chunk behind its header."""
    chunk = struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
    return data[:33] + chunk + data[33:]


def header_of(text):
    """A table whose array has a header of its own."""
    return zip_of({"tet.npy": b"\x93NUMPY\1\0" + struct.pack("<H", len(text)) + text.encode()})


def rotations_changed(change, *splits):
    """A zip whose rotations of tet were changed, in train or where it is said."""

    def damage(files, arrays):
        for split in splits or ("train",):
            files[f"{split}/rotations.npz"] = npz({"tet": change(arrays["tet", split].astype("f8"))})

    return damage


def with_value(table, where, value):
    table[where] = value
    return table


def put(name, data):
    def damage(files, arrays):
        files[name] = data(files[name]) if callable(data) else data

    return damage


def dropped(name):
    def damage(files, arrays):
        del files[name]

    return damage


def jpeg(_):
    data = io.BytesIO()
    Image.new("RGB", (16, 16)).save(data, format="JPEG")
    return data.getvalue()


def false_table(*arguments, **options):
    return lambda _: zip_of({"tet.npy": npy(*arguments, **options)})


IMAGE, TABLE = "test/images/tet_00004.png", "test/rotations.npz"
IDENTITIES = np.broadcast_to(np.eye(3, dtype="f4"), (6, 12, 3, 3)).copy()


def assert_refused(folder, damage, message):
    """A zip of tet, damaged, is one error that names it, and nothing is left of the import."""
    files, arrays = symsol_source.content(("tet",))
    damage(files, arrays)
    path = write_zip(folder / "s.zip", files)
    with pytest.raises(DataError, match=message) as refused:
        imported(path, folder / "sets")
    assert str(path) in str(refused.value)
    assert [there.name for there in folder.iterdir()] == ["s.zip"]
