"""Labels without images: what the samples say, one by one; the split's fingerprint; closing."""

import json
import pickle
import re
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest
from made_sets import make_set
from read_samples import PER_SHARD, SLICES, TEST_IMAGES
from scipy.spatial.transform import Rotation
from tampering import change_group, descriptors, flip_chunk, marked, put, reseal

from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets import plan as plan_module
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest

FIELDS = {
    "rotation": "<f8",
    "symmetry_mask": "|b1",
    "marking_pixels": "<f4",
    "marking_visible": "|b1",
    "part_pixels": "<f4",
}


@pytest.fixture(scope="module")
def tet_set(tmp_path_factory):
    """A small set of a body without marking, both of whose splits have symmetry sets; not to be written to."""
    return make_set(tmp_path_factory.mktemp("unmarked"), "tet", test=4, train=3, size=16, annotate="all")


@pytest.fixture(scope="module")
def many_shards(tmp_path_factory):
    """A set of more shards than are kept open; not to be written to."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(plan_module, "MAX_IMAGES_PER_SHARD", 2)
        return make_set(tmp_path_factory.mktemp("many"), "tetX", test=2 * dataset_module.MAX_OPEN_SHARDS + 5, size=16)


def open_files():
    """How many shards this process has open."""
    return sum(name.endswith(".h5") for name in descriptors())


def assert_are_the_samples(labels, dataset):
    """Check every field and symmetry set against the samples one by one."""
    samples = list(dataset)
    assert len(labels) == len(samples) == len(dataset)
    group = dataset.symmetry_group
    assert labels.symmetry_group.dtype == group.dtype
    np.testing.assert_array_equal(labels.symmetry_group, group)
    shapes = {"rotation": (3, 3), "symmetry_mask": (len(group),), "marking_pixels": (), "marking_visible": ()}
    shapes["part_pixels"] = (len(dataset.parts),)
    for name, dtype in FIELDS.items():
        field = getattr(labels, name)
        assert (field.dtype.str, field.shape) == (dtype, (len(samples), *shapes[name]))
        for row, sample in enumerate(samples):
            np.testing.assert_array_equal(field[row], getattr(sample, name))
    for row, sample in enumerate(samples):
        np.testing.assert_array_equal(labels.symmetry_set(row), sample.symmetry_set)


# --- the same as the samples ---


def test_labels_are_the_samples_one_by_one(tetX_set):
    with load(tetX_set) as dataset:
        labels = dataset.labels()
        assert_are_the_samples(labels, dataset)
    assert {True, False} == set(labels.marking_visible.tolist())
    assert len(set(labels.symmetry_mask.sum(axis=1).tolist())) > 1  # else a mask that nobody reads would do


def test_labels_are_what_h5py_reads(tetX_set):
    labels, start = load(tetX_set).labels(), 0
    for path in sorted(tetX_set.glob("test-*.h5")):
        with h5py.File(path) as file:
            rows = slice(start, start + len(file["rotation"]))
            for name in ("rotation", "symmetry_mask", "marking_pixels", "part_pixels"):
                np.testing.assert_array_equal(getattr(labels, name)[rows], file[name][...])
            np.testing.assert_array_equal(labels.symmetry_group, file.attrs["symmetry_group"])
            np.testing.assert_array_equal(labels.marking_visible[rows], file["marking_pixels"][...] >= 5.0)
        start = rows.stop
    assert start == len(labels) == TEST_IMAGES


@pytest.mark.parametrize("rows", SLICES)
def test_labels_of_a_slice_are_its_samples(tetX_set, rows):
    with load(tetX_set) as dataset:
        assert_are_the_samples(dataset[rows].labels(), dataset[rows])
        assert_are_the_samples(dataset[rows][1::2].labels(), dataset[rows][1::2])


@pytest.mark.parametrize("split", ["test", "train"])
def test_labels_of_a_body_without_marking_are_its_samples(tet_set, split):
    with load(tet_set, split) as dataset:
        labels = dataset.labels()
        assert_are_the_samples(labels, dataset)
    assert not labels.marking_visible.any()
    assert not labels.marking_pixels.any()
    assert labels.symmetry_mask.all()


def test_labels_of_more_shards_than_stay_open_are_the_samples(many_shards):
    before = open_files()
    with load(many_shards) as dataset:
        assert_are_the_samples(dataset.labels(), dataset)
        assert_are_the_samples(dataset[3::2].labels(), dataset[3::2])
        assert open_files() <= before + dataset_module.MAX_OPEN_SHARDS
    assert open_files() == before


def test_labels_of_a_pickled_dataset_are_the_same(tetX_set):
    with load(tetX_set) as dataset, pickle.loads(pickle.dumps(dataset[8:])) as copy:
        assert_are_the_samples(copy.labels(), dataset[8:])


@pytest.mark.parametrize(("pixels", "is_visible"), [(4.75, False), (5.0, True), (5.25, True)])
def test_marking_is_visible_from_the_objects_tolerance_on(tetX_set, pixels, is_visible):
    assert read_manifest(tetX_set).rendered.tolerance_px == 5.0
    marked(tetX_set, 2, pixels)
    with load(tetX_set) as dataset:
        assert dataset.labels().marking_pixels[PER_SHARD + 2] == pixels
        assert dataset.labels().marking_visible[PER_SHARD + 2] == is_visible
        assert_are_the_samples(dataset.labels(), dataset)


def test_symmetry_set_of_a_row_is_its_rotation_times_the_members_of_the_group(tetX_set):
    labels = load(tetX_set).labels()
    for row in range(0, len(labels), 3):
        members = [g for g, is_in in zip(labels.symmetry_group, labels.symmetry_mask[row], strict=True) if is_in]
        found = labels.symmetry_set(row)
        assert found.shape == (len(members), 3, 3)
        for R, g in zip(found, members, strict=True):
            product = [[np.dot(row_of_R, column_of_g) for column_of_g in g.T] for row_of_R in labels.rotation[row]]
            np.testing.assert_allclose(R, product, rtol=0, atol=1e-14)


@pytest.mark.parametrize("angle_deg", [1.0, 125.0])
def test_candidates_are_members_or_rejected_and_those_near_a_member_are_left_out(tetX_set, angle_deg):
    labels = load(tetX_set).labels()
    rejected = labels.rejected_beyond(np.radians(angle_deg))
    for row in range(0, len(labels), 5):
        candidates, members = labels.candidates(row), labels.members(row)
        np.testing.assert_array_equal(candidates[labels.symmetry_mask[row]], members)
        assert labels.set_sizes[row] == len(members) == len(labels.symmetry_set(row))
        quotients = np.swapaxes(candidates[:, None], 2, 3) @ members
        angles = Rotation.from_matrix(quotients.reshape(-1, 3, 3)).magnitude().reshape(len(candidates), -1)
        np.testing.assert_array_equal(rejected[row], np.degrees(angles).min(axis=1) > angle_deg)
    assert rejected.any() == (angle_deg < 120)  # elements of the group are 120 or 180 degrees apart


def test_no_image_is_read_for_the_labels(tetX_set):
    for path in tetX_set.glob("test-*.h5"):
        with h5py.File(path) as file:
            chunks = [file[name].id.get_chunk_info(0) for name in ("image", "segmentation")]
        data = bytearray(path.read_bytes())
        for chunk in chunks:
            data[chunk.byte_offset + chunk.size // 2] ^= 1
        path.write_bytes(data)
    with load(tetX_set, check=False) as dataset:
        assert len(dataset.labels()) == TEST_IMAGES
        with pytest.raises(DataError):
            dataset[0]


def test_labels_that_were_changed_are_read_anew(tetX_set):
    with load(tetX_set) as dataset:
        changed = dataset.labels()
        changed.rotation[:] = 0
        changed.symmetry_mask[:] = False
        assert_are_the_samples(dataset.labels(), dataset)


# --- none to be had ---


@pytest.mark.parametrize("rows", [slice(None), slice(1, 3), slice(0)])
def test_labels_of_a_split_without_symmetry_sets_are_an_error_that_says_how_to_get_them(tetX_set, rows):
    message = f"{tetX_set}: the train split was rendered without symmetry sets.*--annotate all"
    with pytest.raises(NotAnnotatedError, match=message):
        load(tetX_set, "train")[rows].labels()


@pytest.mark.parametrize("name", ["rotation", "marking_pixels", "symmetry_mask", "part_pixels"])
@pytest.mark.parametrize("number", [0, 1, 2])
def test_labels_of_a_damaged_shard_are_an_error_that_names_it(tetX_set, name, number):
    path = tetX_set / f"test-{number:05d}-of-00003.h5"
    flip_chunk(path, name)
    for check in (True, False):
        with load(tetX_set, check=check) as dataset, pytest.raises(DataError, match=re.escape(str(path))):
            dataset.labels()


def no_hdf5(path):
    path.write_bytes(b"no shard")


def truncated(path):
    path.write_bytes(path.read_bytes()[:-1000])


def of_another_place(path):
    shutil.copy(path.with_name("test-00000-of-00003.h5"), path)


def without_masks(path):
    with h5py.File(path, "r+") as file:
        del file["symmetry_mask"]


def of_half_the_group(path):
    with h5py.File(path, "r+") as file:
        change_group(file, lambda group: group[:6])
        put(file, "symmetry_mask", file["symmetry_mask"][:, :6])


def of_the_group_in_another_order(path):
    with h5py.File(path, "r+") as file:
        other = [0, *range(11, 0, -1)]
        change_group(file, lambda group: group[other])
        file["symmetry_mask"][...] = file["symmetry_mask"][...][:, other]


@pytest.mark.parametrize(
    "damage",
    [
        Path.unlink,
        no_hdf5,
        truncated,
        of_another_place,
        without_masks,
        of_half_the_group,
        of_the_group_in_another_order,
    ],
)
def test_labels_with_a_shard_that_is_not_the_sets_are_an_error_that_names_it(tetX_set, damage):
    unchecked, checked = load(tetX_set, check=False), load(tetX_set)
    damage(tetX_set / "test-00001-of-00003.h5")
    for dataset in (unchecked, checked):
        with dataset, pytest.raises(DataError, match=r"test-00001-of-00003\.h5"):
            dataset.labels()


@pytest.mark.parametrize("damage", [of_half_the_group, of_the_group_in_another_order])
def test_labels_of_a_set_whose_shards_have_different_groups_are_an_error_whoever_signed_it(tetX_set, damage):
    damage(tetX_set / "test-00001-of-00003.h5")
    reseal(tetX_set)
    with load(tetX_set) as dataset, pytest.raises(DataError, match=r"test-00001-of-00003\.h5"):
        dataset.labels()


# --- fingerprint ---


def test_fingerprint_is_the_manifests(tetX_set):
    manifest = json.loads((tetX_set / "manifest.json").read_text())
    for split in ("test", "train"):
        fingerprint = load(tetX_set, split).fingerprint
        assert (
            fingerprint == manifest["splits"][split]["fingerprint"] == read_manifest(tetX_set).split_fingerprint(split)
        )
        assert re.fullmatch("[0-9a-f]{64}", fingerprint)


def test_fingerprint_needs_no_shard_to_be_opened_and_is_a_slices_too(tetX_set, monkeypatch):
    monkeypatch.setattr(dataset_module, "checked_shard", lambda *_, **__: pytest.fail("a shard was opened"))
    dataset = load(tetX_set)
    assert dataset.fingerprint == dataset[3:7].fingerprint == pickle.loads(pickle.dumps(dataset)).fingerprint


def test_fingerprint_does_not_follow_from_what_else_is_in_the_folder(tetX_set, tmp_path):
    expected = load(tetX_set).fingerprint  # of 40 test images beside 5 of train
    for train in (0, 2):
        alone = make_set(tmp_path / f"beside {train}", test=40, train=train)
        assert load(alone).fingerprint == expected
        for path in alone.glob("train-*.h5"):
            path.unlink()
        assert load(alone).fingerprint == expected


def test_fingerprint_is_anothers_for_another_seed_split_object_or_count(tmp_path):
    made = {
        "one": {},
        "of another seed": {"seed": 1},
        "of another count": {"test": 5},
        "of another object": {"name": "tetX"},
        "of another size": {"size": 17},
    }
    found = []
    for name, plan in made.items():
        folder = make_set(
            tmp_path / name, **{"name": "tet", "test": 4, "train": 4, "size": 16, "annotate": "all", **plan}
        )
        found += [load(folder, split).fingerprint for split in ("test", "train")]
    same_train = found.pop(2 * list(made).index("of another count") + 1)
    assert same_train == found[1]
    assert len(set(found)) == len(found)


# --- closing ---


def test_leaving_the_context_closes_all_files(tetX_set):
    before = open_files()
    with load(tetX_set) as dataset:
        assert dataset.labels().rotation.shape == (TEST_IMAGES, 3, 3)
        assert dataset[0].index == 0
        assert open_files() == before + 3
    assert open_files() == before


def test_context_is_the_dataset_itself(tetX_set):
    dataset = load(tetX_set)
    with dataset as entered:
        assert entered is dataset


def test_error_inside_the_context_closes_all_files_and_goes_on(tetX_set):
    def divide_by_the_smallest_area():
        with load(tetX_set) as dataset:
            raise ZeroDivisionError(dataset.labels().marking_pixels.min())

    before = open_files()
    with pytest.raises(ZeroDivisionError):
        divide_by_the_smallest_area()
    assert open_files() == before


def test_damaged_shard_leaves_no_file_open(tetX_set):
    before = open_files()
    of_another_place(tetX_set / "test-00002-of-00003.h5")
    with pytest.raises(DataError), load(tetX_set) as dataset:
        dataset.labels()
    assert open_files() == before


def test_closed_dataset_opens_its_files_again_when_asked(tetX_set):
    before = open_files()
    dataset = load(tetX_set)
    for _ in range(2):
        with dataset:
            assert_are_the_samples(dataset.labels(), dataset)
        dataset.close()
        dataset.close()
        assert open_files() == before
    assert dataset[39].index == 39
    dataset.close()


def test_closing_a_dataset_closes_no_slice_of_it(tetX_set):
    with load(tetX_set) as dataset, dataset[10:20] as part:
        assert part[0].index == dataset[10].index == 10
        dataset.close()
        assert part[1].index == 11
        assert_are_the_samples(part.labels(), dataset[10:20])
