"""What is not as the format has it is refused by the name of its fault, and nothing of it is read."""

import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_shards import COUNT, DEEP, GROUP, HEIGHT, LAYOUT, NOTES, WIDTH, build, header, read_all, refusal
from odd_shards import FOREIGN_FILES, FOREIGN_GROUPS, extra_data_set, plain, replaced, soft_link
from tampering import ChunkIndex

from symsol_annot.errors import DataError
from symsol_annot.sets.shard.reader import open_shard

# Data sets


@pytest.mark.parametrize("case", FOREIGN_FILES)
def test_foreign_file_is_refused_by_the_name_of_its_fault(shard, tmp_path, case):
    tamper, words = FOREIGN_FILES[case]
    whole = Path(shutil.copy(shard, tmp_path / "whole.h5"))  # so that what a link leads to is as expected
    with h5py.File(shard, "r+") as file:
        tamper(file, whole)
    message = refusal(shard)
    assert [word for word in words if word not in message] == []


@pytest.mark.parametrize("name", LAYOUT)
def test_tampering_itself_is_not_what_is_refused(shard, name):
    expected = read_all(shard)
    with h5py.File(shard, "r+") as file:
        replaced(name)(file, None)
    found = read_all(shard)
    assert set(found) == set(expected)
    for each, values in found.items():
        np.testing.assert_array_equal(values, expected[each])


# Attributes


@pytest.mark.parametrize("case", FOREIGN_GROUPS)
def test_group_that_is_no_array_of_rotations_is_refused(shard, tmp_path, case):
    tamper, words = FOREIGN_GROUPS[case]
    with h5py.File(shard) as file, h5py.File(tmp_path / "odd.h5", "w", libver=("v108", "v108")) as odd:
        odd.attrs.update(file.attrs)
        for name in file:
            file.copy(name, odd)
        tamper(odd, shard)
    message = refusal(tmp_path / "odd.h5")
    assert words in message
    assert "symmetry_group" in message or "symmetry_mask" in message


def test_a_group_that_lies_elsewhere_in_the_file_is_read_all_the_same(shard):
    """As that of more than 64 KiB does, and of any file in HDF5's newer formats."""
    expected = read_all(shard)
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs["symmetry_group"] = GROUP
    assert read_all(shard).keys() == expected.keys()
    np.testing.assert_array_equal(read_all(shard)["symmetry_group"], GROUP)


NO_CAMERAS = [
    "",
    "four",
    "[]",
    "3",
    "{}",
    '{"width": 16}',
    '{"width": 16, "height": null}',
    '{"width": 16, "height": Infinity}',
    '{"width": 16, "height": true}',
    '{"width": 16, "height": 12.0}',
    '{"width": 16, "height": 1e999}',
    '{"width": 4000, "height": 4000}',
    '{"width": 16, "height": -12}',
    "[" * 60_000,
    "9" * 60_000,
    7,
    ["{}", "{}"],
]
NO_PARTS = [
    *("", "body", "{}", "[]", "null", "3", '["body", 2]', '["body", "body"]', '["body", ""]', '[["body"]]'),
    *(
        '["body", "\\u001b[2J"]',
        "[" * 60_000,
        f'["{"x" * 65}"]',
        str([str(n) for n in range(256)]).replace("'", '"'),
    ),
    *(7, ["body", "marking"]),
]


@pytest.mark.parametrize(
    ("name", "value"), [*(("camera", value) for value in NO_CAMERAS), *(("parts", value) for value in NO_PARTS)]
)
def test_json_that_is_no_camera_with_a_size_and_no_list_of_parts_is_refused_in_short(shard, name, value):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs[name] = value
    message = refusal(shard)
    assert f"'{name}'" in message
    assert len(message) < 500


@pytest.mark.parametrize("name", [*DEEP.to_attributes(), *NOTES, "symmetry_group", "symmetry_group_sha256"])
def test_missing_attribute_is_refused(shard, name):
    with h5py.File(shard, "r+") as file:
        del file.attrs[name]
    assert f"'{name}'" in refusal(shard)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format", "another format"),
        ("format", ["symsol-annot shard", "symsol-annot shard"]),
        ("format", 1),
        ("format_version", 0),
        ("format_version", -1),
        ("format_version", [1, 2]),
        ("format_version", "1"),
        ("format_version", 1.0),
        ("format_version", True),
        ("object", 3),
        ("object", h5py.Empty("S1")),
        ("object", np.void(b"tetX")),
        ("split", [1.0, 2.0]),
        ("first_index", "first"),
        ("first_index", [0, 1]),
        ("first_index", np.bool_(True)),
        ("first_index", 32.0),
        ("seed", [0, 1]),
        ("seed", np.zeros((), dtype=[("seed", "i8")])),
        ("tolerance_px", "five"),
        ("tolerance_px", 5),
        ("tolerance_px", 1j),
        ("candidates_drawn", "many"),
        ("versions", np.array("{}", dtype=h5py.string_dtype()).reshape(1)),
    ],
)
def test_attribute_of_a_wrong_value_or_type_is_refused(shard, name, value):
    with h5py.File(shard, "r+") as file:
        file.attrs[name] = value
    assert f"'{name}'" in refusal(shard)


@pytest.mark.parametrize("name", ["note", "source", "FORMAT", "\x1b[2J", "x" * 5000])
def test_attribute_that_the_format_does_not_list_is_refused(shard, name):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs[name] = "mine"
    message = refusal(shard)
    assert "is not part of" in message
    assert "\x1b" not in message
    assert len(message) < 2000


def test_newer_format_is_refused_with_both_versions(shard):
    with h5py.File(shard, "r+") as file:
        file.attrs["format_version"] = 3
    with pytest.raises(DataError, match=r"of format version 3, newer than 2, .* update it"), open_shard(shard):
        pass


@pytest.mark.parametrize("depth", [True, False])
def test_shard_that_takes_itself_for_one_of_version_1_is_refused(tmp_path, depth):
    path = tmp_path / "shard.h5"
    path.write_bytes(build(DEEP if depth else header()).data)
    with h5py.File(path, "r+") as file:
        file.attrs["format_version"] = 1
    message = refusal(path)
    odd = [
        "'parts' is not part of",
        "'symmetry_group' is not part of",
        "'part_pixels' is not part of the format, version 1",
    ]
    assert [words for words in odd if words not in message] == []
    assert ("'depth' is not part of" in message) == depth


# All at once


def test_all_faults_are_listed_not_the_first(shard):
    with h5py.File(shard, "r+") as file:
        for name in ("seed", "engine"):
            del file.attrs[name]
        extra_data_set(file, None)
        soft_link(file, None)
    message = refusal(shard)
    assert [word for word in ("seed", "engine", "thumbnail", "'image'", "elsewhere") if word not in message] == []


def test_all_faults_of_storage_are_listed_not_the_first(shard):
    with h5py.File(shard, "r+") as file:
        for name in ("rotation", "marking_pixels"):
            plain(name)(file, None)
        replaced("image", shuffle=True)(file, None)
    message = refusal(shard)
    assert [
        name for name in ("rotation", "marking_pixels", "image") if f"{name!r}: expected the filters" not in message
    ] == []


# The index of chunks


def chunk_missing(index, path):
    index.change_count(-1)


def chunk_twice(index, path):
    index.change_offset(2, 0, 1)


def chunk_that_begins_inside_a_row(index, path):
    index.change_offset(2, 1, 4)


def chunk_of_a_row_that_is_not_there(index, path):
    index.change_offset(COUNT - 1, 0, 2**40)


def chunk_outside(index, path):
    index.change_address(3, path.stat().st_size - 10)


def chunk_far_outside(index, path):
    index.change_address(3, 2**62)


def chunk_without_an_address(index, path):
    index.change_address(3, 2**64 - 1)


def chunk_too_large(index, path):
    index.change_size(3, 2**31)


def chunk_a_little_too_large(index, path):
    index.change_size(3, 3 * HEIGHT * WIDTH + 400)


def chunk_without_bytes(index, path):
    index.change_size(3, 0)


def chunk_that_is_its_checksum(index, path):
    index.change_size(3, 4)


def chunk_without_gzip(index, path):
    index.change_mask(3, 1)


def chunk_without_fletcher32(index, path):
    index.change_mask(3, 2)


def chunk_with_odd_filters(index, path):
    index.change_mask(3, 2**32 - 1)


DAMAGES = [
    chunk_missing,
    chunk_twice,
    chunk_that_begins_inside_a_row,
    chunk_of_a_row_that_is_not_there,
    chunk_outside,
    chunk_far_outside,
    chunk_without_an_address,
    chunk_too_large,
    chunk_a_little_too_large,
    chunk_without_bytes,
    chunk_that_is_its_checksum,
    chunk_without_gzip,
    chunk_without_fletcher32,
    chunk_with_odd_filters,
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda function: function.__name__)
def test_damaged_index_of_chunks_is_refused(shard, damage):
    """HDF5 itself gives zeros for a chunk that it does not find."""
    damage(ChunkIndex(shard, "image"), shard)
    assert "'image'" in refusal(shard)


@pytest.mark.parametrize("name", ["rotation", "symmetry_mask", "part_pixels", "marking_pixels"])
@pytest.mark.parametrize("damage", [lambda index: index.change_offset(0, 0, 5), lambda index: index.change_count(-1)])
def test_labels_whose_chunk_is_not_found_are_refused(shard, name, damage):
    damage(ChunkIndex(shard, name))
    assert f"{name!r}" in refusal(shard)
