"""Checking a set: every fault that can be put into one is found and named, and a good set has none."""

import os
import random
import shutil
from contextlib import contextmanager
from dataclasses import replace

import h5py
import numpy as np
import pytest
import tampering
from made_sets import make_set
from tampering import ChunkIndex, change_group, flip_bit, flip_chunk, put, reseal

from symsol_annot.errors import DataError
from symsol_annot.sets import verify as verify_module
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.shard import reader as shards
from symsol_annot.sets.verify import verify

SHARDS = ("test-00000-of-00003.h5", "test-00001-of-00003.h5", "test-00002-of-00003.h5", "train-00000-of-00001.h5")
SECOND, FIRST_INDEX = SHARDS[1], 16  # the shard that is tampered with, and the index of its first image
TOLERANCE_PX = 5.0


@contextmanager
def tampered(folder, file=SECOND):
    """Open a shard for editing, and reseal the set."""
    with tampering.tampered(folder, file) as shard:
        yield shard


def rows(shard, shown):
    """The rows whose image shows the marking, or hides it."""
    return np.flatnonzero((shard["marking_pixels"][...] >= TOLERANCE_PX) == shown)


def state(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


@pytest.mark.parametrize(
    "plan", [{"name": "tetX"}, {"name": "tet", "annotate": "all", "train": 2}, {"annotate": "none"}]
)
def test_good_set_has_no_faults(tmp_path, plan):
    assert verify(make_set(tmp_path, **{"test": 20, "size": 16, **plan})) == []


def test_resealed_set_has_no_faults(tetX_set):
    # else the tests of tampering would find what the sealing did
    with tampered(tetX_set) as shard:
        assert len(rows(shard, shown=True)) >= 2
        assert len(rows(shard, shown=False)) >= 2
    assert verify(tetX_set) == []


def test_set_is_read_and_never_written(tetX_set):
    before = state(tetX_set)
    verify(tetX_set)
    assert state(tetX_set) == before
    flip_bit(tetX_set / SECOND, 10_000)
    before = state(tetX_set)
    assert verify(tetX_set)
    assert state(tetX_set) == before


def test_progress_counts_every_shard_once(tetX_set):
    (tetX_set / SECOND).unlink()
    counted = []
    verify(tetX_set, lambda: counted.append(1))
    assert len(counted) == len(SHARDS)


def test_any_flipped_bit_is_found_and_its_shard_named(tetX_set):
    rng = random.Random(0)
    for _ in range(60):
        bits = {tetX_set / name: rng.randrange(8 * (tetX_set / name).stat().st_size) for name in SHARDS}
        for path, bit in bits.items():
            flip_bit(path, bit)
        faults = verify(tetX_set)
        assert sorted(fault.split(": expected SHA-256 ")[0] for fault in faults) == [f"{n}: is damaged" for n in SHARDS]
        for path, bit in bits.items():
            flip_bit(path, bit)
    assert verify(tetX_set) == []


@pytest.mark.parametrize("name", SHARDS)
def test_one_flipped_bit_is_one_fault(tetX_set, name):
    flip_bit(tetX_set / name, 100_000)
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{name}: is damaged: expected SHA-256 ")


@pytest.mark.parametrize("size", [0, 1, 10_000, -1])
def test_truncated_shard_is_found_with_both_sizes(tetX_set, size):
    data = (tetX_set / SECOND).read_bytes()
    (tetX_set / SECOND).write_bytes(data[:size])
    assert verify(tetX_set) == [f"{SECOND}: is damaged: expected {len(data)} bytes, found {len(data[:size])}"]


def test_shard_that_grew_is_found(tetX_set):
    data = (tetX_set / SECOND).read_bytes()
    (tetX_set / SECOND).write_bytes(data + b"\0")
    assert verify(tetX_set) == [f"{SECOND}: is damaged: expected {len(data)} bytes, found {len(data) + 1}"]


def test_missing_shard_is_found(tetX_set):
    (tetX_set / SECOND).unlink()
    assert verify(tetX_set) == [f"{SECOND}: is missing or cannot be read: No such file or directory"]


def test_folder_in_place_of_a_shard_is_found(tetX_set):
    (tetX_set / SECOND).unlink()
    (tetX_set / SECOND).mkdir()
    assert verify(tetX_set) == [f"{SECOND}: is missing or cannot be read: is a folder, where a file belongs"]


def test_extra_shard_is_found(tetX_set):
    shutil.copy(tetX_set / SECOND, tetX_set / "test-00003-of-00003.h5")
    assert verify(tetX_set) == ["test-00003-of-00003.h5: is no shard of this set; move it elsewhere"]


def test_shards_that_changed_places_are_found(tetX_set):
    (tetX_set / SHARDS[0]).rename(tetX_set / "aside")
    (tetX_set / SHARDS[1]).rename(tetX_set / SHARDS[0])
    (tetX_set / "aside").rename(tetX_set / SHARDS[1])
    faults = verify(tetX_set)
    assert [fault.split(": is damaged")[0] for fault in faults] == [SHARDS[0], SHARDS[1]]


def test_unfinished_set_is_found(tetX_set):
    manifest = read_manifest(tetX_set)
    entries = [entry for entry in manifest.shards if entry.split == "test"][1:]
    for entry in entries:
        (tetX_set / entry.file).unlink()
        manifest = manifest.with_finished(replace(entry, bytes=None, sha256=None, content_sha256=None))
    write_manifest(tetX_set, manifest)
    assert verify(tetX_set) == [
        f"{entry.file}: was never finished; the same render command makes it" for entry in entries
    ]


@pytest.mark.parametrize("data", [None, b"", b"{}", b"\xff"])
def test_folder_without_a_readable_manifest_is_an_error(tetX_set, data):
    (tetX_set / "manifest.json").unlink()
    if data is not None:
        (tetX_set / "manifest.json").write_bytes(data)
    with pytest.raises(DataError, match=r"manifest\.json"):
        verify(tetX_set)


def test_damaged_shard_is_never_handed_to_hdf5(tetX_set, monkeypatch):
    def refuse(*arguments, **options):
        pytest.fail(f"HDF5 was given {arguments}")

    for number, name in enumerate(SHARDS):
        flip_bit(tetX_set / name, 10_000 + number)
    owners = ((h5py, "File"), (verify_module, "open_shard"), (shards._DESCRIBER, "describe"))
    for owner, name in owners:
        monkeypatch.setattr(owner, name, refuse)
    faults = verify(tetX_set)
    assert sorted(fault.split(":")[0] for fault in faults) == sorted(SHARDS)


# From here on every checksum is right: what is found is found in what the arrays say. A label that is transposed,
# or turned by any other rotation, is a rotation still: only drawing the image again shows it (`--audit`).


def scaled(R):
    return 1.001 * R


def reflected(R):
    return R * np.array([1, 1, -1])


def slightly_off(R):
    return R + 1e-7 * np.ones((3, 3))


def not_a_number(R):
    return np.where(np.eye(3) > 0, np.nan, R)


def zero(R):
    return 0 * R


def infinite(R):
    return R + np.inf


@pytest.mark.parametrize("spoil", [reflected, scaled, slightly_off, not_a_number, infinite, zero])
def test_label_that_is_no_rotation_is_found(tetX_set, spoil):
    with tampered(tetX_set) as shard:
        shard["rotation"][3] = spoil(shard["rotation"][3])
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: rotation: image {FIRST_INDEX + 3}: is no rotation")


@pytest.mark.parametrize("identifier", [3, 4, 255])
def test_segmentation_id_that_does_not_exist_is_found(tetX_set, identifier):
    with tampered(tetX_set) as shard:
        shard["segmentation"][15, 31, 0] = identifier  # a single pixel of the last image
    (fault,) = verify(tetX_set)
    assert fault == f"{SECOND}: segmentation: image {FIRST_INDEX + 15}: holds an id outside 0, 1, 2, or no object"


def test_segmentation_without_the_object_is_found(tetX_set):
    with tampered(tetX_set) as shard:
        shard["segmentation"][2] = 0
    (fault,) = verify(tetX_set)
    assert fault == f"{SECOND}: segmentation: image {FIRST_INDEX + 2}: holds an id outside 0, 1, 2, or no object"


@pytest.mark.parametrize("area", [-1.0, -0.25, np.nan, np.inf])
def test_marking_pixels_that_are_no_area_are_found(tetX_set, area):
    with tampered(tetX_set) as shard:
        row = rows(shard, shown=area > 0)[-1]  # the sets are those of the area that the value stands for
        shard["marking_pixels"][row] = area
        shard["part_pixels"][row, 1] = 0
    (fault,) = verify(tetX_set)
    assert fault == f"{SECOND}: marking_pixels: image {FIRST_INDEX + row}: is no area"


@pytest.mark.parametrize("shown", [True, False])
def test_set_that_lacks_the_images_own_rotation_is_found(tetX_set, shown):
    with tampered(tetX_set) as shard:
        row = rows(shard, shown=shown)[1]
        shard["symmetry_mask"][row, 0] = False
    faults = verify(tetX_set)
    assert f"{SECOND}: symmetry_mask: image {FIRST_INDEX + row}: the set lacks R_gt, the image's own rotation" in faults


@pytest.mark.parametrize("grows", [True, False])
def test_images_that_show_the_marking_with_different_sets_are_found(tetX_set, grows):
    with tampered(tetX_set) as shard:
        row = rows(shard, shown=True)[-1]
        mask = shard["symmetry_mask"][row]
        element = np.flatnonzero(mask != grows)[-1]
        mask[element] = grows
        shard["symmetry_mask"][row] = mask
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: symmetry_mask: images that show the marking have different sets")


def test_set_of_a_hidden_marking_that_lacks_a_rotation_of_the_stabiliser_is_found(tetX_set):
    with tampered(tetX_set) as shard:
        stabiliser = np.flatnonzero(shard["symmetry_mask"][rows(shard, shown=True)[0]])
        row = rows(shard, shown=False)[0]
        shard["symmetry_mask"][row, stabiliser[-1]] = False
    (fault,) = verify(tetX_set)
    assert fault.startswith(
        f"{SECOND}: symmetry_mask: image {FIRST_INDEX + row}: the set lacks a rotation that differs"
    )


def test_set_of_a_body_without_marking_that_is_not_its_whole_group_is_found(tmp_path):
    folder = make_set(tmp_path, "tet", test=4, size=16)
    with tampered(folder, "test-00000-of-00001.h5") as shard:
        shard["symmetry_mask"][2, 7] = False
    (fault,) = verify(folder)
    assert "symmetry_mask" in fault


def test_group_that_does_not_begin_with_the_identity_is_found(tetX_set):
    with tampered(tetX_set) as shard:
        change_group(shard, lambda group: group[::-1])
    assert f"{SECOND}: symmetry_group: element 0 is not the identity" in verify(tetX_set)


@pytest.mark.parametrize("spoil", [reflected, scaled, not_a_number])
def test_group_element_that_is_no_rotation_is_found(tetX_set, spoil):
    with tampered(tetX_set) as shard:
        change_group(shard, lambda group: np.concatenate([group[:5], spoil(group[5])[None], group[6:]]))
    assert f"{SECOND}: symmetry_group: element 5 is no rotation" in verify(tetX_set)


def test_group_that_is_not_that_of_the_other_shards_is_found(tetX_set):
    with tampered(tetX_set) as shard:
        change_group(shard, lambda group: np.concatenate([group[:1], group[:0:-1]]))
    assert [fault for fault in verify(tetX_set) if "symmetry_group" in fault]


HEADER_CHANGES = {
    "object": "mug",
    "object_sha256": "0" * 64,
    "seed": 1,
    "split": "train",
    "first_index": 17,
    "camera": '{"distance": 4.0, "focal_px": 99.0, "height": 32, "width": 32}',
    "render": '{"engine": "opengl"}',
    "engine": "cycles",
    "tolerance_px": 1e9,
}


@pytest.mark.parametrize("name", HEADER_CHANGES)
def test_header_that_disagrees_with_the_manifest_is_found(tetX_set, name):
    with tampered(tetX_set) as shard:
        shard.attrs[name] = HEADER_CHANGES[name]
    faults = verify(tetX_set)
    assert [fault for fault in faults if fault.startswith(SECOND) and name in fault]


def test_number_of_images_that_disagrees_with_the_manifest_is_found(tetX_set):
    reseal(tetX_set, **{SHARDS[2]: {"images": 7}})
    assert verify(tetX_set) == [f"{SHARDS[2]}: expected 7 images, found 8"]


@pytest.mark.parametrize("file", [SHARDS[0], SHARDS[3]])
def test_symmetry_sets_that_disagree_with_the_manifest_are_found(tetX_set, file):
    with tampered(tetX_set, file) as shard:
        if "symmetry_mask" in shard:
            del shard["symmetry_mask"]
        else:
            put(shard, "symmetry_mask", np.ones((5, 12), dtype=bool))
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{file}: symmetry_mask: manifest and shard disagree")


def test_arrays_that_do_not_have_their_content_digest_are_found(tetX_set):
    reseal(tetX_set, **{SECOND: {"content_sha256": "0" * 64}})
    assert verify(tetX_set) == [f"{SECOND}: its arrays do not have the digest content_sha256 {'0' * 64}"]


def test_foreign_file_under_a_shards_name_is_found(tetX_set):
    with tampered(tetX_set) as shard:
        shard["thumbnail"] = np.zeros(3)
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: ")
    assert "'thumbnail' is not part of the format" in fault


def test_file_that_is_no_hdf5_under_a_shards_name_is_found(tetX_set):
    (tetX_set / SECOND).write_bytes(b"split,index\n" * 500)
    reseal(tetX_set)
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: ")
    assert "cannot be read as HDF5" in fault


@pytest.mark.parametrize("name", ["image", "segmentation", "rotation", "part_pixels"])
def test_chunk_that_hdf5_cannot_read_is_found(tetX_set, name):
    flip_chunk(tetX_set / SECOND, name)
    reseal(tetX_set)
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: ")
    assert f"cannot be read: {name}: " in fault


def test_chunk_that_the_index_does_not_find_is_found(tetX_set):
    """HDF5 gives zeros for it, and says nothing."""
    ChunkIndex(tetX_set / SECOND, "symmetry_mask").change_offset(0, 0, 16)
    with h5py.File(tetX_set / SECOND) as shard:
        assert not shard["symmetry_mask"][...].any()
    reseal(tetX_set)
    (fault,) = verify(tetX_set)
    assert "'symmetry_mask': the file's index is damaged: a chunk is missing, or there twice" in fault


def test_attribute_of_a_wrong_type_is_found(tetX_set):
    for name, value in (("seed", [0, 0]), ("first_index", "first"), ("tolerance_px", "five")):
        with tampered(tetX_set) as shard:
            shard.attrs[name] = value
    assert [fault for fault in verify(tetX_set) if fault.startswith(SECOND)]


def test_at_most_five_images_are_listed_and_the_rest_counted(tetX_set):
    with tampered(tetX_set) as shard:
        shard["rotation"][3:11] = np.zeros((8, 3, 3))
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: rotation: image 19, 20, 21, 22, 23 and 3 more: is no rotation")


def test_all_faults_of_a_set_are_reported_not_the_first(tetX_set):
    with tampered(tetX_set) as shard:
        shard["rotation"][3] = 2 * shard["rotation"][3]
        shard["segmentation"][4] = 0
        shard["marking_pixels"][5] = -1
        change_group(shard, lambda group: group * (np.arange(12) != 6)[:, None, None])
        shard["symmetry_mask"][7, 0] = False
        shard.attrs["seed"] = 1
    flip_bit(tetX_set / SHARDS[0], 10_000)
    (tetX_set / SHARDS[2]).unlink()
    shutil.copy(tetX_set / SECOND, tetX_set / "spare.h5")
    faults = verify(tetX_set)
    expected = [
        ("spare.h5", "no shard of this set"),
        (SHARDS[0], "is damaged"),
        (SECOND, "attribute 'seed': expected 0, found 1"),
        (SECOND, "image 19: is no rotation"),
        (SECOND, "image 20: holds an id"),
        (SECOND, "image 21: is no area"),
        (SECOND, "element 6 is no rotation"),
        (SECOND, "image 23: the set lacks R_gt"),
        (SHARDS[2], "is missing"),
    ]
    for file, words in expected:
        assert [fault for fault in faults if fault.startswith(f"{file}: ") and words in fault], (file, words)


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_shard_that_is_no_regular_file_is_named_and_not_waited_for(tetX_set, kind):
    (tetX_set / SECOND).unlink()
    if kind == "pipe":
        os.mkfifo(tetX_set / SECOND)
    else:
        (tetX_set / SECOND).symlink_to("/dev/zero")
    assert verify(tetX_set) == [f"{SECOND}: is missing or cannot be read: is no regular file"]


def test_shards_made_with_different_software_are_found(tetX_set):
    with tampered(tetX_set) as shard:
        shard.attrs["versions"] = '{"renderer": "another"}'
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: versions: made with other software")
