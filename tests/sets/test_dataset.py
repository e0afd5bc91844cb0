"""Loading a set: every sample is what h5py reads, whichever way and in whichever process it is asked for."""

import multiprocessing
import operator
import os
import pickle
import random
import shutil
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
from bench_sets import SmallDisk, python, run
from made_sets import SIZE, make_set, threads
from numpy_renderer import NumpyRenderer
from processes import open_shards
from tampering import flip_bit, flip_chunk, marked, put, reseal, tampered

import symsol_annot
from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets import plan as plan_module
from symsol_annot.sets.dataset import Sample, load
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard import reader as shards
from symsol_annot.sets.verify import verify

TEST_IMAGES, TRAIN_IMAGES, PER_SHARD = 40, 5, 16
ALL_TEST_SHARDS = [f"test-{number:05d}-of-00003.h5" for number in range(3)]


@pytest.fixture(scope="module")
def tet_set(tmp_path_factory):
    """A small set of a body without marking; not to be written to."""
    return make_set(tmp_path_factory.mktemp("unmarked"), "tet", test=4, size=16)


@pytest.fixture
def opened(monkeypatch):
    """The names of the shards that HDF5 is asked about from here on, in order."""
    names, describe = [], shards._DESCRIBER.describe
    monkeypatch.setattr(shards._DESCRIBER, "describe", lambda path: names.append(path.name) or describe(path))
    return names


def expected_samples(folder, split="test"):
    """What h5py alone reads from a split's files, in order: the fields of each image by name."""
    samples = []
    for path in sorted(folder.glob(f"{split}-*.h5")):
        with h5py.File(path) as file:
            arrays = {name: file[name][...] for name in file}
        group = arrays.pop("symmetry_group")
        rows = range(len(arrays["image"]))
        samples += [{"symmetry_group": group, **{name: values[row] for name, values in arrays.items()}} for row in rows]
    return samples


def assert_is(sample, index, expected):
    """Check each field of a sample against what h5py read."""
    assert isinstance(sample, Sample)
    assert sample.index == index
    for name in ("image", "segmentation", "rotation", "symmetry_group"):
        found = getattr(sample, name)
        assert found.dtype == expected[name].dtype
        np.testing.assert_array_equal(found, expected[name])
    assert sample.marking_pixels == expected["marking_pixels"]
    if "symmetry_mask" in expected:
        assert sample.symmetry_mask.dtype == bool
        np.testing.assert_array_equal(sample.symmetry_mask, expected["symmetry_mask"])
    else:
        assert sample.symmetry_mask is None


def indices(dataset):
    return [sample.index for sample in dataset]


def test_every_field_of_every_sample_is_what_h5py_reads(tetX_set):
    for split, count in (("test", TEST_IMAGES), ("train", TRAIN_IMAGES)):
        dataset = load(tetX_set, split)
        expected = expected_samples(tetX_set, split)
        assert len(dataset) == len(expected) == count
        for index in range(count):
            assert_is(dataset[index], index, expected[index])


def test_load_is_public_and_gives_the_test_split_by_default(tetX_set):
    dataset = symsol_annot.load(str(tetX_set))
    assert (dataset.object, dataset.split, len(dataset)) == ("tetX", "test", TEST_IMAGES)
    assert repr(dataset) == f"<tetX test: 40 images in {tetX_set}>"


def test_image_size_is_width_and_height(tetX_set):
    dataset = load(tetX_set)
    assert dataset.image_size == dataset[0].image.shape[1::-1]
    wide = replace(dataset.manifest.rendered.camera, width=640)
    dataset.manifest = replace(dataset.manifest, settings=replace(dataset.manifest.settings, camera=wide))
    assert dataset.image_size == (640, dataset[0].image.shape[0])


def test_order_of_access_does_not_matter(tetX_set):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    order = list(range(TEST_IMAGES)) * 2
    random.Random(0).shuffle(order)
    for index in order:
        assert_is(dataset[index], index, expected[index])


def test_iteration_gives_every_sample_once_and_in_order(tetX_set):
    dataset = load(tetX_set)
    assert indices(dataset) == indices(dataset) == list(range(TEST_IMAGES))
    assert indices(reversed(dataset)) == list(range(TEST_IMAGES))[::-1]


@pytest.mark.parametrize("index", [-1, -8, -9, -TEST_IMAGES, np.int64(17), np.uint8(3)])
def test_negative_and_numpy_integers_index_like_a_lists(tetX_set, index):
    expected = range(TEST_IMAGES)[index]
    assert_is(load(tetX_set)[index], expected, expected_samples(tetX_set)[expected])


@pytest.mark.parametrize("index", [TEST_IMAGES, TEST_IMAGES + 1, -TEST_IMAGES - 1, 10**9])
def test_index_out_of_range_is_an_index_error_that_says_the_range(tetX_set, index):
    with pytest.raises(IndexError, match=f"index {index} is out of range: .* has 40 images"):
        load(tetX_set)[index]


@pytest.mark.parametrize("index", [1.0, "1", None, (0, 1)])
def test_index_that_is_no_integer_is_a_type_error(tetX_set, index):
    with pytest.raises(TypeError):
        load(tetX_set)[index]


SLICES = [
    slice(None),
    slice(5),
    slice(10, 30),
    slice(15, 17),
    slice(None, None, 7),
    slice(39, 2, -5),
    slice(None, None, -1),
    slice(-3, None),
    slice(20, 10),
    slice(0, 1000),
]


@pytest.mark.parametrize("outer", SLICES)
def test_slice_is_the_dataset_of_what_a_lists_slice_holds(tetX_set, outer):
    dataset, expected = load(tetX_set), list(range(TEST_IMAGES))[outer]
    part = dataset[outer]
    assert type(part) is type(dataset)
    assert len(part) == len(expected)
    assert indices(part) == expected
    for inner in SLICES:
        assert indices(part[inner][::-1][:3]) == expected[inner][::-1][:3]


def test_samples_of_a_slice_are_those_of_the_whole(tetX_set):
    part, expected = load(tetX_set)[30:10:-7], expected_samples(tetX_set)
    for position, index in enumerate((30, 23, 16)):
        assert_is(part[position], index, expected[index])
    assert part[-1].index == 16
    with pytest.raises(IndexError, match="has 3 images"):
        part[3]


def test_empty_slice_is_an_empty_dataset(tetX_set):
    empty = load(tetX_set)[10:10]
    assert len(empty) == 0
    assert indices(empty) == []
    with pytest.raises(IndexError):
        empty[0]


def test_symmetry_set_is_the_label_times_the_members_of_the_group(tetX_set):
    sizes = set()
    for sample, expected in zip(load(tetX_set), expected_samples(tetX_set), strict=True):
        R = expected["rotation"]
        members = [g for g, is_in in zip(expected["symmetry_group"], expected["symmetry_mask"], strict=True) if is_in]
        products = np.zeros((len(members), 3, 3))
        for m, i, j, k in np.ndindex(len(members), 3, 3, 3):
            products[m, i, j] += R[i, k] * members[m][k, j]
        assert sample.symmetry_set.dtype == np.float64
        assert sample.symmetry_set.shape == products.shape
        np.testing.assert_allclose(sample.symmetry_set, products, rtol=0, atol=1e-14)
        sizes.add(len(members))
    assert len(sizes) > 1  # else a mask that nobody reads would do


def test_symmetry_set_holds_the_images_own_rotation_once(tetX_set):
    for sample in load(tetX_set):
        off = np.abs(sample.symmetry_set - sample.rotation).max(axis=(1, 2))
        assert np.count_nonzero(off < 1e-12) == 1


def test_symmetry_set_keeps_the_body_where_it_is(tetX_set):
    # corners of the tetrahedron, in model coordinates: a member maps them to the same four points as the label does
    corners = np.array([[1, 1, 1], [1, -1, -1], [-1, 1, -1], [-1, -1, 1]]).T / 3**0.5
    for sample in load(tetX_set)[::5]:
        there = np.sort((sample.rotation @ corners).T, axis=0)
        for R_m2c in sample.symmetry_set:
            np.testing.assert_allclose(np.sort((R_m2c @ corners).T, axis=0), there, atol=1e-12)


def test_dataset_knows_its_group_and_whether_it_is_annotated(tetX_set):
    test, train = load(tetX_set), load(tetX_set, "train")
    assert (test.is_annotated, train.is_annotated) == (True, False)
    assert test.symmetry_group.shape == (12, 3, 3)
    np.testing.assert_array_equal(test.symmetry_group[0], np.eye(3))
    np.testing.assert_array_equal(test.symmetry_group, train.symmetry_group)


def test_symmetry_set_of_a_split_without_is_an_error_that_says_how_to_get_it(tetX_set):
    sample = load(tetX_set, "train")[3]
    with pytest.raises(NotAnnotatedError, match=r"image 3 has no symmetry set.*--annotate all"):
        _ = sample.symmetry_set


@pytest.mark.parametrize(
    ("pixels", "is_visible"), [(0.0, False), (4.75, False), (5.0, True), (5.25, True), (300.0, True)]
)
def test_marking_is_visible_from_the_objects_tolerance_on(tetX_set, pixels, is_visible):
    assert read_manifest(tetX_set).rendered.tolerance_px == 5.0
    marked(tetX_set, 2, pixels)
    sample = load(tetX_set)[PER_SHARD + 2]
    assert (sample.marking_pixels, sample.marking_visible) == (pixels, is_visible)
    assert isinstance(sample.marking_visible, bool)


def test_body_without_marking_shows_none_and_has_its_whole_group_as_set(tet_set):
    for sample in load(tet_set):
        assert (sample.marking_pixels, sample.marking_visible) == (0.0, False)
        np.testing.assert_array_equal(sample.symmetry_set, sample.rotation @ sample.symmetry_group)
        assert sample.symmetry_set.shape == (12, 3, 3)


def test_no_shard_is_opened_before_a_sample_is_asked_for(tetX_set, monkeypatch):
    def refuse(*arguments, **options):
        pytest.fail(f"{arguments} was opened")

    with monkeypatch.context() as patch:
        patch.setattr(shards._DESCRIBER, "describe", refuse)
        patch.setattr(dataset_module, "checked_shard", refuse)
        dataset = load(tetX_set)
        parts = dataset[::2], pickle.loads(pickle.dumps(dataset))
        assert (len(dataset), [len(part) for part in parts], dataset.is_annotated) == (40, [20, 40], True)
    assert dataset[0].index == 0


def test_access_opens_only_the_shard_that_holds_the_sample(tetX_set):
    expected = expected_samples(tetX_set)
    for name in ("test-00000-of-00003.h5", "test-00002-of-00003.h5"):
        (tetX_set / name).write_bytes(b"no shard")
    dataset = load(tetX_set)
    for index in range(PER_SHARD, 2 * PER_SHARD):
        assert_is(dataset[index], index, expected[index])
    for index in (PER_SHARD - 1, 2 * PER_SHARD):
        with pytest.raises(DataError):
            dataset[index]


def test_no_more_files_are_open_than_the_cap_and_none_after_close(tmp_path, monkeypatch):
    monkeypatch.setattr(plan_module, "MAX_IMAGES_PER_SHARD", 2)
    folder = make_set(tmp_path, "tet", test=24, size=16)
    dataset, most = load(folder), 0
    assert len(list(folder.glob("*.h5"))) == 12 > dataset_module.MAX_OPEN_SHARDS
    order = list(range(24)) * 2
    random.Random(0).shuffle(order)
    for index in order:
        assert dataset[index].index == index
        most = max(most, open_shards(folder))
    assert most == dataset_module.MAX_OPEN_SHARDS
    dataset.close()
    assert open_shards(folder) == 0
    assert dataset[23].index == 23
    dataset.close()


@pytest.mark.parametrize("cap", [1, 2, 8])
def test_shard_is_opened_by_hdf5_once(tetX_set, opened, monkeypatch, cap):
    monkeypatch.setattr(dataset_module, "MAX_OPEN_SHARDS", cap)
    dataset = load(tetX_set)
    assert indices(dataset) + indices(dataset) == list(range(TEST_IMAGES)) * 2
    assert opened == ALL_TEST_SHARDS


def test_shard_that_was_used_last_stays_open(tetX_set, monkeypatch):
    monkeypatch.setattr(dataset_module, "MAX_OPEN_SHARDS", 2)
    dataset = load(tetX_set)
    for index in (0, 16, 1, 32, 2):
        assert dataset[index].index == index
    (tetX_set / "test-00000-of-00003.h5").unlink()
    (tetX_set / "test-00001-of-00003.h5").unlink()
    assert dataset[3].index == 3
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: cannot be opened again: No such file"):
        dataset[17]


def test_samples_arrays_may_be_written_to_and_the_next_sample_is_as_before(tetX_set):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    sample = dataset[3]
    for name in ("image", "segmentation", "rotation", "symmetry_mask"):
        array = getattr(sample, name)
        array[...] = ~array if array.dtype == bool else array + 1
    assert_is(dataset[3], 3, expected[3])
    np.testing.assert_array_equal(dataset.labels().rotation[3], expected[3]["rotation"])


@pytest.mark.parametrize("cap", [1, 2])
def test_threads_read_the_same_while_they_take_each_others_files_away(tetX_set, monkeypatch, cap):
    monkeypatch.setattr(dataset_module, "MAX_OPEN_SHARDS", cap)
    dataset, expected = load(tetX_set), expected_samples(tetX_set)

    def read_all(seed):
        order = list(range(TEST_IMAGES)) * 5
        random.Random(seed).shuffle(order)
        for index in order:
            assert_is(dataset[index], index, expected[index])
        return len(order)

    with ThreadPoolExecutor(6) as pool:
        assert list(pool.map(read_all, range(6))) == [5 * TEST_IMAGES] * 6
    dataset.close()
    assert open_shards(tetX_set) == 0


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


@pytest.mark.parametrize("is_used", [False, True])
def test_dataset_survives_pickling(tetX_set, is_used):
    dataset, expected = load(tetX_set)[8:], expected_samples(tetX_set)
    if is_used:
        assert dataset[0].index == 8
    copy = pickle.loads(pickle.dumps(dataset))
    assert indices(copy) == indices(dataset) == list(range(8, TEST_IMAGES))
    assert_is(copy[9], 17, expected[17])
    assert_is(dataset[9], 17, expected[17])


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize("method", ["fork", "spawn"])
def test_worker_processes_read_the_same_also_after_use_in_the_parent(tetX_set, method):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    for index in (0, 20, 39):
        assert_is(dataset[index], index, expected[index])
    with multiprocessing.get_context(method).Pool(2) as pool:
        reading = pool.starmap_async(operator.getitem, [(dataset, index) for index in range(TEST_IMAGES)], chunksize=1)
        for index in range(TEST_IMAGES):  # while the workers read
            assert_is(dataset[index], index, expected[index])
        for index, sample in enumerate(reading.get(timeout=120)):
            assert_is(sample, index, expected[index])
    assert_is(dataset[39], 39, expected[39])


def put_every_third(dataset, queue):
    for index in range(0, TEST_IMAGES, 3):
        queue.put(dataset[index])
    queue.put(open_shards(dataset.folder))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_files_that_are_open_at_a_fork_are_read_by_parent_and_children_at_once(tetX_set):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    assert indices(dataset) == list(range(TEST_IMAGES))
    context = multiprocessing.get_context("fork")  # what it hands over is not pickled, but the parent's very object
    queues = [context.SimpleQueue() for _ in range(3)]
    children = [context.Process(target=put_every_third, args=(dataset, queue), daemon=True) for queue in queues]
    for child in children:
        child.start()
    for queue in queues:
        for index in range(0, TEST_IMAGES, 3):
            assert_is(queue.get(), index, expected[index])
            assert_is(dataset[-index - 1], TEST_IMAGES - index - 1, expected[-index - 1])
        assert queue.get() == 3
    for child in children:
        child.join(timeout=60)
        assert child.exitcode == 0


def test_folder_without_a_manifest_is_an_error(tmp_path):
    for folder in (tmp_path, tmp_path / "absent"):
        with pytest.raises(
            DataError, match=f"{folder}: holds no manifest.json; a set is a folder that `symsol-annot render`"
        ):
            load(folder)


def test_folder_of_sets_is_an_error_that_names_them(tetX_set, tmp_path):
    shutil.copytree(tetX_set, tmp_path / "cylO")
    with pytest.raises(DataError, match=f"it has sets inside: {tmp_path / 'cylO'}, {tmp_path / 'tetX'}"):
        load(tmp_path)


def test_path_that_is_a_file_is_an_error(tetX_set):
    with pytest.raises(DataError, match=r"test-00000-of-00003\.h5: is a file; a set is a folder, like data/cylO"):
        load(tetX_set / "test-00000-of-00003.h5")


def test_split_that_is_not_there_is_an_error_that_names_those_that_are(tetX_set, tet_set):
    with pytest.raises(DataError, match="has no split 'validation'; it has train, test"):
        load(tetX_set, "validation")
    with pytest.raises(DataError, match="has no split 'train'; it has test"):
        load(tet_set, "train")


def test_missing_shards_are_an_error_at_once_and_only_for_their_own_split(tetX_set):
    for number in (1, 2):
        (tetX_set / f"test-0000{number}-of-00003.h5").unlink()
    with pytest.raises(DataError, match=r"2 of 3 test shards are missing, the first test-00001-of-00003\.h5.*render"):
        load(tetX_set, "test")
    assert indices(load(tetX_set, "train")) == list(range(TRAIN_IMAGES))


def test_unfinished_split_is_an_error(tetX_set):
    manifest = read_manifest(tetX_set)
    entry = manifest.of_split("test")[-1]
    write_manifest(tetX_set, manifest.with_finished(replace(entry, bytes=None, sha256=None, content_sha256=None)))
    with pytest.raises(DataError, match=r"1 of 3 test shards are missing, the first test-00002-of-00003\.h5"):
        load(tetX_set)


def test_shard_that_vanished_after_loading_is_an_error(tetX_set):
    dataset = load(tetX_set)
    (tetX_set / "test-00001-of-00003.h5").unlink()
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: no such shard"):
        dataset[20]


@pytest.mark.parametrize(
    "name", ["image", "segmentation", "rotation", "marking_pixels", "symmetry_mask", "symmetry_group"]
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


def test_shard_with_fewer_images_than_the_manifest_says_is_an_error(tetX_set):
    shutil.copy(tetX_set / "test-00002-of-00003.h5", tetX_set / "test-00001-of-00003.h5")
    with tampered(tetX_set, "test-00001-of-00003.h5") as file:
        file.attrs["first_index"] = PER_SHARD
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: .*\n.*expected 16 images, found 8"):
        load(tetX_set)[2 * PER_SHARD - 1]


@pytest.mark.parametrize("other", ["of another place", "of another seed", "of another split", "of another object"])
def test_shard_of_something_else_is_an_error_and_never_a_sample(tetX_set, tmp_path, other):
    path = tetX_set / "test-00000-of-00003.h5"
    made = {
        "of another place": lambda: tetX_set / "test-00001-of-00003.h5",
        "of another seed": lambda: make_set(tmp_path / "other", test=16, seed=1) / "test-00000-of-00001.h5",
        "of another split": lambda: tetX_set / "train-00000-of-00001.h5",
        "of another object": lambda: make_set(tmp_path / "other", "tet", test=16) / "test-00000-of-00001.h5",
    }
    shutil.copy(made[other](), path)
    with pytest.raises(DataError, match=r"test-00000-of-00003\.h5: is damaged: expected"):
        load(tetX_set)[0]
    for check in (False, True):
        with pytest.raises(DataError, match=r"test-00000-of-00003\.h5: is no shard of this set:\n"):
            load(tetX_set, check=check)[0]
        reseal(tetX_set)


def test_set_held_as_links_to_a_store_loads_and_verifies(tetX_set, tmp_path):
    """As git-annex, DVC and the Hugging Face cache keep files."""
    store = tmp_path / "store"
    store.mkdir()
    for path in list(tetX_set.iterdir()):
        path.rename(store / path.name)
        path.symlink_to(store / path.name)
    assert verify(tetX_set) == []
    assert load(tetX_set)[0].symmetry_set.shape[1:] == (3, 3)


# Where people keep data


def test_working_folder_may_change_after_load(tetX_set, tmp_path, monkeypatch):
    expected = expected_samples(tetX_set)
    monkeypatch.chdir(tetX_set.parent)
    datasets = [load("tetX"), load(Path("tetX")), load("./../" + tetX_set.parent.name + "/tetX")]
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    for dataset in (*datasets, pickle.loads(pickle.dumps(datasets[0])), datasets[0][3:]):
        assert_is(dataset[-1], TEST_IMAGES - 1, expected[-1])
        assert len(dataset.labels()) == len(dataset)
    with pytest.raises(DataError, match=r"tetX: holds no manifest\.json"):
        load("tetX")


def test_folder_that_was_moved_after_load_is_an_error_and_files_that_are_open_are_read(tetX_set, tmp_path):
    dataset, expected = load(tetX_set), expected_samples(tetX_set)
    assert dataset[0].index == 0
    tetX_set.rename(tmp_path / "moved")
    assert_is(dataset[1], 1, expected[1])
    with pytest.raises(DataError, match=r"test-00001-of-00003\.h5: no such shard"):
        dataset[PER_SHARD]
    dataset.close()
    with pytest.raises(DataError, match=r"test-00000-of-00003\.h5: "):
        dataset[0]
    assert_is(load(tmp_path / "moved")[PER_SHARD], PER_SHARD, expected[PER_SHARD])


def test_folder_may_be_named_otherwise_than_its_object(tetX_set, tmp_path):
    folder = tetX_set.rename(tmp_path / "a set, of last week (ö)")
    assert load(folder).object == "tetX"
    assert len(load(folder).labels()) == TEST_IMAGES
    assert verify(folder) == []


def with_notes_of_systems(folder):
    """Put what macOS and Windows leave on disks beside every file of a set, and beside the set."""
    for path in list(folder.iterdir()):
        path.with_name(f"._{path.name}").write_bytes(b"\0\5\26\7\0\2\0\0Mac OS X        " + bytes(4000))
    for place in (folder, folder.parent):
        for name in (".DS_Store", "Thumbs.db", "desktop.ini", "._.DS_Store"):
            (place / name).write_bytes(b"mine")
        (place / ".Trashes").mkdir()
        (place / ".Trashes" / "manifest.json").write_bytes(b"{}")
    (folder.parent / f"._{folder.name}").write_bytes(b"mine")


def test_notes_of_operating_systems_are_nobodys_shards_and_stay(tetX_set):
    with_notes_of_systems(tetX_set)
    before = {path: path.read_bytes() for path in tetX_set.parent.rglob("*") if path.is_file()}
    assert verify(tetX_set) == []
    assert len(list(load(tetX_set))) == TEST_IMAGES
    assert set_folders(tetX_set.parent) == [tetX_set]
    with pytest.raises(DataError, match=f"it has sets inside: {tetX_set}$"):
        load(tetX_set.parent)
    renderer = partial(NumpyRenderer, "tetX", SIZE)
    generate(SetPlan.behind(read_manifest(tetX_set), load_object("tetX")), tetX_set, threads(renderer))
    assert {path: path.read_bytes() for path in tetX_set.parent.rglob("*") if path.is_file()} == before


READ_ONLY = """
import os, sys
from pathlib import Path
from symsol_annot import load
from symsol_annot.sets.verify import verify
folder = Path(sys.argv[1])
if os.geteuid() == 0 and sys.argv[2:]:  # root may write anywhere
    load(sys.argv[2])[0]  # starts the process that HDF5 lives in, which others may not start where Python is root's
    os.setgroups([]), os.setresgid(*[65534] * 3), os.setresuid(*[65534] * 3)
print(len([sample.symmetry_set for sample in load(folder)]), len(load(folder).labels()), verify(folder))
"""


@pytest.fixture
def open_folder():
    """A folder that every user can reach, which pytest's own are not."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)
    shutil.rmtree(folder)


def test_set_that_may_only_be_read_is_loaded_and_verified(tetX_set, open_folder):
    folder = Path(shutil.copytree(tetX_set, open_folder / "tetX"))
    for path in folder.iterdir():
        path.chmod(0o444)
    folder.chmod(0o555)
    assert python(READ_ONLY, folder, tetX_set).stdout == "40 40 []\n"


def test_set_on_a_disk_mounted_for_reading_alone_is_loaded_and_verified(tetX_set, tmp_path):
    disk = SmallDisk(tmp_path / "disk")
    disk.folder.mkdir()
    disk.resize(4000)
    try:
        folder = Path(shutil.copytree(tetX_set, disk.folder / "tetX"))
        run("mount", "-o", "remount,ro", disk.folder)
        with pytest.raises(OSError, match="Read-only file system"):
            (folder / "file").touch()
        assert python(READ_ONLY, folder).stdout == "40 40 []\n"
    finally:
        disk.unmount()


@pytest.mark.parametrize("mode", [0o000, 0o200])
def test_shard_that_may_not_be_read_is_an_error_that_says_so(tetX_set, open_folder, mode):
    folder = Path(shutil.copytree(tetX_set, open_folder / "tetX"))
    (folder / "test-00001-of-00003.h5").chmod(mode)
    code = READ_ONLY.rsplit("print", 1)[0] + "load(folder)[20]"
    with pytest.raises(AssertionError, match=r"test-00001-of-00003\.h5: cannot be opened: Permission denied"):
        python(code, folder, tetX_set)  # which takes a traceback for a failure


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
