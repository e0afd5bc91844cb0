"""The shard as it is written: what h5py alone reads from it, and which bytes it is."""

import hashlib
import json
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest
from bench_sets import python
from made_shards import COUNT, DEEP, GROUP, HEADER, HEIGHT, LAYOUT, NOTES, PICTURES, WIDTH, build, header, records

from symsol_annot.rotations.groups import cyclic_group
from symsol_annot.sets.shard.reader import content_sha256, open_shard
from symsol_annot.sets.shard.writer import ShardWriter


def test_h5py_alone_reads_what_was_written(shard):
    expected = records(depth=True)
    with h5py.File(shard) as file:
        assert {name: (file[name].dtype.str, file[name].shape) for name in file} == LAYOUT
        for row, record in enumerate(expected):
            np.testing.assert_array_equal(file["image"][row], record.view.rgb)
            np.testing.assert_array_equal(file["segmentation"][row], record.view.segmentation)
            np.testing.assert_array_equal(file["rotation"][row], record.R_m2c)
            np.testing.assert_array_equal(file["depth"][row], record.view.depth)
            assert file["marking_pixels"][row] == record.coset_px
            np.testing.assert_array_equal(file["part_pixels"][row], record.view.part_pixels)
            np.testing.assert_array_equal(file["symmetry_mask"][row], record.symmetry_mask)
        np.testing.assert_array_equal(file.attrs["symmetry_group"], GROUP)
        assert json.loads(file.attrs["parts"]) == ["body", "marking"]


def test_set_without_depth_has_none_and_a_body_alone_is_one_part(tmp_path):
    path = tmp_path / "shard.h5"
    with ShardWriter(header(tolerance_px=None), 1, GROUP, annotated=True) as writer:
        record = records()[0]
        writer.add(replace(record, view=replace(record.view, part_pixels=np.array([3.25]))))
        path.write_bytes(writer.finish(NOTES).data)
    with h5py.File(path) as file:
        assert set(file) == set(LAYOUT) - {"depth"}
        assert json.loads(file.attrs["parts"]) == ["body"]
        assert file["part_pixels"][...].tolist() == [[3.25]]


def test_every_data_set_has_a_row_per_image_and_a_type_of_fixed_size(shard):
    """So that readers of tables take a shard as it lies."""
    with h5py.File(shard) as file:
        for name in file:
            assert len(file[name]) == COUNT, name
            assert file[name].dtype.kind in "buf", name


def test_chunk_holds_one_image(shard):
    with h5py.File(shard) as file:
        assert {name: file[name].chunks[0] for name in PICTURES} == dict.fromkeys(PICTURES, 1)
        assert file["depth"].chunks == (1, HEIGHT, WIDTH)


def test_every_data_set_has_gzip_and_fletcher32_and_no_other_filter(shard):
    with h5py.File(shard) as file:
        for name in file:
            plist = file[name].id.get_create_plist()
            filters = [plist.get_filter(i)[0] for i in range(plist.get_nfilters())]
            assert filters == [h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32], name


NEWER_STRUCTURES = (b"OHDR", b"BTHD", b"FRHP", b"FADB", b"EAHD", b"FAHD", b"SMTB")
OF_VERSION_1_8 = {b"OHDR", b"BTHD", b"FRHP"}


@pytest.mark.parametrize("order", [4, 900])
def test_file_is_of_the_oldest_format_so_that_old_readers_read_it(order):
    data = build(group=cyclic_group(order)).data
    assert data[:8] == b"\x89HDF\r\n\x1a\n"
    assert data[8] == 0, "superblock version"
    assert not [mark for mark in NEWER_STRUCTURES if mark in data]


@pytest.mark.parametrize("order", [901, 7200])
def test_a_group_that_the_oldest_format_does_not_hold_makes_a_file_of_version_1_8(tmp_path, order):
    group, path = cyclic_group(order), tmp_path / "shard.h5"
    made = build(group=group)
    assert made.data[8] == 2, "superblock version"
    assert {mark for mark in NEWER_STRUCTURES if mark in made.data} == OF_VERSION_1_8
    path.write_bytes(made.data)
    with open_shard(path) as shard:
        np.testing.assert_array_equal(shard.labels().symmetry_group, group)
        assert content_sha256(shard) == made.content_sha256
    with h5py.File(path) as file:
        np.testing.assert_array_equal(file.attrs["symmetry_group"], group)
        assert file["symmetry_mask"].shape == (COUNT, order)


def test_no_data_set_carries_a_time(shard):
    with h5py.File(shard) as file:
        assert {name: h5py.h5g.get_objinfo(file[name].id).mtime for name in file} == dict.fromkeys(LAYOUT, 0)


def test_shard_that_lacks_images_is_not_finished():
    writer = ShardWriter(HEADER, COUNT, GROUP, annotated=True)
    writer.add(records()[0])
    with pytest.raises(ValueError, match=f"made for {COUNT} images and holds 1"):
        writer.finish(NOTES)
    writer.close()


def test_image_of_another_size_or_type_is_refused():
    good = records()[0]
    writer = ShardWriter(DEEP, COUNT, GROUP, annotated=True)
    for view in (
        replace(good.view, rgb=good.view.rgb[:-1]),
        replace(good.view, rgb=good.view.rgb.astype("f4")),
        replace(good.view, segmentation=good.view.segmentation.T),
        replace(good.view, depth=None),
        replace(good.view, depth=np.zeros((HEIGHT, WIDTH))),
    ):
        with pytest.raises(ValueError, match=r"expected (uint8|float32) \(1, 12, 16"):
            writer.add(replace(good, view=view))
    writer.close()


def test_shard_of_one_image_is_valid(tmp_path):
    writer = ShardWriter(HEADER, 1, GROUP, annotated=True)
    writer.add(records()[0])
    made = writer.finish(NOTES)
    writer.close()
    path = tmp_path / "test-00000-of-00001.h5"
    path.write_bytes(made.data)
    with open_shard(path) as shard:
        assert content_sha256(shard) == made.content_sha256
        np.testing.assert_array_equal(next(shard.rows("image")), records()[0].view.rgb)


@pytest.mark.parametrize("order", [4, 1000])
def test_same_contents_give_the_same_bytes_at_another_time(order):
    first = build(group=cyclic_group(order))
    time.sleep(1.1)  # HDF5's times are in seconds
    assert build(group=cyclic_group(order)) == first


@pytest.mark.parametrize("order", [4, 1000])
def test_same_contents_give_the_same_bytes_in_another_process(order):
    code = f"""
import hashlib
from made_shards import build
from symsol_annot.rotations.groups import cyclic_group
print(hashlib.sha256(build(group=cyclic_group({order})).data).hexdigest())
"""
    here = hashlib.sha256(build(group=cyclic_group(order)).data).hexdigest()
    assert python(code).stdout.strip() == here


def test_same_contents_give_the_same_bytes_in_two_threads_at_once():
    both = threading.Barrier(2, timeout=30)
    with ThreadPoolExecutor(2) as pool:
        shards = [pool.submit(build, before_image=both.wait) for _ in range(2)]
        assert [shard.result() for shard in shards] == [build()] * 2
