"""Where people keep a set: behind links, moved, renamed, beside other files, and where nothing may be written."""

import pickle
import shutil
from functools import partial
from pathlib import Path

import pytest
from bench_sets import SmallDisk, python, run
from made_sets import SIZE, threads
from numpy_renderer import NumpyRenderer
from read_samples import PER_SHARD, TEST_IMAGES, assert_is, expected_samples

from symsol_annot.errors import DataError
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.sets.dataset import load
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.verify import verify


def test_set_held_as_links_to_a_store_loads_and_verifies(tetX_set, tmp_path):
    """As git-annex, DVC and the Hugging Face cache keep files."""
    store = tmp_path / "store"
    store.mkdir()
    for path in list(tetX_set.iterdir()):
        path.rename(store / path.name)
        path.symlink_to(store / path.name)
    assert verify(tetX_set) == []
    assert load(tetX_set)[0].symmetry_set.shape[1:] == (3, 3)


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
