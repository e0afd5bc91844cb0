"""Which sets a folder holds, as every command that takes a folder of sets sees it."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from symsol_annot.bench.predictions.truth import find_set
from symsol_annot.errors import DataError
from symsol_annot.gallery.sources import open_sources
from symsol_annot.generation.origin import plan_behind
from symsol_annot.publish.sets import sets_in
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import read_manifest


@pytest.fixture
def several(tetX_set, tmp_path):
    """Two sets, and what stands beside sets: a folder of predictions, an empty one, a file."""
    data = tmp_path / "several"
    for name in ("tetX", "again"):
        shutil.copytree(tetX_set, data / name)
    for name in ("reference", "empty"):
        (data / name).mkdir()
    (data / "reference" / "tetX-evenly-placed.h5").write_bytes(b"predictions")
    (data / "notes.txt").write_text("seen")
    return data


def test_a_folder_is_a_set_or_has_sets_in_it_by_name(several):
    assert set_folders(several / "tetX") == [several / "tetX"]
    assert set_folders(several) == [several / "again", several / "tetX"]
    assert set_folders(several / "empty") == set_folders(several / "nowhere") == []


def test_shards_without_a_manifest_are_a_set_that_no_command_passes_over(several):
    (several / "again" / "manifest.json").unlink()
    assert set_folders(several) == [several / "again", several / "tetX"]
    for read in (open_sources, sets_in):
        with pytest.raises(DataError, match=r"again: holds no manifest\.json"):
            read(several)


def test_the_set_of_an_object_is_the_folder_of_its_name_and_no_path(several):
    assert find_set(several, "tetX") == several / "tetX"
    assert find_set(several / "tetX", "tetX") == several / "tetX"
    for name in ("cube", "empty", "../several/tetX", str(several / "tetX")):
        with pytest.raises(DataError, match="holds no set of the object"):
            find_set(several, name)


def test_a_folder_that_cannot_be_looked_into_is_an_error_that_names_it(monkeypatch, tmp_path):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "exists", refuse)
    with pytest.raises(DataError, match=f"{tmp_path}: cannot be read: Permission denied"):
        set_folders(tmp_path)


# What a set was made from


def test_the_plan_behind_a_set_plans_the_same_set(tetX_set):
    manifest = read_manifest(tetX_set)
    assert plan_behind(tetX_set, manifest).manifest().plan_sha256 == manifest.plan_sha256


def test_an_object_is_never_taken_from_a_path_that_a_manifest_names(tetX_set, tmp_path, monkeypatch):
    manifest = read_manifest(tetX_set)
    manifest = replace(manifest, settings=replace(manifest.settings, object=str(tmp_path)))
    with pytest.raises(DataError, match=r"is not built in; give its folder with --object"):
        plan_behind(tetX_set, manifest)
