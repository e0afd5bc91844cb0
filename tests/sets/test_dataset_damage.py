"""Shards that are damaged, replaced or stored otherwise: an error or the right sample, never another one."""

import os
import pickle
import random
import shutil

import h5py
import pytest
from read_samples import PER_SHARD, TEST_IMAGES, assert_is, expected_samples, indices
from tampering import flip_bit, flip_chunk, put, reseal, tampered

from symsol_annot.errors import DataError
from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets.dataset import load
from symsol_annot.sets.shard import reader as shards
from symsol_annot.sets.verify import verify


def test_set_whose_shards_another_hdf5_wrote_loads_the_same(tetX_set):
    expected = expected_samples(tetX_set)
    for path in tetX_set.glob("test-*.h5"):
        copy = path.with_suffix(".copy")
        with h5py.File(path) as file, h5py.File(copy, "w", libver="latest") as other:
            other.attrs.update(file.attrs)
            for name in file:
                put(other, name, file[name][...], compression_opts=9)
        copy.replace(path)
    reseal(tetX_set)
    for index, sample in enumerate(load(tetX_set)):
        assert_is(sample, index, expected[index])
    assert verify(tetX_set) == []


def test_set_whose_shards_were_stored_in_another_way_is_refused_by_the_name_of_the_fault(tetX_set):
    """Contiguous labels would be HDF5's to read, in this process."""
    with tampered(tetX_set, "test-00001-of-00003.h5") as file:
        values = file["rotation"][...]
        del file["rotation"]
        file["rotation"] = values
    with pytest.raises(DataError, match="'rotation': expected the filters gzip and fletcher32"):
        load(tetX_set)[PER_SHARD]


def test_shard_that_was_replaced_after_its_first_use_is_an_error_and_never_a_sample(tetX_set, monkeypatch):
    monkeypatch.setattr(dataset_module, "MAX_OPEN_SHARDS", 1)
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    assert dataset[0].index == 0
    path = tetX_set / "test-00000-of-00003.h5"
    shutil.copy(path, tetX_set / "copy")
    (tetX_set / "copy").replace(path)
    assert_is(dataset[1], 1, expected[1])  # it is still open
    assert dataset[16].index == 16
    with pytest.raises(
        DataError, match=r"test-00000-of-00003\.h5: was replaced after it was opened; load the set again"
    ):
        dataset[0]
    dataset.close()
    assert_is(dataset[0], 0, expected[0])


def test_shard_that_vanished_after_loading_is_an_error(tetX_set):
    dataset = load(tetX_set)
    (tetX_set / "test-00001-of-00003.h5").unlink()
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: no such shard"):
        dataset[20]


@pytest.mark.parametrize(
    "name", ["image", "segmentation", "rotation", "marking_pixels", "symmetry_mask", "part_pixels"]
)
def test_damaged_chunk_is_an_error_that_names_the_file_and_never_a_sample(tetX_set, name):
    flip_chunk(tetX_set / "test-00001-of-00003.h5", name)
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: is damaged: expected SHA-256 .* --repair"):
        load(tetX_set)[PER_SHARD]
    unchecked = rf"test-00001-of-00003\.h5: .*cannot be read: {name}: "
    with pytest.raises(DataError, match=unchecked):
        load(tetX_set, check=False)[PER_SHARD]
    reseal(tetX_set)
    with pytest.raises(DataError, match=unchecked):
        load(tetX_set)[PER_SHARD]


def test_damaged_image_is_an_error_that_names_its_row_and_the_others_are_read(tetX_set):
    path, expected = tetX_set / "test-00001-of-00003.h5", expected_samples(tetX_set)
    with h5py.File(path) as file:
        chunk = file["image"].id.get_chunk_info_by_coord((5, 0, 0, 0))
    data = bytearray(path.read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 1
    path.write_bytes(data)
    dataset = load(tetX_set, check=False)
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: row 5 cannot be read: image: .*verify"):
        dataset[PER_SHARD + 5]
    for row in (4, 6):
        assert_is(dataset[PER_SHARD + row], PER_SHARD + row, expected[PER_SHARD + row])


@pytest.mark.parametrize("check", [True, False])
@pytest.mark.parametrize("kind", ["pipe", "endless device", "folder"])
def test_what_is_no_file_in_place_of_a_shard_is_an_error_and_not_waited_for(tetX_set, kind, check):
    path = tetX_set / "test-00001-of-00003.h5"
    dataset = load(tetX_set, check=check)
    path.unlink()
    {"pipe": lambda: os.mkfifo(path), "endless device": lambda: path.symlink_to("/dev/zero"), "folder": path.mkdir}[
        kind
    ]()
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: cannot be opened: is (no regular file|a folder)"):
        dataset[20]
    with pytest.raises(DataError, match="1 of 3 test shards are missing"):
        load(tetX_set, check=check)


# Checking


def test_shard_is_read_whole_at_its_first_use_alone_and_not_at_all_where_checking_is_off(tetX_set, monkeypatch):
    hashed, sha256 = [], shards.ByteFile.sha256
    monkeypatch.setattr(shards.ByteFile, "sha256", lambda file: hashed.append(1) or sha256(file))
    monkeypatch.setattr(dataset_module, "MAX_OPEN_SHARDS", 1)
    dataset = load(tetX_set)
    assert hashed == []
    assert indices(dataset) + indices(dataset) == list(range(TEST_IMAGES)) * 2
    assert len(hashed) == 3
    unchecked = load(tetX_set, check=False)
    assert indices(unchecked) == indices(pickle.loads(pickle.dumps(unchecked))[:]) == list(range(TEST_IMAGES))
    assert len(hashed) == 3


def test_any_flipped_bit_is_an_error_where_checking_is_on_and_one_or_right_where_it_is_off(tetX_set):
    path, expected, rng = tetX_set / "test-00001-of-00003.h5", expected_samples(tetX_set), random.Random(0)
    found = {"right": 0, "error": 0}
    for bit in rng.sample(range(8 * path.stat().st_size), 60):
        flip_bit(path, bit)
        with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: is damaged: expected SHA-256"):
            load(tetX_set)[20]
        try:
            with load(tetX_set, check=False) as dataset:
                for index in range(PER_SHARD, 2 * PER_SHARD):
                    assert_is(dataset[index], index, expected[index])
            found["right"] += 1
        except DataError:
            found["error"] += 1
        flip_bit(path, bit)
    assert min(found.values()) > 0
    assert_is(load(tetX_set)[20], 20, expected[20])
