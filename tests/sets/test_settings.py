"""The settings of a set: stated once, and the same in the manifest, in the attributes of each shard and in the plan."""

import json
from dataclasses import replace

import h5py
import numpy as np
import pytest
import symsol_source
from made_sets import make_plan

from symsol_annot.errors import DataError
from symsol_annot.generation.origin import plan_behind
from symsol_annot.objects.spec import load_object
from symsol_annot.sets.manifest import Manifest, read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard.reader import open_shard
from symsol_annot.sets.stated.settings import ImportedSettings, Source, settings_from_json
from symsol_annot.symsol.importing import import_symsol

SOURCE = Source("SYMSOL", "0" * 64, "unknown", transposed=True, rotations_listed=720, duplicates_removed=2)
IMPORTED = ImportedSettings(object="cyl", annotate="none", width=32, height=24, source=SOURCE)


@pytest.mark.parametrize("settings", [make_plan("tetX").set_settings, make_plan("tet").set_settings, IMPORTED])
def test_settings_survive_the_way_through_json(settings):
    assert settings_from_json(json.loads(json.dumps(settings.to_json()))) == settings


@pytest.mark.parametrize("key", list(IMPORTED.to_json()))
def test_imported_settings_that_lack_a_key_are_refused(key):
    stated = IMPORTED.to_json()
    del stated[key]
    with pytest.raises(ValueError, match=r"."):
        settings_from_json(stated)


@pytest.mark.parametrize("key", ["object_sha256", "seed", "render", "tolerance_px"])
def test_an_import_cannot_state_what_it_cannot_know(key):
    known = make_plan("tetX").set_settings.to_json()
    with pytest.raises(ValueError, match="cannot know"):
        settings_from_json({**IMPORTED.to_json(), key: known[key]})


def test_manifest_shards_and_plan_state_the_same_settings(tetX_set):
    manifest = read_manifest(tetX_set)
    document, stated = json.loads((tetX_set / "manifest.json").read_text()), manifest.settings.to_json()
    assert {key: document[key] for key in stated} == stated
    assert plan_behind(tetX_set, manifest).set_settings == manifest.settings
    for entry in manifest.shards:
        with h5py.File(tetX_set / entry.file) as file:
            attributes = dict(file.attrs)
        assert {key: attributes[key] for key in ("object", "object_sha256", "seed", "tolerance_px")} == {
            key: stated[key] for key in ("object", "object_sha256", "seed", "tolerance_px")
        }
        assert {key: json.loads(attributes[key]) for key in ("camera", "render")} == {
            key: stated[key] for key in ("camera", "render")
        }


def test_a_set_has_either_drawing_settings_or_a_source():
    rendered, imported = Manifest(make_plan("tetX").set_settings, ()), Manifest(IMPORTED, ())
    assert (rendered.is_imported, imported.is_imported) == (False, True)
    assert (rendered.settings.has_marking, imported.settings.has_marking) == (True, False)
    assert imported.settings.image_size == (32, 24)
    with pytest.raises(DataError, match="cyl: is an imported set"):
        imported.rendered  # noqa: B018
    with pytest.raises(DataError, match="tetX: is a rendered set"):
        rendered.imported  # noqa: B018
    with pytest.raises(DataError, match="imported"):
        SetPlan.behind(imported, load_object("cyl"))


def test_typed_arrays_of_a_shard_are_those_that_h5py_reads(tetX_set):
    manifest = read_manifest(tetX_set)
    for entry in manifest.shards:
        with open_shard(tetX_set / entry.file) as shard, h5py.File(tetX_set / entry.file) as file:
            labels = shard.labels()
            for name in ("rotation", "marking_pixels", "part_pixels"):
                np.testing.assert_array_equal(getattr(labels, name), file[name][...])
            np.testing.assert_array_equal(labels.symmetry_group, file.attrs["symmetry_group"])
            if manifest.is_annotated(entry.split):
                np.testing.assert_array_equal(labels.symmetry_mask, file["symmetry_mask"][...])
            else:
                assert labels.symmetry_mask is None
            np.testing.assert_array_equal(np.stack(list(shard.rows("segmentation"))), file["segmentation"][...])
            assert (shard.first_index, shard.tolerance_px) == (file.attrs["first_index"], file.attrs["tolerance_px"])
            assert shard.candidates_drawn == file.attrs["candidates_drawn"]


def test_what_an_imported_shard_does_not_know_is_none(tmp_path):
    files, _ = symsol_source.content(("tetX",))
    (made,) = import_symsol(symsol_source.write_zip(tmp_path / "symsol.zip", files), tmp_path / "sets")
    with open_shard(made.folder / made.manifest.shards[0].file) as shard:
        labels = shard.labels()
        assert {labels.marking_pixels, labels.part_pixels, labels.symmetry_mask} == {None}
        assert (shard.segmentation, shard.depth, shard.parts) == (None, None, ())
        assert np.isnan(shard.tolerance_px)


def test_other_settings_are_another_set():
    manifest = make_plan("tetX").manifest()
    other = replace(manifest, settings=replace(manifest.settings, tolerance_px=4.0))
    assert other.plan_sha256 != manifest.plan_sha256
    assert manifest.differences(other) == ["tolerance_px: there 4.0, asked for 5.0"]
