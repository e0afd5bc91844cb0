"""Galleries as files: pictures and columns are the set's; whole or not at all, and nobody's files touched."""

import errno
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from gallery_files import angles, array, documents, everything, numpy_redrawer, rotations, set_of
from PIL import Image

from symsol_annot import load
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import MissingExtraError, OutputError, RendererCrashedError
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.system import machine
from symsol_annot.system.locks import locked

COLOURS = {(0, 0, 0): 0, (140, 30, 30): 1, (240, 128, 128): 2}  # of a segmentation, by hand


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


def test_a_volume_is_there_once_by_its_share_and_rotations_in_it(balls, index):
    folder, images = balls
    (about,) = documents(folder / "data" / "index.js")[1]["sets"]
    labels = images.labels()
    assert array(about["volume"]).tolist() == labels.volume.tolist()
    (told,), (volume,) = about["volumes"], labels.volumes
    assert told["share"] == pytest.approx(volume.measure, rel=1e-5)
    dots = rotations(told["quat_wxyz"])
    assert len(dots) == 500
    assert volume.distance(dots).max() < 1e-5
    assert {one["volume"] for one in index["sets"]} == {None}  # no set of theirs fills one
    assert all(one["volumes"] == [] for one in index["sets"])


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


def test_without_plotly_the_message_names_the_extra(monkeypatch, data, tmp_path):
    monkeypatch.setattr(machine, "find_spec", lambda name: None)
    with pytest.raises(MissingExtraError, match=re.escape("pip install 'symsol-annot[gallery]'")):
        write_gallery(tmp_path / "out", open_sources(data))
    assert not (tmp_path / "out").exists()
