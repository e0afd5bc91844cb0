"""Tables of rotations in a zip of unknown origin: read as numbers within limits, never as code."""

import pickle
from pathlib import Path

import numpy as np
import pytest
import symsol_source
from hostile_zips import IDENTITIES, TABLE, assert_refused, false_table, header_of, put, zip_of
from imported_sets import imported
from symsol_source import npz, rotations, write_zip

import symsol_annot
from symsol_annot.errors import DataError


class Shout:
    """Unpickled, it leaves a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return (Path.touch, (self.path,))


def test_a_pickle_in_a_table_is_not_run(tmp_path):
    files, _ = symsol_source.content(("tet",))
    payload = np.empty((6, 12, 3, 3), dtype=object)
    payload[:] = Shout(tmp_path / "was-run")
    files[TABLE] = npz({"tet": payload})
    with pytest.raises(DataError, match="expected an array"):
        imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert not (tmp_path / "was-run").exists()
    pickle.loads(pickle.dumps(Shout(tmp_path / "was-run")))
    assert (tmp_path / "was-run").exists()


def test_float64_rotations_are_taken_as_well(tmp_path):
    files, arrays = symsol_source.content(("cone",), dtype="f8")
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert made["cone"].off_sets_rad < 1e-7
    assert rotations("cone", 1, np.random.default_rng(0), "f8").dtype == np.float64
    assert np.allclose(symsol_annot.load(made["cone"].folder)[0].rotation, arrays["cone", "test"][0, 0], atol=1e-12)


HOSTILE = {
    "objects": (put(TABLE, npz({"tet": np.array([[None]])})), r"found \(1, 1\) of \|O"),
    "integers": (put(TABLE, npz({"tet": IDENTITIES.astype("i4")})), "found .* of <i4"),
    "by columns": (put(TABLE, npz({"tet": np.asfortranarray(IDENTITIES)})), "by columns"),
    "another shape": (put(TABLE, npz({"tet": IDENTITIES[..., :2]})), r"expected an array \(n, m, 3, 3\)"),
    "a huge shape": (put(TABLE, false_table(IDENTITIES, (10**12, 12, 3, 3))), "beyond the 100000 images"),
    "a huge list": (put(TABLE, false_table(IDENTITIES, (6, 10**9, 3, 3))), "1000 rotations allowed"),
    "a negative shape": (put(TABLE, false_table(IDENTITIES, (-6, 12, 3, 3))), "expected an array"),
    "code for a header": (put(TABLE, lambda _: zip_of({"tet.npy": b"\x93NUMPY\1\0\x10\0__import__('os')"})), "tet: "),
    "a table that ends": (put(TABLE, false_table(IDENTITIES[:3], (6, 12, 3, 3))), "ends before its last image"),
    "a header of 4 GB": (put(TABLE, lambda _: zip_of({"tet.npy": b"\x93NUMPY\2\0\xff\xff\xff\xff"})), "4294967295 by"),
    "a header of parentheses": (put(TABLE, lambda _: header_of("(" * 9000)), "its header is none of an npy file"),
    "a header of signs": (put(TABLE, lambda _: header_of("-" * 9000 + "1")), "its header is none of an npy file"),
    "a shape of 9,000 digits": (
        put(TABLE, lambda _: header_of(f"{{'descr': '<f4', 'fortran_order': False, 'shape': (0x{'f' * 9000}, 1)}}")),
        "its header tells of no array of numbers",
    ),
    "a shape of true": (
        put(TABLE, lambda _: header_of("{'descr': '<f4', 'fortran_order': False, 'shape': (True, True, 3, 3)}")),
        "its header tells of no array of numbers",
    ),
    "a zip in place of an array": (put(TABLE, lambda data: zip_of({"tet.npy": data})), "is no npy file"),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    assert_refused(tmp_path, damage, message)
