"""Fixtures of the commands: a set that they made, and an object of one's own."""

import shutil
from importlib import resources
from pathlib import Path

import pytest
from bench_sets import small_set
from command_line import REAL_SET, edit, symsol
from score_commands import IMAGES

from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """A real set, made by the command, and what the command said."""
    out = tmp_path_factory.mktemp("rendered") / "data"
    return symsol("render", *REAL_SET, "--out", out), out / "tetX"


@pytest.fixture
def mug(tmp_path):
    """An object of one's own: the marked tetrahedron under another name."""
    folder = Path(shutil.copytree(str(resources.files("symsol_annot_assets") / "tetX"), tmp_path / "flask"))
    edit(folder / "object.toml", 'name = "tetX"', 'name = "flask"')
    return folder


@pytest.fixture
def make_bare_set():
    from made_sets import make_set

    return lambda folder: make_set(folder, test=2, annotate="none")


@pytest.fixture(scope="session")
def sets(tmp_path_factory):
    """Small test splits to be scored, by object."""
    folder = tmp_path_factory.mktemp("place") / "data"
    return {name: small_set(folder, name, images) for name, images in IMAGES.items()}


@pytest.fixture(scope="session")
def data(sets):
    """The folder of those sets."""
    return sets["tetX"].folder.parent


@pytest.fixture(scope="session")
def preds(sets, tmp_path_factory):
    """A file an object; the one of tetX has every track."""
    folder = tmp_path_factory.mktemp("preds")
    for name, dataset in sets.items():
        rotation = dataset.labels().rotation
        write_hypotheses(folder / f"{name}.h5", dataset, rotation[:, None], method="mine")
    options = {"method": "mine", "level": 0}
    write_classifier(folder / "tetX.h5", sets["tetX"], lambda i, R: R[:, 0, 0] > 0.5, **options)
    write_density(folder / "tetX.h5", sets["tetX"], lambda i, R: 3.0 * R[:, 0, 0], **options)
    return {name: folder / f"{name}.h5" for name in sets}
