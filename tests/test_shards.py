"""The shard: what h5py alone reads from it, which bytes it is, and which files are refused as one."""

import hashlib
import json
import random
import shutil
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import h5py
import numpy as np
import pytest

from symsol_annot.errors import DataError
from symsol_annot.scene import View
from symsol_annot.shard_header import ShardHeader
from symsol_annot.shard_writer import ImageRecord, ShardWriter
from symsol_annot.shards import content_sha256, open_shard

COUNT, HEIGHT, WIDTH = 5, 12, 16  # not square, so that height and width cannot be swapped
GROUP = np.array([[[c, -s, 0], [s, c, 0], [0, 0, 1]] for c, s in ((1, 0), (0, 1), (-1, 0), (0, -1))], dtype=float)
HEADER = ShardHeader(
    object="mug",
    object_sha256="ab" * 32,
    split="test",
    first_index=32,
    seed=7,
    camera={"distance": 4.0, "focal_px": 27.9, "width": WIDTH, "height": HEIGHT},
    render={"engine": "cycles", "ambient": 0.04},
    tolerance_px=0.25,
    versions={"renderer": "none", "hdf5": "0"},
)
NOTES = {"candidates_drawn": 11, "candidates_within_tolerance": 2}
LAYOUT = {
    "image": ("|u1", (COUNT, HEIGHT, WIDTH, 3)),
    "segmentation": ("|u1", (COUNT, HEIGHT, WIDTH)),
    "rotation": ("<f8", (COUNT, 3, 3)),
    "marking_pixels": ("<f4", (COUNT,)),
    "symmetry_mask": ("|b1", (COUNT, len(GROUP))),
    "symmetry_group": ("<f8", (len(GROUP), 3, 3)),
}


def records(annotated=True):
    """Arbitrary contents: a shard stores what it is given."""
    rng = np.random.default_rng(0)
    return [
        ImageRecord(
            view=View(
                rng.integers(256, size=(HEIGHT, WIDTH, 3), dtype=np.uint8),
                rng.integers(3, size=(HEIGHT, WIDTH), dtype=np.uint8),
                0.0,
            ),
            R_m2c=rng.standard_normal((3, 3)),
            marking_pixels=float(np.float32(rng.random())),
            symmetry_mask=rng.random(len(GROUP)) < 0.5 if annotated else None,
        )
        for _ in range(COUNT)
    ]


def build(header=HEADER, annotated=True, before_image=lambda: None):
    writer = ShardWriter(header, COUNT, GROUP, annotated=annotated)
    try:
        for record in records(annotated):
            before_image()
            writer.add(record)
        return writer.finish(NOTES)
    finally:
        writer.close()


@pytest.fixture
def shard(tmp_path):
    """A good shard that a test may damage."""
    path = tmp_path / "test-00002-of-00003.h5"
    path.write_bytes(build().data)
    return path


def open_files():
    return h5py.h5f.get_obj_count(h5py.h5f.OBJ_ALL, h5py.h5f.OBJ_FILE)


def test_h5py_alone_reads_what_was_written(shard):
    expected = records()
    with h5py.File(shard) as file:
        assert {name: (file[name].dtype.str, file[name].shape) for name in file} == LAYOUT
        for row, record in enumerate(expected):
            np.testing.assert_array_equal(file["image"][row], record.view.rgb)
            np.testing.assert_array_equal(file["segmentation"][row], record.view.segmentation)
            np.testing.assert_array_equal(file["rotation"][row], record.R_m2c)
            assert file["marking_pixels"][row] == record.marking_pixels
            np.testing.assert_array_equal(file["symmetry_mask"][row], record.symmetry_mask)
        np.testing.assert_array_equal(file["symmetry_group"][...], GROUP)


def test_split_without_annotation_has_no_symmetry_mask_and_is_valid(tmp_path):
    path = tmp_path / "train-00000-of-00001.h5"
    path.write_bytes(build(annotated=False).data)
    with open_shard(path) as file:
        assert set(file) == set(LAYOUT) - {"symmetry_mask"}


def test_attributes_say_everything_needed_to_make_the_shard_again(shard):
    with h5py.File(shard) as file:
        found = {name: file.attrs[name] for name in file.attrs}
    for name in ("camera", "render", "versions"):
        found[name] = json.loads(found[name])
    assert found == {
        "format": "symsol-annot shard",
        "format_version": 1,
        "object": "mug",
        "object_sha256": "ab" * 32,
        "split": "test",
        "first_index": 32,
        "seed": 7,
        "camera": HEADER.camera,
        "render": HEADER.render,
        "engine": "cycles",
        "tolerance_px": 0.25,
        "versions": HEADER.versions,
        **NOTES,
    }


def test_tolerance_of_an_object_without_marking_is_nan(tmp_path):
    path = tmp_path / "plain.h5"
    path.write_bytes(build(replace(HEADER, tolerance_px=np.nan)).data)
    with open_shard(path) as file:
        assert np.isnan(file.attrs["tolerance_px"])


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
    with open_shard(path) as file:
        assert content_sha256(file) == made.content_sha256
        np.testing.assert_array_equal(file["image"][0], records()[0].view.rgb)


def test_same_contents_give_the_same_bytes_at_another_time():
    first = build()
    time.sleep(1.1)  # HDF5's times are in seconds
    assert build() == first


def test_same_contents_give_the_same_bytes_in_two_threads_at_once():
    both = threading.Barrier(2, timeout=30)
    with ThreadPoolExecutor(2) as pool:
        shards = [pool.submit(build, before_image=both.wait) for _ in range(2)]
        assert [shard.result() for shard in shards] == [build()] * 2


def test_content_digest_is_over_names_types_shapes_and_values(shard):
    digest = hashlib.sha256()
    with h5py.File(shard) as file:
        for name, (dtype, shape) in LAYOUT.items():
            digest.update(f"{name} {dtype} {shape}\n".encode() + file[name][...].tobytes())
        assert content_sha256(file) == digest.hexdigest() == build().content_sha256


def test_content_digest_does_not_depend_on_compression_and_chunks(shard, tmp_path):
    with h5py.File(shard) as file, h5py.File(tmp_path / "plain.h5", "w", libver="latest") as plain:
        for name in file:
            plain.create_dataset(name, data=file[name][...])
        assert (tmp_path / "plain.h5").read_bytes() != shard.read_bytes()
        assert content_sha256(plain) == content_sha256(file)


@pytest.mark.parametrize("name", LAYOUT)
def test_content_digest_depends_on_every_value(shard, name):
    with h5py.File(shard, "r+") as file:
        values = file[name][...]
        last = values.reshape(-1)[-1:]
        last[...] = ~last if values.dtype == bool else last + 1
        file[name][...] = values
        assert content_sha256(file) != build().content_sha256


def test_content_digest_does_not_depend_on_the_header():
    assert build(replace(HEADER, seed=8)).content_sha256 == build().content_sha256


def replaced(name, **how):
    """A tampering: the same values, or others, stored in another way."""

    def tamper(file, whole):
        data = how.get("data", file[name][...])
        del file[name]
        file.create_dataset(name, **{"data": data, **how})

    return tamper


def external_link(file, whole):
    del file["image"]
    file["image"] = h5py.ExternalLink(str(whole), "/image")


def soft_link(file, whole):
    file.move("image", "elsewhere")
    file["image"] = h5py.SoftLink("/elsewhere")


def dangling_link(file, whole):
    del file["symmetry_mask"]
    file["symmetry_mask"] = h5py.SoftLink("/nowhere")


def external_storage(file, whole):
    shape, size = file["image"].shape, file["image"].nbytes
    del file["image"]
    file.create_dataset("image", shape, "u1", external=[(str(whole), 0, size)])


def virtual(file, whole):
    shape = file["image"].shape
    del file["image"]
    layout = h5py.VirtualLayout(shape, "u1")
    layout[:] = h5py.VirtualSource(str(whole), "image", shape)
    file.create_virtual_dataset("image", layout)


def extra_data_set(file, whole):
    file["thumbnail"] = np.zeros(3)


def group_in_place_of_a_data_set(file, whole):
    del file["rotation"]
    file.create_group("rotation")


def type_in_place_of_a_data_set(file, whole):
    del file["rotation"]
    file["rotation"] = np.dtype("f8")


def type_that_numpy_lacks(file, whole):
    del file["marking_pixels"]
    space = h5py.h5s.create_simple((COUNT,))
    h5py.h5d.create(file.id, b"marking_pixels", h5py.h5t.UNIX_D64LE, space)


def no_rows(file, whole):
    for name in set(file) - {"symmetry_group"}:
        dtype, shape = file[name].dtype, file[name].shape
        del file[name]
        file.create_dataset(name, (0, *shape[1:]), dtype)


def more_rows_than_memory(file, whole):
    for name in set(file) - {"symmetry_group"}:
        dtype, shape = file[name].dtype, file[name].shape
        del file[name]
        file.create_dataset(name, (10**12, *shape[1:]), dtype, chunks=(1, *shape[1:]))


def group_larger_than_memory(file, whole):
    for name in ("symmetry_group", "symmetry_mask"):
        del file[name]
    file.create_dataset("symmetry_group", (40_000_000, 3, 3), "f8", chunks=(4096, 3, 3), compression="gzip")


def without(name):
    def tamper(file, whole):
        del file[name]

    return tamper


STRANGERS = {
    "external link": (external_link, ["'image' is a link"]),
    "soft link": (soft_link, ["'image' is a link", "'elsewhere' is not part of the format"]),
    "link to nowhere": (dangling_link, ["'symmetry_mask' is a link"]),
    "external storage": (external_storage, ["'image'", "outside the file"]),
    "virtual data set": (virtual, ["'image'", "outside the file"]),
    "extra data set": (extra_data_set, ["'thumbnail' is not part of the format"]),
    "group": (group_in_place_of_a_data_set, ["'rotation' is no data set"]),
    "named type": (type_in_place_of_a_data_set, ["'rotation' is no data set"]),
    "more rows than memory": (more_rows_than_memory, ["'rotation'", "1000000000000"]),
    "group larger than memory": (group_larger_than_memory, ["'symmetry_group'", "beyond the format's limits"]),
    "no rows": (no_rows, ["'rotation'", "(0, 3, 3)"]),
    "float32 labels": (replaced("rotation", dtype="f4"), ["'rotation'", "<f8", "<f4"]),
    "big-endian labels": (replaced("rotation", dtype=">f8"), ["'rotation'", ">f8"]),
    "wide pixels": (replaced("image", dtype="u2"), ["'image'", "<u2"]),
    "integer mask": (replaced("symmetry_mask", dtype="u1"), ["'symmetry_mask'", "|b1"]),
    "object type": (
        replaced("marking_pixels", data=["1"] * COUNT, dtype=h5py.string_dtype()),
        ["'marking_pixels'", "|O"],
    ),
    "vlen type": (
        replaced("marking_pixels", data=None, shape=(COUNT,), dtype=h5py.vlen_dtype("f4")),
        ["'marking_pixels'"],
    ),
    "compound type": (
        replaced("marking_pixels", data=np.zeros(COUNT, dtype=[("px", "<f4")])),
        ["'marking_pixels'", "|V4"],
    ),
    "type that numpy lacks": (type_that_numpy_lacks, ["'marking_pixels'"]),
    "transposed images": (
        replaced("image", data=np.zeros((COUNT, WIDTH, HEIGHT, 3), "u1")),
        ["'image'", "(5, 16, 12, 3)"],
    ),
    "short mask": (replaced("symmetry_mask", data=np.ones((COUNT, 3), bool)), ["'symmetry_mask'", "(5, 3)"]),
    "long segmentation": (
        replaced("segmentation", data=np.zeros((COUNT + 1, HEIGHT, WIDTH), "u1")),
        ["'segmentation'", "(6, 12, 16)"],
    ),
    "scalar": (replaced("marking_pixels", data=np.float32(1)), ["'marking_pixels'", "()"]),
    "empty": (replaced("marking_pixels", data=h5py.Empty("f4")), ["'marking_pixels'"]),
    "lzf": (replaced("image", compression="lzf"), ["'image'", "filter"]),
    "scaleoffset": (replaced("image", scaleoffset=0), ["'image'", "filter"]),
    **{f"no {name}": (without(name), [f"{name!r} is missing"]) for name in LAYOUT if name != "symmetry_mask"},
}


@pytest.mark.parametrize("case", STRANGERS)
def test_strangers_file_is_refused_by_the_name_of_its_fault(shard, tmp_path, case):
    tamper, words = STRANGERS[case]
    whole = shutil.copy(shard, tmp_path / "whole.h5")  # so that what a link leads to is as expected
    with h5py.File(shard, "r+") as file:
        tamper(file, whole)
    with pytest.raises(DataError) as refusal, open_shard(shard):
        pass
    assert [word for word in [str(shard), *words] if word not in str(refusal.value)] == []


@pytest.mark.parametrize("name", [*HEADER.to_attributes(), *NOTES])
def test_missing_attribute_is_refused(shard, name):
    with h5py.File(shard, "r+") as file:
        del file.attrs[name]
    with pytest.raises(DataError, match=f"'{name}'"), open_shard(shard):
        pass


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("format", "another format"),
        ("format", ["symsol-annot shard", "symsol-annot shard"]),
        ("format_version", 0),
        ("format_version", [1, 2]),
        ("format_version", "1"),
        ("object", 3),
        ("split", [1.0, 2.0]),
        ("first_index", "first"),
        ("first_index", [0, 1]),
        ("seed", [0, 1]),
        ("tolerance_px", "five"),
        ("candidates_drawn", "many"),
    ],
)
def test_attribute_of_a_wrong_value_or_type_is_refused(shard, name, value):
    with h5py.File(shard, "r+") as file:
        file.attrs[name] = value
    with pytest.raises(DataError, match=f"'{name}'"), open_shard(shard):
        pass


@pytest.mark.parametrize(
    "camera",
    [
        "",
        "four",
        "[]",
        "3",
        "{}",
        '{"width": 16}',
        '{"width": 16, "height": null}',
        '{"width": 16, "height": Infinity}',
        7,
        ["{}", "{}"],
    ],
)
def test_camera_that_is_no_json_with_a_size_is_refused(shard, camera):
    with h5py.File(shard, "r+") as file:
        file.attrs["camera"] = camera
    with pytest.raises(DataError, match="'camera'"), open_shard(shard):
        pass


def test_newer_format_is_refused_with_both_versions(shard):
    with h5py.File(shard, "r+") as file:
        file.attrs["format_version"] = 2
    with pytest.raises(DataError, match=r"of format version 2, newer than 1, .* update it"), open_shard(shard):
        pass


def test_all_faults_are_listed_not_the_first(shard):
    with h5py.File(shard, "r+") as file:
        for name in ("seed", "engine"):
            del file.attrs[name]
        extra_data_set(file, None)
        soft_link(file, None)
    with pytest.raises(DataError) as refusal, open_shard(shard):
        pass
    assert [
        word for word in ("seed", "engine", "thumbnail", "'image'", "elsewhere") if word not in str(refusal.value)
    ] == []


@pytest.mark.parametrize(
    "data", [b"", b"P", b"\x89HDF\r\n\x1a\n", b"split,index\n" * 500, b"\x89HDF\r\n\x1a\n" + bytes(4000)]
)
def test_file_that_is_no_hdf5_is_refused(tmp_path, data):
    path = tmp_path / "test-00000-of-00001.h5"
    path.write_bytes(data)
    with pytest.raises(DataError, match="cannot be read as HDF5"), open_shard(path):
        pass


def test_folder_and_missing_file_are_refused(tmp_path):
    with pytest.raises(DataError, match="is no regular file"), open_shard(tmp_path):
        pass
    with pytest.raises(DataError, match=r"absent\.h5: no such shard"), open_shard(tmp_path / "absent.h5"):
        pass


@pytest.mark.parametrize("kept", [0.01, 0.3, 0.5, 0.9, 0.9999])
def test_truncated_shard_is_refused(shard, kept):
    data = shard.read_bytes()
    shard.write_bytes(data[: int(kept * len(data))])
    with pytest.raises(DataError, match="cannot be read as HDF5"), open_shard(shard):
        pass


def test_shard_with_a_flipped_bit_opens_or_is_refused_and_nothing_else(shard):
    data = shard.read_bytes()
    rng = random.Random(0)
    raised = {}
    with shard.open("r+b", buffering=0) as file:
        for bit in rng.sample(range(8 * len(data)), 1000):
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
    before = open_files()
    with open_shard(shard):
        assert open_files() == before + 1
    assert open_files() == before
    with h5py.File(shard, "r+") as file:
        extra_data_set(file, None)
    with pytest.raises(DataError) as refusal, open_shard(shard):
        pass
    assert open_files() == before, refusal.value  # while its traceback keeps what was not closed
