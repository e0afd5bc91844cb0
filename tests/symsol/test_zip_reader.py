"""The original SYMSOL's zip: its files are all there, no others are touched, and it is read as one state."""

import shutil
import time
import zipfile
from pathlib import Path

import numpy as np
import pytest
import symsol_source
from hostile_zips import IDENTITIES, IMAGE, TABLE, assert_refused, dropped, put
from imported_sets import NAMES, everything, imported
from symsol_source import npz, png, write_zip

import symsol_annot
from symsol_annot.errors import DataError
from symsol_annot.sets.verify import verify
from symsol_annot.symsol.zip_reader import SymsolZip


def test_a_zip_that_names_files_elsewhere_writes_none(tmp_path, source):
    path, _, _ = source
    inside = tmp_path / "deep" / "down"
    inside.mkdir(parents=True)
    files = {name: zipfile.ZipFile(path).read(name) for name in zipfile.ZipFile(path).namelist()}
    elsewhere = {"../../escaped.png": b"x", "/tmp/escaped": b"x", "test/images/../../tet_00000.png": b"x"}
    imported(write_zip(inside / "s.zip", {**files, **elsewhere}), inside / "sets", "tet")
    assert sorted(there.name for there in inside.iterdir()) == ["s.zip", "sets"]
    assert [there.name for there in (inside / "sets").iterdir()] == ["tet"]
    assert [there.name for there in tmp_path.iterdir()] == ["deep"]


UNLUCKY = [
    "/etc/passwd",
    "..\\..\\x.png",
    "C:\\x.png",
    "test/images/",
    "test/images/tet_0000٣.png",
    "a\x1b[2J",
    "x" * 60_000,
]


def test_names_of_any_kind_beside_the_sources_own_are_passed_over(tmp_path):
    files, arrays = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", {**files, **dict.fromkeys(UNLUCKY, b"x")})
    made = imported(path, tmp_path / "sets")
    assert sorted(there.name for there in tmp_path.iterdir()) == ["s.zip", "sets"]
    assert np.array_equal(symsol_annot.load(made["tet"].folder)[4].image, arrays["tet", "test", "images"][4])


def test_many_thousand_names_are_read_in_time(tmp_path):
    files, _ = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", {**files, **{f"x{i}": b"" for i in range(70_000)}}, zipfile.ZIP_STORED)
    start = time.process_time()
    with SymsolZip(path) as source:
        assert source.objects == ("tet",)
    assert time.process_time() - start < 10.0


def test_a_zip_that_is_written_to_while_it_is_read_leaves_no_set(tmp_path):
    files, _ = symsol_source.content(("tet",))
    path = write_zip(tmp_path / "s.zip", files)

    def grow(_):
        with path.open("ab") as file:
            file.write(b"more")

    with pytest.raises(DataError, match="was changed while it was read"):
        imported(path, tmp_path / "sets", on_begin=grow)
    assert list((tmp_path / "sets").glob("*")) == []


def test_a_zip_that_is_replaced_while_it_is_read_is_read_to_its_end(tmp_path, source):
    files, _ = symsol_source.content(NAMES)
    path = write_zip(tmp_path / "s.zip", files)
    made = imported(
        path, tmp_path / "sets", "tet", on_begin=lambda _: Path(shutil.copy(__file__, tmp_path)).replace(path)
    )
    there = everything(made["tet"].folder)
    assert there.keys() == everything(source[2]["tet"].folder).keys()
    assert verify(made["tet"].folder) == []


HOSTILE = {
    "an image is missing": (dropped(IMAGE), r"tet_00004.png is missing, though it has rotations"),
    "an image too many": (put("test/images/tet_00006.png", png(np.zeros((16, 16, 3), np.uint8))), "has no rotations"),
    "images of no object's rotations": (put("test/images/cube_00000.png", b""), "cube_00000.png has no rotations"),
    "no table": (dropped(TABLE), "test/rotations.npz is missing"),
    "a table that is no zip": (put(TABLE, b"PK nothing"), "test/rotations.npz: File is not a zip file"),
    "a split without the object": (put(TABLE, npz({"cube": IDENTITIES})), "has no cube, the other split has"),
    "no objects": (put(TABLE, npz({})), "has no tet, the other split has"),
    "something else": (
        put(TABLE, npz({"../../etc": IDENTITIES})),
        r"holds '\.\./\.\./etc\.npy', which is none of SYMSOL's objects",
    ),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    assert_refused(tmp_path, damage, message)
