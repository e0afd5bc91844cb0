"""Candidates drawn again: members draw the image, rejected ones another, and without a renderer the page says why."""

from dataclasses import replace
from functools import partial

import pytest
import symsol_source
from gallery_files import angles, array, documents, numpy_redrawer, refuse, set_of
from made_sets import make_set
from numpy_renderer import NumpyRenderer

from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import RendererMissingError
from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.objects.spec import load_object
from symsol_annot.symsol.importing import import_symsol


def test_members_draw_the_image_and_rejected_candidates_another(gallery, index):
    for name in ("tetX", "cylO"):
        about = set_of(index, name)
        _, drawings = documents(gallery / about["folder"] / "redrawn.js")
        assert [int(i) for i in drawings] == about["redrawn"]["images"]
        for side in drawings.values():
            for drawing in side:
                assert drawing["differing_px"] <= 2 if drawing["is_member"] else True
                assert (gallery / about["folder"] / drawing["file"]).is_file()
        shown = [i for i in drawings if array(about["stratum"])[int(i)] >= 2]
        far = [d for i in shown for d in drawings[i] if not d["is_member"] and d["angle_deg"] > 20]
        assert far
        assert all(drawing["differing_px"] for drawing in far)


def test_candidates_go_from_near_to_far_and_members_come_first(data):
    source = open_sources(data / "cylO")[0]
    redrawer = numpy_redrawer(source, [], count=6)
    for sample in source.dataset:
        drawn = redrawer.draw(sample)
        members = [d for d in drawn if d.is_member]
        assert drawn[: len(members)] == members
        own = sample.rotation @ sample.symmetry_group
        for d in drawn:
            near = sample.rotation[None] if d.is_member else sample.symmetry_set
            assert d.angle_deg == pytest.approx(angles(own[d.element], near).min(), abs=1e-4)
            assert sample.symmetry_mask[d.element] == d.is_member
        for side in (members, drawn[len(members) :]):
            assert [d.angle_deg for d in side] == sorted(d.angle_deg for d in side)
            assert len({d.element for d in side}) == len(side) <= 4
        assert 0 not in [d.element for d in drawn]  # the image itself


def test_with_predictions_the_worst_images_are_drawn_again(data, preds):
    sources = open_sources(data / "tetX")
    runs = read_runs([preds["tetX"]], data, sources)
    errors = score_file(preds["tetX"], data).tracks["hypotheses"].per_image.values["recall_mean_error_rad"]
    worst = sorted(range(len(errors)), key=lambda i: -errors[i])[:3]
    assert numpy_redrawer(sources[0], runs, count=3).images == tuple(sorted(worst))
    assert numpy_redrawer(sources[0], [], count=3).images == (0, 52, 103)


def test_without_a_renderer_the_page_says_why(data, tmp_path):
    source = open_sources(data / "tetX")[0]
    redrawer = partial(Redrawer, count=2, open_renderer=refuse(RendererMissingError("there is no bpy here")))
    write_gallery(tmp_path / "out", [source], open_redrawer=redrawer)
    _, index = documents(tmp_path / "out" / "data" / "index.js")
    assert index["sets"][0]["redrawn"] == {"images": [], "missing": "there is no bpy here"}
    assert not list((tmp_path / "out").rglob("redrawn*"))


def test_a_set_of_an_unknown_or_changed_object_is_shown_without_drawing(data, tmp_path):
    for change, reason in (
        ({"object": "flask"}, "not built in"),
        ({"object_sha256": "0" * 64}, "another tetX"),
    ):
        source = open_sources(data / "tetX")[0]
        manifest = source.dataset.manifest
        source.dataset.manifest = replace(manifest, settings=replace(manifest.settings, **change))
        redrawer = numpy_redrawer(source, [])
        assert reason in redrawer.missing
        assert redrawer.images == ()


def test_an_object_that_is_not_built_in_is_drawn_by_what_was_given_if_it_is_the_same(mugs):
    source, drawn = open_sources(mugs / "set")[0], []

    def open_renderer(spec, camera, settings):
        drawn.append(spec.digest)
        return NumpyRenderer("tetX", camera.width)

    mug, other = (load_object(str(mugs / name)) for name in ("flask", "other"))
    redrawer = Redrawer(source, [], 2, given=mug, open_renderer=open_renderer)
    assert (redrawer.missing, redrawer.images) == ("", (0, 2))
    assert drawn == [mug.digest]
    assert all(drawing.differing_px == 0 for drawing in redrawer.draw(source.dataset[0]) if drawing.is_member)
    for given, reason in ((None, "is not built in"), (other, "was made from another flask")):
        redrawer = Redrawer(source, [], 2, given=given, open_renderer=open_renderer)
        assert reason in redrawer.missing
        assert redrawer.images == ()
    assert drawn == [mug.digest]


def test_an_imported_set_has_no_segmentation_and_is_not_drawn_again(tmp_path):
    files, _ = symsol_source.content(("tet",))
    symsol_source.write_zip(tmp_path / "symsol.zip", files)
    list(import_symsol(tmp_path / "symsol.zip", tmp_path / "symsol", ["tet"]))
    sources = open_sources(tmp_path / "symsol")
    redrawer = partial(Redrawer, count=2, open_renderer=refuse(AssertionError))
    write_gallery(tmp_path / "out", sources, open_redrawer=redrawer)
    _, index = documents(tmp_path / "out" / "data" / "index.js")
    assert not index["sets"][0]["has_segmentation"]
    assert "was imported" in index["sets"][0]["redrawn"]["missing"]
    assert len(list((tmp_path / "out").rglob("image-*.png"))) == len(sources[0].dataset)
    assert not list((tmp_path / "out").rglob("segmentation-*.png"))


@pytest.mark.blender
def test_blender_draws_members_as_it_drew_the_image(tmp_path):
    source = open_sources(make_set(tmp_path, test=2, size=48))[0]
    redrawer = Redrawer(source, [], 2)
    assert redrawer.missing == ""
    try:
        drawn = [redrawer.draw(sample) for sample in source.dataset]
    finally:
        redrawer.close()
    assert all(d.differing_px <= 8 for side in drawn for d in side if d.is_member)
    assert all(d.differing_px > 8 for side in drawn for d in side if not d.is_member)
