"""The shard as it is read: which values, which digest, and which files are refused as one."""

import hashlib
import os
import random

import h5py
import numpy as np
import pytest
from made_shards import COUNT, DEEP, GROUP, LAYOUT, build, header, read_all, refusal
from odd_shards import extra_data_set
from tampering import ChunkIndex, change_group, descriptors, links_instead, put

from symsol_annot.errors import DataError
from symsol_annot.sets.shard import reader as shards
from symsol_annot.sets.shard.reader import content_sha256, open_shard, opened_shard


def test_what_is_read_is_what_h5py_reads(shard):
    found = read_all(shard)
    with h5py.File(shard) as file:
        group = found.pop("symmetry_group")
        assert set(found) == set(file)
        np.testing.assert_array_equal(group, file.attrs["symmetry_group"])
        for name, values in found.items():
            assert (values.dtype, values.shape) == (file[name].dtype, file[name].shape)
            np.testing.assert_array_equal(values, file[name][...])
        with open_shard(shard) as opened:
            assert opened.attributes.keys() | opened.array_attributes.keys() == file.attrs.keys()
            assert opened.attributes == {name: file.attrs[name] for name in opened.attributes}
            assert opened.versions == DEEP.versions
            assert opened.parts == ("body", "marking")
            assert len(opened) == COUNT


def test_split_without_annotation_has_no_symmetry_mask_and_is_valid(tmp_path):
    path = tmp_path / "train-00000-of-00001.h5"
    path.write_bytes(build(header(), annotated=False).data)
    with open_shard(path) as shard:
        assert set(shard.arrays) == set(LAYOUT) - {"symmetry_mask", "depth"}
        assert not shard.is_annotated


@pytest.mark.parametrize("versions", ["", "[]", "null", '{"hdf5": 1}', '{"hdf5": {"a": "b"}}', "[" * 60_000])
def test_versions_that_are_no_json_of_texts_are_an_error(shard, versions):
    with h5py.File(shard, "r+", libver="latest") as file:
        file.attrs["versions"] = versions
    with open_shard(shard) as opened, pytest.raises(DataError, match="'versions' is no JSON object of texts"):
        _ = opened.versions


def test_chunks_may_lie_in_any_order(shard):
    expected = read_all(shard)
    with h5py.File(shard, "r+") as file:
        images = file["image"][...]
        put(file, "image", None, shape=images.shape, dtype="u1")
        for row in (3, 0, 4, 2, 1):
            file["image"][row] = images[row]
    np.testing.assert_array_equal(read_all(shard)["image"], expected["image"])


@pytest.mark.parametrize("userblock", [512, 4096])
def test_shard_behind_a_user_block_is_read_right_or_refused(shard, tmp_path, userblock):
    """Where chunks lie is told from the file's beginning or from behind the block, by HDF5's version."""
    with h5py.File(shard) as file, h5py.File(tmp_path / "a.h5", "w", userblock_size=userblock) as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...])
    try:
        found = read_all(tmp_path / "a.h5")
    except DataError:
        return
    for name, values in read_all(shard).items():
        np.testing.assert_array_equal(found[name], values)


def test_flipped_bit_in_the_index_of_chunks_gives_the_right_values_or_an_error(shard):
    expected, data = read_all(shard), shard.read_bytes()
    rng, found = random.Random(0), {"right": 0, "error": 0}
    for name in ("image", "rotation"):
        bits = ChunkIndex(shard, name).bits(COUNT if name == "image" else 1)
        for bit in rng.sample(bits, 250):
            changed = bytearray(data)
            changed[bit // 8] ^= 1 << bit % 8
            shard.write_bytes(changed)
            try:
                for each, values in read_all(shard).items():
                    np.testing.assert_array_equal(values, expected[each])
                found["right"] += 1
            except DataError:
                found["error"] += 1
    assert min(found.values()) > 25


# The digest of the contents


def digest_of(path):
    with open_shard(path) as shard:
        return content_sha256(shard)


def test_content_digest_is_over_names_types_shapes_and_values(shard):
    digest = hashlib.sha256()
    with h5py.File(shard) as file:
        for name, (dtype, shape) in LAYOUT.items():
            digest.update(f"{name} {dtype} {shape}\n".encode() + file[name][...].tobytes())
        group = file.attrs["symmetry_group"]
    digest.update(f"symmetry_group <f8 {group.shape}\n".encode() + group.tobytes())
    assert digest_of(shard) == digest.hexdigest() == build().content_sha256


@pytest.mark.parametrize("version", ["earliest", "v108", "latest"])
def test_content_digest_does_not_depend_on_compression_and_library(shard, tmp_path, version):
    with h5py.File(shard) as file, h5py.File(tmp_path / "other.h5", "w", libver=version) as other:
        other.attrs.update(file.attrs)
        for name in file:
            put(other, name, file[name][...], compression_opts=9)
    assert (tmp_path / "other.h5").read_bytes() != shard.read_bytes()
    assert digest_of(tmp_path / "other.h5") == digest_of(shard)


@pytest.mark.parametrize("name", LAYOUT)
def test_content_digest_depends_on_every_value(shard, name):
    with h5py.File(shard, "r+") as file:
        values = file[name][...]
        last = values.reshape(-1)[-1:]
        last[...] = ~last if values.dtype == bool else last + 1
        file[name][...] = values
    assert digest_of(shard) != build().content_sha256


def test_content_digest_depends_on_the_group(shard):
    group = GROUP.copy()
    group[-1, -1, -1] = np.nextafter(1.0, 2.0)
    with h5py.File(shard, "r+") as file:
        change_group(file, lambda _: group)
    assert digest_of(shard) == build(group=group).content_sha256 != build().content_sha256


def test_content_digest_does_not_depend_on_the_header():
    assert build(header(seed=8)).content_sha256 == build(header()).content_sha256


# What is no shard


@pytest.mark.parametrize(
    "data", [b"", b"P", b"\x89HDF\r\n\x1a\n", b"split,index\n" * 500, b"\x89HDF\r\n\x1a\n" + bytes(4000)]
)
def test_file_that_is_no_hdf5_is_refused(tmp_path, data):
    path = tmp_path / "test-00000-of-00001.h5"
    path.write_bytes(data)
    assert "cannot be read as HDF5" in refusal(path)


def test_folder_missing_file_and_what_is_no_regular_file_are_refused(tmp_path):
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "zero").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "fifo")
    expected = {
        tmp_path: "is a folder, where a file belongs",
        tmp_path / "absent.h5": "no such shard",
        tmp_path / "fifo": "is no regular file",
        tmp_path / "zero": "is no regular file",
        tmp_path / "loop": "Too many levels of symbolic links",
        tmp_path / ("x" * 300): "File name too long",
    }
    assert {path: words for path, words in expected.items() if words not in refusal(path)} == {}


@pytest.mark.parametrize("kept", [0.01, 0.3, 0.5, 0.9, 0.9999])
def test_truncated_shard_is_refused(shard, kept):
    data = shard.read_bytes()
    shard.write_bytes(data[: int(kept * len(data))])
    assert "cannot be read as HDF5" in refusal(shard)


def test_shard_with_a_flipped_bit_opens_or_is_refused_and_nothing_else(shard):
    data = shard.read_bytes()
    rng = random.Random(0)
    raised = {}
    with shard.open("r+b", buffering=0) as file:
        for bit in rng.sample(range(8 * len(data)), 300):
            byte = bit // 8
            file.seek(byte)
            file.write(bytes([data[byte] ^ 1 << bit % 8]))
            try:
                with open_shard(shard):
                    pass
            except DataError:
                pass
            except Exception as error:  # noqa: BLE001 - which ones there are is what the test is about
                raised.setdefault(type(error).__name__, []).append(bit)
            file.seek(byte)
            file.write(data[byte : byte + 1])
    assert raised == {}
    assert shard.read_bytes() == data


def test_shard_is_closed_after_use_and_after_refusal(shard):
    with open_shard(shard) as opened:
        assert descriptors(shard) == [str(shard)]
    assert descriptors(shard) == []
    with pytest.raises(DataError, match="rotation cannot be read"):
        opened.read("rotation")
    with h5py.File(shard, "r+") as file:
        extra_data_set(file, None)
    with pytest.raises(DataError) as refused, open_shard(shard):
        pass
    assert descriptors(shard) == [], refused.value  # while its traceback keeps what was not closed


# Size and SHA-256


def test_shard_of_the_right_bytes_opens(shard):
    data = shard.read_bytes()
    assert len(opened_shard(shard, hashlib.sha256(data).hexdigest(), len(data))) == COUNT


@pytest.mark.parametrize(
    "change", [lambda data: data + b"\0", lambda data: data[:-1], lambda data: b"", lambda data: b"x"]
)
def test_shard_of_another_size_is_refused_with_both(shard, change):
    data = shard.read_bytes()
    shard.write_bytes(change(data))
    with pytest.raises(
        DataError, match=rf"is damaged: expected {len(data)} bytes, found {len(change(data))}.*--repair"
    ):
        opened_shard(shard, hashlib.sha256(data).hexdigest(), len(data))


def test_any_flipped_bit_is_found_by_the_digest_and_hdf5_never_sees_it(shard, monkeypatch):
    data = shard.read_bytes()
    sha256 = hashlib.sha256(data).hexdigest()
    monkeypatch.setattr(shards._DESCRIBER, "describe", lambda path: pytest.fail(f"HDF5 was given {path}"))
    for bit in random.Random(0).sample(range(8 * len(data)), 200):
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        shard.write_bytes(changed)
        with pytest.raises(DataError, match=f"is damaged: expected SHA-256 {sha256}, found .*symsol-annot verify"):
            opened_shard(shard, sha256, len(data))


def test_shard_that_is_replaced_while_it_is_opened_is_an_error(shard, tmp_path, monkeypatch):
    """Else the places of one file's chunks would be read in another."""
    other = tmp_path / "other.h5"
    other.write_bytes(build(header(seed=8)).data)
    describe = shards._DESCRIBER.describe

    def replace_and_describe(path):
        other.replace(path)
        return describe(path)

    monkeypatch.setattr(shards._DESCRIBER, "describe", replace_and_describe)
    with pytest.raises(DataError, match="was replaced while it was opened; try again"):
        opened_shard(shard)


def test_shard_that_is_a_link_is_read_from_where_it_leads(shard, tmp_path):
    expected = read_all(shard)
    (tmp_path / "store").mkdir()
    links_instead(shard, tmp_path / "store")
    for name, values in read_all(shard).items():
        np.testing.assert_array_equal(values, expected[name])
