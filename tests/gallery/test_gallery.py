"""Galleries as files: pictures, columns and points are the set's and the scorer's; whole or not at all."""

import base64
import errno
import json
import re
import shutil
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import pytest
import symsol_source
from bench_sets import SIZE, DiscRenderer, small_set
from made_sets import make_plan, make_set, threads
from numpy_renderer import NumpyRenderer
from PIL import Image
from scipy.spatial.transform import Rotation
from symsol_annot_cli.main import main

from symsol_annot import load
from symsol_annot.bench.predictions import proposals as predicted
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import (
    DataError,
    MissingExtraError,
    NotAnnotatedError,
    OutputError,
    PredictionsError,
    RendererCrashedError,
    RendererMissingError,
    ScoresError,
)
from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import folder_name, open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.symsol.importing import import_symsol
from symsol_annot.system import machine
from symsol_annot.system.locks import locked

COLOURS = {(0, 0, 0): 0, (140, 30, 30): 1, (240, 128, 128): 2}  # of a segmentation, by hand


def documents(path):
    """What a script delivers: key to document."""
    text = path.read_text(encoding="ascii")
    assert re.fullmatch(r"SYMSOL\.deliver\(.*\);\n", text)
    key, document = json.loads(f"[{text[len('SYMSOL.deliver(') : -3]}]")
    return key, document


def array(document):
    return np.frombuffer(base64.b64decode(document["data"]), dtype=f"<{document['dtype']}")


def rotations(document):
    quat_wxyz = array(document).reshape(-1, 4).astype(float)
    return Rotation.from_quat(quat_wxyz[:, [1, 2, 3, 0]]).as_matrix() if len(quat_wxyz) else np.zeros((0, 3, 3))


def angles(a, b):
    return np.degrees(np.linalg.norm(Rotation.from_matrix(a @ np.swapaxes(b, -1, -2)).as_rotvec(), axis=-1))


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    """A folder of two sets: tetX with both splits, cylO with one."""
    folder = tmp_path_factory.mktemp("place") / "data"
    make_set(folder, train=3, test=104, size=SIZE, annotate="all")
    small_set(folder, "cylO", 6)
    return folder


@pytest.fixture(scope="module")
def preds(data, tmp_path_factory):
    """A file with every track about tetX, and one about cylO; of the hypotheses every third is absent."""
    folder = tmp_path_factory.mktemp("preds")
    rng = np.random.default_rng(1)
    for name in ("tetX", "cylO"):
        dataset = load(data / name)
        hypotheses = uniform_rotations(5 * len(dataset), rng).reshape(-1, 5, 3, 3)
        weights = np.tile([1.0, 0.5, 0.0, 0.25, 0.125], (len(dataset), 1))
        write_hypotheses(folder / f"{name}.h5", dataset, hypotheses, weights=weights, method="mine")
    options = {"method": "mine", "level": 1}
    write_classifier(folder / "tetX.h5", load(data / "tetX"), lambda i, R: 0.5 + 0.5 * R[:, 0, 0], **options)
    write_density(folder / "tetX.h5", load(data / "tetX"), lambda i, R: 9.0 * R[:, 0, 0], **options)
    return {name: folder / f"{name}.h5" for name in ("tetX", "cylO")}


def numpy_redrawer(source, runs, count=2):
    def open_renderer(spec, camera, settings):
        return DiscRenderer(camera.width) if spec.name == "cylO" else NumpyRenderer(spec.name, camera.width)

    return Redrawer(source, runs, count, open_renderer=open_renderer)


@pytest.fixture(scope="module")
def gallery(data, preds, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "gallery"
    sources = open_sources(data, ("train", "test"))
    write_gallery(out, sources, read_runs(list(preds.values()), data, sources), numpy_redrawer)
    return out


@pytest.fixture(scope="module")
def index(gallery):
    key, document = documents(gallery / "data" / "index.js")
    assert key == "index"
    return document


def set_of(index, name, split="test"):
    return next(one for one in index["sets"] if (one["object"], one["split"]) == (name, split))


def run_of(index, track, name="tetX"):
    found = enumerate(index["runs"])
    return next((n, run) for n, run in found if run["track"] == track and index["sets"][run["set"]]["object"] == name)


# --- what it holds ---


def test_a_gallery_shows_every_split_that_was_asked_for_and_is_there(index):
    found = [(one["object"], one["split"], one["images"]) for one in index["sets"]]
    assert found == [("cylO", "test", 6), ("tetX", "train", 3), ("tetX", "test", 104)]


@pytest.mark.parametrize(("here", "given"), [(".", "tetX"), ("tetX", "."), ("..", "data/tetX")])
def test_a_set_is_found_again_under_the_folder_that_was_given(monkeypatch, data, tmp_path, here, given):
    monkeypatch.chdir(data / here)
    write_gallery(tmp_path / "out", open_sources(Path(given)))
    _, index = documents(tmp_path / "out" / "data" / "index.js")
    (place,) = (one["place"] for one in index["sets"])
    assert place == given
    assert len(load(place)) == 104


def test_pictures_are_the_sets_pixel_for_pixel(gallery, index, data):
    for i, sample in enumerate(load(data / "tetX")):
        folder = gallery / set_of(index, "tetX")["folder"] / f"{i // index['chunk_images']:05d}"
        with Image.open(folder / f"image-{i:06d}.png") as picture:
            assert np.array_equal(np.asarray(picture), sample.image)
        with Image.open(folder / f"segmentation-{i:06d}.png") as picture:
            coloured = np.asarray(picture.convert("RGB")).reshape(-1, 3)
            ids = np.array([COLOURS[tuple(colour)] for colour in coloured.tolist()])
            assert np.array_equal(ids.reshape(sample.segmentation.shape), sample.segmentation)


def test_labels_give_every_images_set(gallery, index, data):
    for name in ("tetX", "cylO"):
        about = set_of(index, name)
        group = rotations(about["group"])
        for i, sample in enumerate(load(data / name)):
            chunk = f"{about['folder']}/{i // 100:05d}/labels"
            key, labels = documents(gallery / f"{chunk}.js")
            assert key == chunk
            masks = np.unpackbits(array(labels["mask"]), bitorder="little").reshape(-1, 8 * -(-len(group) // 8))
            members = rotations(labels["quat_wxyz"])[i % 100] @ group[np.flatnonzero(masks[i % 100])]
            assert len(members) == len(sample.symmetry_set)
            assert angles(members, sample.symmetry_set).max() < 1e-3


def test_columns_are_those_of_the_csv_of_the_scorer(index, data, preds):
    for name in ("tetX", "cylO"):
        truth = score_file(preds[name], data).truth
        about = set_of(index, name)
        codes = np.array(index["strata"])[array(about["stratum"])]
        assert np.array_equal(codes == "hidden", truth.strata["hidden"])
        assert np.array_equal(codes == "barely", truth.strata["barely"])
        assert np.array_equal(codes == "shown", truth.strata["shown"] & ~truth.strata["barely"])
        assert np.array_equal(array(about["set_size"]), truth.set_sizes)
        assert np.array_equal(array(about["marking_px"]), truth.labels.marking_pixels)


def test_scores_are_the_scorers(index, data, preds):
    scores = score_file(preds["tetX"], data)
    for track, result in scores.tracks.items():
        _, run = run_of(index, track)
        assert run["name"] == result.name
        assert run["warnings"] == list(result.warnings)
        assert len(run["metrics"]) >= 5
        for metric in run["metrics"]:
            expected = result.per_image.values[metric["name"]]
            assert np.allclose(array(metric["values"]), expected, rtol=1e-6, equal_nan=True)
            for stratum, mean in metric["means"].items():
                value = result.figures[stratum][metric["name"]].value
                assert mean is None if np.isnan(value) else mean == pytest.approx(value, rel=1e-5)


def test_no_two_figures_of_an_image_are_the_same_by_definition(index):
    names = [metric["name"] for metric in run_of(index, "hypotheses")[1]["metrics"]]
    assert "recall_mean_error_rad" in names
    assert "recall_mean_error_image_mean_rad" not in names  # differs in the mean over images alone


def points(gallery, index, track, i, name="tetX"):
    n, run = run_of(index, track, name)
    _, document = documents(gallery / index["sets"][run["set"]]["folder"] / f"{i // 100:05d}" / f"run-{n}.js")
    offsets = array(document["offsets"])
    rows = slice(offsets[i % 100], offsets[i % 100 + 1])
    return rotations(document["quat_wxyz"])[rows], array(document["weights"])[rows], document["left_out"][i % 100]


def test_hypotheses_are_drawn_by_weight_and_absent_ones_are_not(gallery, index, preds):
    with h5py.File(preds["tetX"]) as file:
        for i in (0, 99, 100, 103):
            found, weights, left_out = points(gallery, index, "hypotheses", i)
            assert left_out == 0
            assert angles(found, file["hypotheses"][i][[0, 1, 3, 4]]).max() < 0.02
            assert weights.tolist() == [255, 128, 64, 32]


def test_a_classifiers_claims_are_drawn_of_candidates_and_of_the_grid(gallery, index, data):
    dataset, grid = load(data / "tetX"), equivolumetric_grid(1)
    for i in (1, 103):
        candidates = dataset[i].rotation @ dataset.symmetry_group
        expected = [R for R in np.concatenate([candidates, grid]) if 0.5 + 0.5 * R[0, 0] > 0.8]
        found, _, left_out = points(gallery, index, "classifier", i)
        assert len(found) == len(expected)
        assert left_out == 0
        assert max(angles(R, found).min() for R in expected) < 0.02


def test_the_densest_cells_are_drawn_and_the_others_counted(gallery, index, preds):
    with h5py.File(preds["tetX"]) as file:
        rows = slice(*file["density_offsets"][2:4])
        logs = file["density_log_probabilities"][rows]
        cells = equivolumetric_grid(1)[file["density_indices"][rows]]
    seen = logs >= logs.max() + np.log(0.01)
    found, weights, left_out = points(gallery, index, "density", 2)
    assert len(found) == seen.sum() < len(logs)
    assert left_out == len(logs) - seen.sum()
    assert max(angles(R, found).min() for R in cells[seen]) < 0.02
    assert weights[0] == 255
    assert (np.diff(weights.astype(int)) <= 0).all()


def test_more_rotations_than_a_plot_holds_are_counted(monkeypatch, data, preds):
    monkeypatch.setattr(predicted, "MAX_ROTATIONS", 3)
    (run,) = read_runs([preds["cylO"]], data, open_sources(data / "cylO"))
    assert {(len(one.weights), one.left_out) for one in run.predicted} == {(3, 1)}
    assert run.predicted[0].weights.tolist() == [1.0, 0.5, 0.25]


def test_the_first_images_of_a_split_can_be_had_with_the_scores_of_those(data, preds, tmp_path):
    sources = open_sources(data, limit=4)
    write_gallery(tmp_path / "out", sources, read_runs([preds["tetX"]], data, sources))
    _, index = documents(tmp_path / "out" / "data" / "index.js")
    assert [(one["images"], one["images_of_split"]) for one in index["sets"]] == [(4, 6), (4, 104)]
    values = score_file(preds["tetX"], data).tracks["hypotheses"].per_image.values["recall_mean_error_rad"]
    assert np.allclose(array(run_of(index, "hypotheses")[1]["metrics"][0]["values"]), values[:4])


# --- what is drawn again ---


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


def refuse(error):
    def open_renderer(spec, camera, settings):
        raise error

    return open_renderer


def test_without_a_renderer_the_page_says_why(data, tmp_path):
    source = open_sources(data / "tetX")[0]
    redrawer = partial(Redrawer, count=2, open_renderer=refuse(RendererMissingError("there is no bpy here")))
    write_gallery(tmp_path / "out", [source], open_redrawer=redrawer)
    _, index = documents(tmp_path / "out" / "data" / "index.js")
    assert index["sets"][0]["redrawn"] == {"images": [], "missing": "there is no bpy here"}
    assert not list((tmp_path / "out").rglob("redrawn*"))


def test_a_set_of_an_unknown_or_changed_object_is_shown_without_drawing(data, tmp_path):
    for change, reason in (
        ({"object": "mug"}, "not built in"),
        ({"object_sha256": "0" * 64}, "another tetX"),
    ):
        source = open_sources(data / "tetX")[0]
        manifest = source.dataset.manifest
        source.dataset.manifest = replace(manifest, settings=replace(manifest.settings, **change))
        redrawer = numpy_redrawer(source, [])
        assert reason in redrawer.missing
        assert redrawer.images == ()


@pytest.fixture(scope="module")
def mugs(tmp_path_factory):
    """Two objects of one name, neither of them built in, and a set of the first; all of them draw like tetX."""
    place = tmp_path_factory.mktemp("mugs")
    for folder, title in (("mug", "a mug"), ("other", "another mug")):
        shutil.copytree(load_object("tetX").folder, place / folder)
        text = (place / folder / "object.toml").read_text()
        text = text.replace('name = "tetX"', 'name = "mug"').replace("regular tetrahedron", title)
        (place / folder / "object.toml").write_text(text)
    generate(
        make_plan(str(place / "mug"), test=3, size=SIZE), place / "set", threads(partial(NumpyRenderer, "tetX", SIZE))
    )
    return place


def test_an_object_that_is_not_built_in_is_drawn_by_what_was_given_if_it_is_the_same(mugs):
    source, drawn = open_sources(mugs / "set")[0], []

    def open_renderer(spec, camera, settings):
        drawn.append(spec.digest)
        return NumpyRenderer("tetX", camera.width)

    mug, other = (load_object(str(mugs / name)) for name in ("mug", "other"))
    redrawer = Redrawer(source, [], 2, given=mug, open_renderer=open_renderer)
    assert (redrawer.missing, redrawer.images) == ("", (0, 2))
    assert drawn == [mug.digest]
    assert all(drawing.differing_px == 0 for drawing in redrawer.draw(source.dataset[0]) if drawing.is_member)
    for given, reason in ((None, "is not built in"), (other, "was made from another mug")):
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


# --- the folder ---


def test_a_gallery_is_replaced_by_the_next_and_nothing_lies_beside_it(data, tmp_path):
    out = tmp_path / "gallery"
    write_gallery(out, open_sources(data))
    write_gallery(out, open_sources(data / "tetX"))
    assert [path.name for path in tmp_path.iterdir()] == ["gallery"]
    assert [path.name for path in (out / "sets").iterdir()] == ["00-tetX-test"]


def test_a_gallery_that_fails_leaves_the_old_one_as_it_was(data, tmp_path):
    out = tmp_path / "gallery"
    write_gallery(out, open_sources(data / "tetX"))
    before = sorted(str(path) for path in out.rglob("*"))

    def crash():
        raise RendererCrashedError("Blender stopped")

    for target in (out, tmp_path / "new"):
        with pytest.raises(RendererCrashedError):
            write_gallery(target, open_sources(data / "tetX"), on_image=crash)
    assert sorted(str(path) for path in out.rglob("*")) == before
    assert [path.name for path in tmp_path.iterdir()] == ["gallery"]


def everything(folder):
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("stop", "seen"), [(OSError(errno.EIO, "the disk is gone"), OutputError), (KeyboardInterrupt(), KeyboardInterrupt)]
)
@pytest.mark.parametrize("moved", ["gallery", "new"])
def test_a_gallery_that_cannot_take_its_name_brings_back_the_old_one(data, tmp_path, monkeypatch, moved, stop, seen):
    out, rename = tmp_path / "gallery", Path.rename
    write_gallery(out, open_sources(data / "tetX"))
    before = everything(out)

    def stopped(path, target):
        if path.name == moved:
            raise stop
        return rename(path, target)

    monkeypatch.setattr(Path, "rename", stopped)
    with pytest.raises(seen):
        write_gallery(out, open_sources(data / "cylO"))
    assert everything(out) == before
    assert [path.name for path in tmp_path.iterdir()] == ["gallery"]


def test_a_folder_that_another_process_writes_is_left_to_it(data, tmp_path):
    out = tmp_path / "gallery"
    out.mkdir()
    with locked(out), pytest.raises(OutputError, match=r"another process .*is writing there right now"):
        write_gallery(out, open_sources(data / "tetX"))
    assert list(out.iterdir()) == []


@pytest.mark.parametrize("target", ["there", "not there"])
def test_behind_a_link_the_folder_is_written_that_it_leads_to(data, tmp_path, target):
    link, out = tmp_path / "link", tmp_path / "elsewhere" / "gallery"
    if target == "there":
        write_gallery(out, open_sources(data / "cylO"))
    link.symlink_to(out)
    write_gallery(link, open_sources(data / "tetX"))
    assert link.is_symlink()
    assert [path.name for path in (out / "sets").iterdir()] == ["00-tetX-test"]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["elsewhere", "link"]
    assert [path.name for path in out.parent.iterdir()] == ["gallery"]


def test_a_folder_that_holds_something_else_is_not_touched(data, tmp_path):
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(OutputError, match=r"no part of a gallery: thesis\.tex\. Nothing was touched"):
        write_gallery(tmp_path, open_sources(data))
    with pytest.raises(OutputError, match="is a file"):
        write_gallery(tmp_path / "thesis.tex", open_sources(data))
    assert everything(tmp_path) == {"thesis.tex": b"years of work"}


@pytest.mark.parametrize("index", ["export default {}", "SYMSOL.deliver('index', {})", ""])
def test_a_project_of_somebodys_is_not_taken_for_a_gallery(data, tmp_path, index):
    for name, text in {"data/index.js": index, "index.html": "<h1>mine</h1>", "thesis.tex": "years of work"}.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
        before = everything(tmp_path)
        with pytest.raises(OutputError, match="no part of a gallery"):
            write_gallery(tmp_path, open_sources(data / "tetX"))
        assert everything(tmp_path) == before


@pytest.mark.parametrize(
    "name",
    ["notes.md", "data/notes.md", "sets/00-cylO-test/00000/notes.md", ".git/config", "assets/mine/a.js", "mine/"],
)
def test_what_somebody_put_into_a_gallery_is_not_removed(gallery, data, tmp_path, name):
    out = shutil.copytree(gallery, tmp_path / "gallery")
    (out / name).parent.mkdir(exist_ok=True)
    if name.endswith("/"):
        (out / name).mkdir()
    else:
        (out / name).write_text("mine")
    before = everything(out)
    with pytest.raises(OutputError, match=re.escape(name)):
        write_gallery(out, open_sources(data / "tetX"))
    assert (out / name).exists()
    assert everything(out) == before


@pytest.mark.parametrize("name", ["index.html", "sets/00-cylO-test/00000/image-000000.png", "data/SHA256SUMS"])
def test_a_file_of_a_gallery_that_somebody_changed_is_not_removed(gallery, data, tmp_path, name):
    out = shutil.copytree(gallery, tmp_path / "gallery")
    (out / name).write_bytes((out / name).read_bytes() + b"mine")
    before = everything(out)
    with pytest.raises(OutputError, match="Nothing was touched"):
        write_gallery(out, open_sources(data / "tetX"))
    assert everything(out) == before


@pytest.mark.parametrize("name", [".DS_Store", "sets/.DS_Store", "._index.html", "assets/Thumbs.db"])
def test_what_the_system_keeps_in_a_gallery_stays(gallery, data, tmp_path, name):
    out = shutil.copytree(gallery, tmp_path / "gallery")
    (out / name).write_bytes(b"icons")
    write_gallery(out, open_sources(data / "tetX"))
    assert (out / name).read_bytes() == b"icons"
    write_gallery(out, open_sources(data / "cylO"))
    assert (out / name).read_bytes() == b"icons"


def test_all_that_a_gallery_holds_is_known_as_its_own(gallery, data, tmp_path):
    out = shutil.copytree(gallery, tmp_path / "gallery")  # with runs, and with candidates drawn again
    write_gallery(out, open_sources(data / "cylO"))
    assert [path.name for path in (out / "sets").iterdir()] == ["00-cylO-test"]


def test_equal_sets_give_equal_bytes(data, preds, tmp_path):
    for name in ("a", "b"):
        sources = open_sources(data)
        write_gallery(tmp_path / name, sources, read_runs([preds["tetX"]], data, sources), numpy_redrawer)
    files = [path.relative_to(tmp_path / "a") for path in (tmp_path / "a").rglob("*") if path.is_file()]
    assert len(files) > 200
    assert all((tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes() for file in files)


@pytest.mark.parametrize("name", ["../../etc", "a/b", "a\\b", "<b>", "..", "", "x" * 300, "caf\u00e9"])
def test_whatever_an_objects_name_it_gets_one_folder(name):
    assert re.fullmatch(r"sets/07-[A-Za-z0-9._-]{0,40}-test", folder_name(7, name, "test"))


# --- what is refused ---


def test_predictions_about_images_that_are_not_shown_are_refused(data, preds, tmp_path):
    with pytest.raises(PredictionsError, match="is about tetX test, which the gallery does not show; it shows cylO"):
        read_runs([preds["tetX"]], data, open_sources(data / "cylO"))


def test_the_same_predictions_twice_are_refused(data, preds):
    with pytest.raises(ScoresError, match="give each once"):
        read_runs([preds["cylO"], preds["cylO"]], data, open_sources(data))


def test_a_folder_without_such_a_split_is_refused(data, tmp_path):
    with pytest.raises(DataError, match="has no split train"):
        open_sources(data / "cylO", ("train",))
    with pytest.raises(DataError, match="holds no manifest"):
        open_sources(tmp_path)


def test_a_split_without_sets_is_refused(tetX_set):
    with pytest.raises(NotAnnotatedError, match="--annotate all"):
        open_sources(tetX_set, ("train",))


def test_without_plotly_the_message_names_the_extra(monkeypatch, data, tmp_path):
    monkeypatch.setattr(machine, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=re.escape("pip install 'symsol-annot[gallery]'")):
        write_gallery(tmp_path / "out", open_sources(data))
    assert not (tmp_path / "out").exists()


# --- the command ---


@pytest.fixture
def call(monkeypatch, capfd):
    """The command's entry point in this process: exit status, output, messages."""

    def run(*words):
        monkeypatch.setattr(sys, "argv", ["symsol-annot", "gallery", *(str(word) for word in words)])
        with pytest.raises(SystemExit) as ended:
            main()
        return ended.value.code, *capfd.readouterr()

    return run


def test_the_command_writes_the_folder_and_says_where(call, data, preds, tmp_path):
    out = tmp_path / "page"
    words = (data, "--predictions", preds["tetX"], "--redrawn", "0", "--out", out)
    assert call(*words) == (0, f"{out / 'index.html'}: 110 images, 3 runs\n", "")
    _, index = documents(out / "data" / "index.js")
    assert {one["redrawn"]["missing"] for one in index["sets"]} == {"none were asked for"}
    code, _, message = call(data, "--predictions", tmp_path / "none.h5", "--out", out)
    assert (code, message.count("Error:")) == (1, 1)
    assert call(data, "--split", "validation")[0] == 2


@pytest.mark.parametrize(("name", "reason"), [("mug", ""), ("other", "was made from another mug")])
def test_the_command_draws_with_the_object_that_it_is_given(monkeypatch, call, mugs, tmp_path, name, reason):
    drawn_by_numpy = partial(Redrawer, open_renderer=lambda spec, camera, settings: NumpyRenderer("tetX", camera.width))
    monkeypatch.setattr("symsol_annot_cli.gallery.Redrawer", drawn_by_numpy)
    assert call(mugs / "set", "--object", mugs / name, "--out", tmp_path / "page")[0] == 0
    _, index = documents(tmp_path / "page" / "data" / "index.js")
    redrawn = index["sets"][0]["redrawn"]
    assert redrawn["images"] == ([] if reason else [0, 1, 2])
    assert reason in redrawn["missing"]
