"""The samples of a set that `load` opens: their fields, their order, and which files are opened for them."""

import pickle
import random
import shutil
from dataclasses import replace

import numpy as np
import pytest
from made_sets import make_set
from processes import open_shards
from read_samples import PER_SHARD, SLICES, TEST_IMAGES, TRAIN_IMAGES, assert_is, expected_samples, indices
from tampering import marked

import symsol_annot
from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets import plan as plan_module
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.shard import reader as shards

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


@pytest.mark.parametrize(("name", "parts"), [("tetX", ("body", "marking")), ("tet", ("body",))])
def test_parts_have_a_name_for_each_id_and_an_area_in_each_image(tmp_path, name, parts):
    """The areas are those of four lattice points a pixel; the ids are those at pixels' centres."""
    with load(make_set(tmp_path, name, test=6)) as dataset:
        assert dataset.parts == parts
        assert not dataset.has_depth
        assert max(int(sample.segmentation.max()) for sample in dataset) == len(parts)
        for sample in dataset:
            assert sample.depth is None
            assert sample.part_pixels.shape == (len(parts),)
            counts = [np.count_nonzero(sample.segmentation == number) for number in range(1, len(parts) + 1)]
            np.testing.assert_allclose(sample.part_pixels, counts, atol=40)
            assert sample.part_pixels.sum() == pytest.approx(np.count_nonzero(sample.segmentation), abs=12)


def test_depth_is_what_h5py_reads(tmp_path):
    folder = make_set(tmp_path, test=20, size=16, depth=True)
    expected = expected_samples(folder)
    with load(folder) as dataset:
        assert dataset.has_depth
        for sample, fields in zip(dataset, expected, strict=True):
            assert sample.depth.dtype == np.float32
            np.testing.assert_array_equal(sample.depth, fields["depth"])


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


def test_samples_and_datasets_say_what_they_are(tmp_path):
    folder = make_set(tmp_path, "tetX", train=3, test=3, annotate="test", size=16)
    test, train = load(folder), load(folder, "train")
    size = len(test[1].symmetry_set)
    shows = "visible" if test[1].marking_visible else "not visible"
    assert repr(test[1]) == (
        f"<Sample 1: 16x16 image, segmentation, marking {shows}, symmetry set of {size} of 12 candidates>"
    )
    assert repr(train[2]).endswith(", no symmetry set>")
    assert len(repr(test)) < 200
    with pytest.raises(DataError, match="it has train, test; did you mean 'test'"):
        load(folder, "tets")
    assert test[1:].indices.tolist() == [1, 2]
    assert (test.is_whole, test[1:].is_whole, test[:].is_whole) == (True, False, True)
