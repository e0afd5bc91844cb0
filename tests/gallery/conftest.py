"""Fixtures of galleries, which are made once per session: sets, predictions about them, and the gallery of both."""

import shutil
from functools import partial

import numpy as np
import pytest
from balls import capped_set
from bench_sets import SIZE, small_set
from gallery_files import documents, numpy_redrawer
from made_sets import make_plan, make_set, threads
from numpy_renderer import NumpyRenderer

from symsol_annot import load
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rotations.so3 import uniform_rotations


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A folder of two sets: tetX with both splits, cylO with one."""
    folder = tmp_path_factory.mktemp("place") / "data"
    make_set(folder, train=3, test=104, size=SIZE, annotate="all")
    small_set(folder, "cylO", 6)
    return folder


@pytest.fixture(scope="session")
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


@pytest.fixture(scope="session")
def gallery(data, preds, tmp_path_factory):
    out = tmp_path_factory.mktemp("out") / "gallery"
    sources = open_sources(data, ("train", "test"))
    write_gallery(out, sources, read_runs(list(preds.values()), data, sources), numpy_redrawer)
    return out


@pytest.fixture(scope="session")
def index(gallery):
    key, document = documents(gallery / "data" / "index.js")
    assert key == "index"
    return document


@pytest.fixture(scope="session")
def mugs(tmp_path_factory):
    """Two objects of one name, neither of them built in, and a set of the first; all of them draw like tetX."""
    place = tmp_path_factory.mktemp("mugs")
    for folder, title in (("flask", "a flask"), ("other", "another flask")):
        shutil.copytree(load_object("tetX").folder, place / folder)
        text = (place / folder / "object.toml").read_text()
        text = text.replace('name = "tetX"', 'name = "flask"').replace("regular tetrahedron", title)
        (place / folder / "object.toml").write_text(text)
    generate(
        make_plan(str(place / "flask"), test=3, size=SIZE), place / "set", threads(partial(NumpyRenderer, "tetX", SIZE))
    )
    return place


@pytest.fixture(scope="session")
def balls(tmp_path_factory):
    """A gallery of a ball with a red cap, and its images: where they hide the cap, their sets fill a volume."""
    place = tmp_path_factory.mktemp("balls")
    thing = capped_set(place)
    write_gallery(place / "page", open_sources(thing.parent))
    images = load(thing, "test")
    assert set(images.labels().volume.tolist()) == {-1, 0}
    return place / "page", images
