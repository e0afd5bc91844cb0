"""The shard as it is written: what h5py alone reads from it, and which bytes it is."""

import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest
from made_shards import COUNT, GROUP, HEADER, HEIGHT, LAYOUT, NOTES, WIDTH, build, records

from symsol_annot.sets.shard.reader import content_sha256, open_shard
from symsol_annot.sets.shard.writer import ShardWriter


def test_h5py_alone_reads_what_was_written(shard):
    expected = records()
    with h5py.File(shard) as file:
        assert {name: (file[name].dtype.str, file[name].shape) for name in file} == LAYOUT
        for row, record in enumerate(expected):
            np.testing.assert_array_equal(file["image"][row], record.view.rgb)
            np.testing.assert_array_equal(file["segmentation"][row], record.view.segmentation)
            np.testing.assert_array_equal(file["rotation"][row], record.R_m2c)
            assert file["marking_pixels"][row] == record.coset_px
            np.testing.assert_array_equal(file["symmetry_mask"][row], record.symmetry_mask)
        np.testing.assert_array_equal(file["symmetry_group"][...], GROUP)


def test_chunk_holds_one_image(shard):
    with h5py.File(shard) as file:
        assert file["image"].chunks == (1, HEIGHT, WIDTH, 3)
        assert file["segmentation"].chunks == (1, HEIGHT, WIDTH)


def test_every_data_set_has_gzip_and_fletcher32_and_no_other_filter(shard):
    with h5py.File(shard) as file:
        for name in file:
            plist = file[name].id.get_create_plist()
            filters = [plist.get_filter(i)[0] for i in range(plist.get_nfilters())]
            assert filters == [h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_FLETCHER32], name


def test_file_is_of_the_oldest_format_so_that_old_readers_read_it(shard):
    data = shard.read_bytes()
    assert data[:8] == b"\x89HDF\r\n\x1a\n"
    assert data[8] == 0, "superblock version"
    newer_structures = (b"OHDR", b"BTHD", b"FRHP", b"FADB", b"EAHD", b"FAHD", b"SMTB")
    assert not [mark for mark in newer_structures if mark in data]


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
    writer = ShardWriter(HEADER, COUNT, GROUP, annotated=True)
    for view in (
        replace(good.view, rgb=good.view.rgb[:-1]),
        replace(good.view, rgb=good.view.rgb.astype("f4")),
        replace(good.view, segmentation=good.view.segmentation.T),
    ):
        with pytest.raises(ValueError, match=r"expected uint8 \(1, 12, 16"):
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


def test_same_contents_give_the_same_bytes_at_another_time():
    first = build()
    time.sleep(1.1)  # HDF5's times are in seconds
    assert build() == first


def test_same_contents_give_the_same_bytes_in_two_threads_at_once():
    both = threading.Barrier(2, timeout=30)
    with ThreadPoolExecutor(2) as pool:
        shards = [pool.submit(build, before_image=both.wait) for _ in range(2)]
        assert [shard.result() for shard in shards] == [build()] * 2
