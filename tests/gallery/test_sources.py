"""What a gallery shows: splits of sets that are there, have symmetry sets, and are found again."""

import re
from pathlib import Path

import numpy as np
import pytest
from gallery_files import array, documents, run_of

from symsol_annot import load
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import folder_name, open_sources
from symsol_annot.gallery.writing import write_gallery


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


def test_the_first_images_of_a_split_can_be_had_with_the_scores_of_those(data, preds, tmp_path):
    sources = open_sources(data, limit=4)
    write_gallery(tmp_path / "out", sources, read_runs([preds["tetX"]], data, sources))
    _, index = documents(tmp_path / "out" / "data" / "index.js")
    assert [(one["images"], one["images_of_split"]) for one in index["sets"]] == [(4, 6), (4, 104)]
    values = score_file(preds["tetX"], data).tracks["hypotheses"].per_image.values["recall_mean_error_rad"]
    assert np.allclose(array(run_of(index, "hypotheses")[1]["metrics"][0]["values"]), values[:4])


@pytest.mark.parametrize("name", ["../../etc", "a/b", "a\\b", "<b>", "..", "", "x" * 300, "caf\u00e9"])
def test_whatever_an_objects_name_it_gets_one_folder(name):
    assert re.fullmatch(r"sets/07-[A-Za-z0-9._-]{0,40}-test", folder_name(7, name, "test"))


def test_a_folder_without_such_a_split_is_refused(data, tmp_path):
    with pytest.raises(DataError, match="has no split train"):
        open_sources(data / "cylO", ("train",))
    with pytest.raises(DataError, match="holds no manifest"):
        open_sources(tmp_path)


def test_a_split_without_sets_is_refused(tetX_set):
    with pytest.raises(NotAnnotatedError, match="--annotate all"):
        open_sources(tetX_set, ("train",))
