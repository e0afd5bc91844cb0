"""The query file: what the library asks, written for whoever has no Python, whole or not at all."""

import itertools

import h5py
import numpy as np
import pytest
from made_sets import make_set
from query_oracle import recomputed

from symsol_annot.bench.predictions.format import FILE_ATTRIBUTES
from symsol_annot.bench.predictions.queries import Queries, group_sha256
from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER_ATTRIBUTES
from symsol_annot.bench.predictions.writing.query_file import write_queries
from symsol_annot.errors import NotAnnotatedError, OutputError, SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_sha256
from symsol_annot.sets.dataset import load

LEVEL = 1


@pytest.fixture(scope="module")
def tet_set(tmp_path_factory):
    """A small set of a body without marking, whose train split has no symmetry sets; not to be written to."""
    return make_set(tmp_path_factory.mktemp("unmarked"), "tet", test=6, train=2, size=16)


@pytest.fixture
def dataset(tet_set):
    with load(tet_set) as dataset:
        yield dataset


def read(path):
    with h5py.File(path) as file:
        return dict(file.attrs), {name: file[name][...] for name in file}


def assert_nothing_is_left_in(folder):
    assert list(folder.iterdir()) == []


def test_query_file_repeats_the_librarys_queries_and_grid_to_float32(dataset, tmp_path):
    write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    _, arrays = read(tmp_path / "queries.h5")
    assert sorted(arrays) == ["grid_rotation", "query_rotation"]
    assert [arrays[name].dtype for name in sorted(arrays)] == [np.float32, np.float32]
    assert arrays["query_rotation"].shape == (6, 108, 3, 3)
    queries = Queries(dataset.fingerprint, dataset.symmetry_group)
    for i, sample in enumerate(dataset):
        expected = queries.rotations(i, sample.rotation)
        np.testing.assert_array_equal(arrays["query_rotation"][i], expected.astype(np.float32))
        oracle = recomputed(dataset.fingerprint, i, sample.rotation, sample.symmetry_group)
        np.testing.assert_allclose(arrays["query_rotation"][i], oracle, rtol=0, atol=1e-7)
    np.testing.assert_array_equal(arrays["grid_rotation"], equivolumetric_grid(LEVEL).astype(np.float32))


def test_query_file_of_a_marked_object_is_about_each_image(tetX_set, tmp_path):
    with load(tetX_set) as marked:
        write_queries(tmp_path / "queries.h5", marked, 0)
        rows = read(tmp_path / "queries.h5")[1]["query_rotation"]
        assert len(rows) == len(marked)
        for i, sample in enumerate(marked):
            is_asked = np.abs(rows[i][:, None] - sample.symmetry_set[None]).max(axis=(2, 3)) < 1e-6
            assert is_asked.any(axis=0).all()


def test_query_file_has_what_a_predictions_file_repeats(dataset, tmp_path):
    write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    attributes, _ = read(tmp_path / "queries.h5")
    repeated = {
        "object": "tet",
        "split": "test",
        "fingerprint": dataset.fingerprint,
        "group_sha256": group_sha256(dataset.symmetry_group),
        "grid_level": LEVEL,
        "grid_sha256": grid_sha256(LEVEL),
    }
    assert attributes == {**repeated, "format": "symsol-annot queries", "format_version": 1}
    asked = {**FILE_ATTRIBUTES, **CLASSIFIER_ATTRIBUTES}
    assert set(repeated) == set(asked) - {"format", "format_version", "method", "floor"}
    for name in repeated:
        assert isinstance(attributes[name], (int, np.integer) if asked[name] is int else asked[name])


def test_query_file_is_about_the_split_that_it_names(tmp_path):
    both = make_set(tmp_path, "tet", test=2, train=3, size=16, annotate="all")
    for split, count in (("test", 2), ("train", 3)):
        write_queries(tmp_path / "queries.h5", load(both, split), 0)
        attributes, arrays = read(tmp_path / "queries.h5")
        assert (attributes["split"], attributes["fingerprint"]) == (split, load(both, split).fingerprint)
        assert len(arrays["query_rotation"]) == count


def test_query_file_is_about_the_standard_level_by_default(dataset, tmp_path):
    write_queries(tmp_path / "queries.h5", dataset)
    with h5py.File(tmp_path / "queries.h5") as file:
        assert file.attrs["grid_level"] == STANDARD_LEVEL
        assert file["grid_rotation"].shape == (294_912, 3, 3)


def test_query_file_depends_on_nothing_but_the_split_and_level(dataset, tmp_path):
    for name in ("a.h5", "b.h5"):
        write_queries(tmp_path / name, dataset, LEVEL)
    assert (tmp_path / "a.h5").read_bytes() == (tmp_path / "b.h5").read_bytes()


def test_query_file_can_be_read_by_every_hdf5_and_notices_damage(dataset, tmp_path):
    write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    with h5py.File(tmp_path / "queries.h5") as file:
        assert (file["query_rotation"].chunks, file["query_rotation"].fletcher32) == ((1, 108, 3, 3), True)
        for name in file:
            assert (file[name].compression, file[name].external, file[name].is_virtual) == ("gzip", None, False)
        chunk = file["query_rotation"].id.get_chunk_info(2)
    data = bytearray((tmp_path / "queries.h5").read_bytes())
    data[chunk.byte_offset + chunk.size // 2] ^= 1
    (tmp_path / "queries.h5").write_bytes(data)
    with h5py.File(tmp_path / "queries.h5") as file, pytest.raises(OSError):
        file["query_rotation"][2]


def test_progress_is_reported_once_an_image(dataset, tmp_path):
    calls = []
    write_queries(tmp_path / "queries.h5", dataset, LEVEL, lambda: calls.append(1))
    assert len(calls) == len(dataset)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt, MemoryError])
@pytest.mark.parametrize("is_there", [False, True])
def test_query_file_that_fails_half_way_leaves_what_was_there_before(dataset, tmp_path, error, is_there):
    path, calls = tmp_path / "queries.h5", itertools.count()
    if is_there:
        path.write_bytes(b"of last week")

    def fail():
        if next(calls) == 3:
            raise error

    with pytest.raises(error):
        write_queries(path, dataset, LEVEL, fail)
    if is_there:
        assert path.read_bytes() == b"of last week"
        path.unlink()
    assert_nothing_is_left_in(tmp_path)


def test_disk_that_fills_up_is_an_output_error_and_leaves_nothing(dataset, tmp_path, monkeypatch):
    def fail(self, target):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(type(tmp_path), "replace", fail)
    with pytest.raises(OutputError, match=r"queries\.h5: cannot be written: the disk is full"):
        write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    assert_nothing_is_left_in(tmp_path)


def test_query_file_replaces_an_older_one(dataset, tmp_path):
    (tmp_path / "queries.h5").write_bytes(b"of last week")
    write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    assert read(tmp_path / "queries.h5")[0]["fingerprint"] == dataset.fingerprint
    assert [path.name for path in tmp_path.iterdir()] == ["queries.h5"]


def test_folder_that_is_not_there_is_an_output_error(dataset, tmp_path):
    with pytest.raises(OutputError, match=r"absent/queries\.h5: cannot be written"):
        write_queries(tmp_path / "absent" / "queries.h5", dataset, LEVEL)
    assert_nothing_is_left_in(tmp_path)


def test_path_that_is_a_folder_is_an_output_error(dataset, tmp_path):
    (tmp_path / "queries.h5").mkdir()
    with pytest.raises(OutputError, match=r"queries\.h5: cannot be written"):
        write_queries(tmp_path / "queries.h5", dataset, LEVEL)
    assert [path.name for path in tmp_path.iterdir()] == ["queries.h5"]


def test_split_without_symmetry_sets_has_no_query_file(tet_set, tmp_path):
    with pytest.raises(NotAnnotatedError, match="the train split was rendered without symmetry sets"):
        write_queries(tmp_path / "queries.h5", load(tet_set, "train"), LEVEL)
    assert_nothing_is_left_in(tmp_path)


@pytest.mark.parametrize("level", [-1, 7])
def test_level_that_does_not_exist_is_a_settings_error_and_leaves_no_query_file(dataset, tmp_path, level):
    with pytest.raises(SettingsError, match=f"levels 0 to 5, not {level}"):
        write_queries(tmp_path / "queries.h5", dataset, level)
    assert_nothing_is_left_in(tmp_path)


def test_slice_has_no_query_file(dataset, tmp_path):
    with pytest.raises(SettingsError, match="is a slice"):
        write_queries(tmp_path / "queries.h5", dataset[2:], LEVEL)
