"""Sets of an object of format version 2, from its files to what is loaded, verified and audited."""

import dataclasses
import json
from functools import partial

import numpy as np
import pytest
from click.testing import CliRunner
from made_sets import threads
from mesh_renderer import MeshRenderer
from parted_objects import TOML, drawn_set, mug, parted_toml
from symsol_annot_cli.info import info

from symsol_annot import load
from symsol_annot.errors import SealError
from symsol_annot.generation.audit import audit
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import read_object
from symsol_annot.plotting.contact_sheet import contact_sheet
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sealing.making import seal
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.membership import checked_shard
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.shard.laws import label_faults
from symsol_annot.sets.stated.equality import equality_stated
from symsol_annot.sets.verify import verify

IMAGES = 12
ONE_PART = parted_toml([("body", "clay", None)], 'of = []\nkind = "dihedral"\norder = 8')


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    folder = tmp_path_factory.mktemp("object")
    (folder / "object.toml").write_text(TOML)
    (folder / "mesh.obj").write_text(mug())
    return SetPlan(read_object(folder), {"test": IMAGES}, 0, Camera.filling(16), RenderSettings(), "test")


@pytest.fixture(scope="module")
def folder(plan, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sets") / "mug"
    generate(plan, folder, threads(partial(MeshRenderer, plan.spec, plan.camera)))
    return folder


def test_the_sets_of_a_mesh_without_a_part_of_the_group_are_those_of_whole_pictures(tmp_path):
    """A prism with a handle, all of one part: where the handle hides, the prism's rotations draw the same picture."""
    (tmp_path / "object.toml").write_text(ONE_PART)
    (tmp_path / "mesh.obj").write_text(mug().replace("usemtl grip", "usemtl clay"))
    spec = read_object(tmp_path)
    assert spec.mesh.breaking == (1,)
    plan = SetPlan(spec, {"test": IMAGES}, 0, Camera.filling(16), RenderSettings(), "test")
    renderer = MeshRenderer(spec, plan.camera)
    generate(plan, tmp_path / "set", threads(partial(MeshRenderer, spec, plan.camera)))
    sizes = set()
    for sample in load(tmp_path / "set", "test"):
        np.testing.assert_array_equal(sample.symmetry_mask, drawn_set(spec, renderer, sample.rotation))
        sizes.add(int(sample.symmetry_mask.sum()))
    assert min(sizes) == len(spec.stabiliser) == 2
    assert max(sizes) > 2


def test_a_set_holds_its_parts_and_the_sets_that_drawing_gives(plan, folder):
    assert verify(folder) == []
    images, renderer = load(folder, "test"), MeshRenderer(plan.spec, plan.camera)
    assert images.parts == ("body", "handle")
    assert read_manifest(folder).settings.equality.colours[1] == (0.1, 0.5, 0.2)
    for sample in images:
        assert sample.part_pixels.shape == (2,)
        assert sample.marking_pixels == sample.part_pixels[1]
        assert sample.marking_visible == (sample.part_pixels[1] >= 0.125)
        np.testing.assert_array_equal(sample.symmetry_mask, drawn_set(plan.spec, renderer, sample.rotation))
    shown = images.labels().marking_visible
    assert 0 < shown.sum() < len(shown)


def test_fast_and_exhaustive_sets_are_the_same_bytes(plan, folder, tmp_path):
    whole = threads(partial(MeshRenderer, plan.spec, plan.camera), exhaustive=True)
    assert generate(plan, tmp_path / "mug", whole).fingerprint == read_manifest(folder).fingerprint


def test_an_audit_finds_no_fault_in_a_good_set_and_one_in_a_wrong_one(plan, folder):
    images, renderer = load(folder, "test"), MeshRenderer(plan.spec, plan.camera)
    report = audit(images, plan, renderer, 4, np.random.default_rng(0))
    assert report.faults == []
    assert report.members >= 8
    assert report.rejected > 8

    class Wrong:
        """Rejects all but the image's own rotation, or takes all candidates in."""

        def __init__(self, *, takes_all):
            self.takes_all = takes_all

        def __getattr__(self, name):
            return getattr(images, name)

        def __len__(self):
            return len(images)

        def __getitem__(self, row):
            mask = np.full(len(plan.spec.symmetry_group), self.takes_all)
            mask[0] = True
            return dataclasses.replace(images[row], symmetry_mask=mask)

    rejects = audit(Wrong(takes_all=False), plan, renderer, 4, np.random.default_rng(0)).faults
    assert any("was rejected, but draws the same marking" in fault for fault in rejects)
    takes = audit(Wrong(takes_all=True), plan, renderer, 4, np.random.default_rng(0)).faults
    assert any("pixels of the segmentation differ" in fault for fault in takes)


def test_labels_that_break_a_law_are_found(folder):
    manifest = read_manifest(folder)
    shard, labels = checked_shard(folder, manifest, manifest.shards[0])
    torn = labels.symmetry_mask.copy()
    torn[:, shard.equality.stabiliser[1]] = False
    faults = [*label_faults(shard, dataclasses.replace(labels, symmetry_mask=torn))]
    assert any("lacks a rotation that differs from a member by one that maps each part" in fault for fault in faults)
    other = dataclasses.replace(labels, marking_pixels=labels.marking_pixels + 1)
    assert any("is not the largest of part_pixels" in fault for fault in label_faults(shard, other))


NO_EQUALITY = [{"parts": ["body"]}, {"breaking": [3]}, {"stabiliser": [1]}, {"colours": []}, {"x": 1}]


@pytest.mark.parametrize("change", NO_EQUALITY)
def test_a_shard_that_states_no_parts_of_an_object_is_refused(folder, change):
    manifest = read_manifest(folder)
    shard, _ = checked_shard(folder, manifest, manifest.shards[0])
    stated = shard.equality.to_json() | change
    with pytest.raises(ValueError, match="equality: "):
        equality_stated(json.dumps(stated))


def test_info_says_which_parts_show_and_how_large_sets_are_by_that(folder):
    out = CliRunner().invoke(info, [str(folder)]).output
    shown = int(load(folder, "test").labels().marking_visible.sum())
    assert "segmentation into body, handle" in out
    assert f"  handle shows in {shown} of {IMAGES}" in out
    assert "with handle in view: " in out
    assert "with none of these parts in view: " in out


def test_a_contact_sheet_has_a_colour_for_every_part(folder, tmp_path):
    contact_sheet(load(folder, "test")[:2], tmp_path / "sheet.png")
    assert (tmp_path / "sheet.png").stat().st_size > 1000


def test_a_sealed_test_of_an_object_with_parts_is_refused(plan, tmp_path):
    with pytest.raises(SealError, match="format version 2"):
        seal(plan, {}, tmp_path / "sealed")
