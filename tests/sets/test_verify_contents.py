"""Checking a set: what its arrays and attributes cannot say is found and named, though every checksum is right."""

import re
import shutil

import h5py
import numpy as np
import pytest
from made_sets import make_set
from tampered_shards import FIRST_INDEX, SECOND, SHARDS, rows, tampered
from tampering import ChunkIndex, change_group, flip_bit, flip_chunk, put, reseal

from symsol_annot.errors import DataError
from symsol_annot.sets.dataset import load
from symsol_annot.sets.verify import verify

# A label that is transposed, or turned by any other rotation, is a rotation still: only drawing the image again shows
# it (`--audit`).


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


def test_stabiliser_that_is_not_that_of_the_other_shards_is_found(tetX_set):
    """By itself the shard obeys the laws: the identity alone is a subgroup, and every set is a union of its cosets."""
    with tampered(tetX_set) as shard:
        mask = shard["symmetry_mask"][...]
        mask[rows(shard, shown=True), 1:] = False
        shard["symmetry_mask"][...] = mask
    (fault,) = verify(tetX_set)
    assert re.fullmatch(
        rf"{SECOND}: symmetry_mask: the set of the images that show the marking is not that of {SHARDS[0]}: "
        r"element 0 of symmetry_group, expected element 0, \d+, \d+",
        fault,
    )
    with load(tetX_set) as dataset, pytest.raises(DataError, match=f"{SECOND}: the set of its images that show"):
        dataset.labels()


def test_shard_that_shows_no_marking_says_nothing_of_its_stabiliser(tetX_set):
    with tampered(tetX_set, SHARDS[0]) as shard:
        hidden = rows(shard, shown=False)[0]
        for name in ("marking_pixels", "part_pixels", "symmetry_mask"):
            shard[name][...] = np.repeat(shard[name][hidden][None], len(shard[name]), axis=0)
    assert verify(tetX_set) == []


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


def test_shards_made_with_different_software_are_found(tetX_set):
    with tampered(tetX_set) as shard:
        shard.attrs["versions"] = '{"renderer": "another"}'
    (fault,) = verify(tetX_set)
    assert fault.startswith(f"{SECOND}: versions: made with other software")
