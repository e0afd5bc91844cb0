"""Fixtures of the gallery's page: a gallery with a hostile name, and a Chromium that opens it."""

import numpy as np
import pytest
from bench_sets import SIZE, small_set
from gallery_browser import Page, chromium
from gallery_pages import HOSTILE, IMAGES
from made_sets import make_set
from numpy_renderer import NumpyRenderer

from symsol_annot import load
from symsol_annot.bench.predictions import truth as truth_module
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.rotations.so3 import uniform_rotations

BARELY_PX = 3000  # scaled to this size 15 px, and tetX shows its marking with 5 or more


@pytest.fixture(scope="module")
def barely_exists():
    """Images of 16 pixels in which the marking barely shows, which the real limit leaves none of."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(truth_module, "BARELY_PX", BARELY_PX)
        yield


@pytest.fixture(scope="module")
def data(tmp_path_factory, barely_exists):
    folder = tmp_path_factory.mktemp("place") / 'my "data"\\new'
    make_set(folder, train=4, test=IMAGES, size=SIZE, annotate="all")
    small_set(folder, "cylO", 3)
    return folder


@pytest.fixture(scope="module")
def preds(data, tmp_path_factory):
    path = tmp_path_factory.mktemp("preds") / "tetX.h5"
    hypotheses = uniform_rotations(4 * IMAGES, np.random.default_rng(3)).reshape(IMAGES, 4, 3, 3)
    write_hypotheses(path, load(data / "tetX"), hypotheses, method=HOSTILE)
    return path


@pytest.fixture(scope="module")
def gallery(data, preds, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "a gallery #1"

    def open_redrawer(source, runs):
        count = 2 if source.truth.object == "tetX" else 0
        return Redrawer(source, runs, count, open_renderer=lambda spec, camera, _: NumpyRenderer("tetX", camera.width))

    sources = open_sources(data, ("train", "test"))
    write_gallery(out, sources, read_runs([preds], data, sources), open_redrawer)
    return out


@pytest.fixture(scope="module")
def browser(tmp_path_factory):
    with chromium(tmp_path_factory.mktemp("chromium")) as driver:
        yield driver


@pytest.fixture
def page(browser, gallery):
    return Page(browser, gallery)
