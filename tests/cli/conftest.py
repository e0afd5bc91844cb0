"""Fixtures of the commands: a set that they made, and an object of one's own."""

import shutil
from importlib import resources
from pathlib import Path

import pytest
from command_line import REAL_SET, edit, symsol


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """A real set, made by the command, and what the command said."""
    out = tmp_path_factory.mktemp("rendered") / "data"
    return symsol("render", *REAL_SET, "--out", out), out / "tetX"


@pytest.fixture
def mug(tmp_path):
    """An object of one's own: the marked tetrahedron under another name."""
    folder = Path(shutil.copytree(str(resources.files("symsol_annot_assets") / "tetX"), tmp_path / "mug"))
    edit(folder / "object.toml", 'name = "tetX"', 'name = "mug"')
    return folder


@pytest.fixture
def make_bare_set():
    from made_sets import make_set

    return lambda folder: make_set(folder, test=2, annotate="none")
