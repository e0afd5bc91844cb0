"""Which sets may be published: finished ones, of names that hosts take, and of one's own making."""

from dataclasses import replace

from bundles import assert_refused

from symsol_annot.errors import DataError
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.stated.settings import ImportedSettings, Source


def test_an_unfinished_set_is_refused(tetX_set, tmp_path):
    manifest = read_manifest(tetX_set)
    unfinished = replace(manifest.shards[-1], bytes=None, sha256=None, content_sha256=None)
    write_manifest(tetX_set, manifest.with_finished(unfinished))
    assert_refused(tetX_set, tmp_path / "out", DataError, "is not finished: 1 shards are missing")


def test_a_folder_without_sets_or_with_a_name_that_hosts_do_not_take_is_refused(tetX_set, tmp_path):
    (tmp_path / "empty").mkdir()
    assert_refused(tmp_path / "empty", tmp_path / "out", DataError, "holds no manifest.json")
    assert_refused(tmp_path / "nowhere", tmp_path / "out", DataError, "holds no manifest.json")
    assert_refused(tetX_set.rename(tmp_path / "my set"), tmp_path / "out", DataError, "'my set'", "rename it")
    reserved = (tmp_path / "my set").rename(tmp_path / "symmetry_groups")
    assert_refused(reserved, tmp_path / "out", DataError, "'symmetry_groups'", "rename")


def test_an_imported_set_is_refused(tetX_set, tmp_path):
    manifest = read_manifest(tetX_set)
    source = Source("symsol.zip", "0" * 64, "unknown", transposed=False, rotations_listed=12, duplicates_removed=0)
    width, height = manifest.settings.image_size
    settings = ImportedSettings(object="tetX", annotate="test", width=width, height=height, source=source)
    write_manifest(tetX_set, replace(manifest, settings=settings))
    assert_refused(tetX_set, tmp_path / "out", DataError, "imported", "licence")
