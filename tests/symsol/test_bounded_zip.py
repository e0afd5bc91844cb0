"""Zip files of unknown origin: no list of files and no file unpacks beyond the limits."""

import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import symsol_source
from hostile_zips import IMAGE, TABLE, assert_refused, npy, put, zip_of
from imported_sets import imported
from symsol_source import write_zip

from symsol_annot.errors import DataError


def test_a_zip_whose_list_of_files_is_a_bomb_is_refused_before_it_is_read(tmp_path):
    """A sparse gigabyte of list: 23 million names of nothing."""
    path = tmp_path / "s.zip"
    with path.open("wb") as file:
        file.truncate(2**30)
        file.seek(2**30)
        file.write(struct.pack("<4sHHHHIIH", b"PK\5\6", 0, 0, 0xFFFF, 0xFFFF, 2**30, 0, 0))
    with pytest.raises(DataError, match=r"list of files has 1,073,741,824 bytes, more than the 50,000,000"):
        imported(path, tmp_path / "sets")


def test_files_that_lie_over_each_other_are_refused(tmp_path):
    """As in the bombs of which every file is the same one, packed once."""
    files, _ = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", files, zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as file:
        first, second = (info.header_offset for info in file.infolist()[1:3])
    place = data.rindex(struct.pack("<I", second))
    data[place : place + 4] = struct.pack("<I", first)
    path.write_bytes(data)
    with pytest.raises(DataError, match="lie over each other"):
        imported(path, tmp_path / "sets")


@pytest.mark.filterwarnings("ignore:Duplicate name")
def test_zips_that_are_packed_in_odd_ways_are_refused(tmp_path):
    files, _ = symsol_source.content(("tet",))
    packed = write_zip(tmp_path / "bz2.zip", files, zipfile.ZIP_BZIP2)
    twice = write_zip(tmp_path / "twice.zip", files)
    with zipfile.ZipFile(twice, "a") as file:
        file.writestr(IMAGE, b"another")
    locked = tmp_path / "locked.zip"
    data = bytearray(write_zip(tmp_path / "plain.zip", files).read_bytes())
    data[data.index(b"PK\1\2") + 8] |= 1  # the flag of encryption
    locked.write_bytes(data)
    for path, message in ((packed, "another method than deflate"), (twice, "same name"), (locked, "encrypted")):
        with pytest.raises(DataError, match=message):
            imported(path, tmp_path / "sets")
    cut = tmp_path / "cut.zip"
    cut.write_bytes(data[: len(data) // 2])
    others = (
        (tmp_path / "none.zip", "no such file"),
        (tmp_path, "is a folder"),
        (Path("/dev/null"), "is no reg"),
        (Path("/dev/zero"), "is no reg"),
        (tmp_path / "fifo", "is no reg"),
        (tmp_path / "plain.zip" / "x", "Not a directory"),
    )
    os.mkfifo(tmp_path / "fifo")
    for path, message in ((cut, "cannot be read as a zip"), *others):
        with pytest.raises(DataError, match=message):
            imported(path, tmp_path / "sets")
    assert not (tmp_path / "sets").exists()


HOSTILE = {
    "a bomb": (put(IMAGE, b"\0" * (2**25 + 1)), "is of 33554433 bytes in 3[0-9]{4}, as only a bomb is packed"),
    "a PNG and more": (
        put(IMAGE, lambda data: data + np.random.default_rng(0).bytes(2**17)),
        "bytes, more than the 66560 allowed",
    ),
    "a table of zeros": (
        put(TABLE, bytes(2**24)),
        "rotations.npz: is of 16777216 bytes in .* as only a bomb is packed",
    ),
    "an array of zeros": (
        put(TABLE, lambda _: zip_of({"tet.npy": npy(np.zeros((60_000, 12, 3, 3), "f4"))})),
        "as only a bomb is packed",
    ),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    assert_refused(tmp_path, damage, message)
