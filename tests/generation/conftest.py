"""The set of four small shards: whole, half, and drawn without repeating oneself."""

import shutil
from pathlib import Path

import numpy_renderer
import oracle
import pytest
from four_shards import PER_SHARD, Opener, failing_at, small_plan
from made_sets import threads

from symsol_annot.errors import RenderError
from symsol_annot.generation.generate import generate


@pytest.fixture(scope="module")
def _drawn_once():
    """The tests draw the same few labels again and again; here each is drawn once."""
    drawn = {}

    def cast(name, R_m2c, *lattice):
        key = (name, R_m2c.tobytes(), *lattice)
        if key not in drawn:
            drawn[key] = oracle.cast(name, R_m2c, *lattice)
        return drawn[key].copy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numpy_renderer, "cast", cast)
        yield


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The small plan's set, made in one go; not to be written to."""
    folder = tmp_path_factory.mktemp("undisturbed") / "tet"
    generate(small_plan(), folder, threads(Opener()))
    return folder


@pytest.fixture(scope="module")
def _half(tmp_path_factory):
    folder = tmp_path_factory.mktemp("half") / "tet"
    with pytest.raises(RenderError):
        generate(
            small_plan(), folder, threads(Opener(on_frame=failing_at(2 * PER_SHARD + 1, RenderError("the lamp broke"))))
        )
    return folder


@pytest.fixture
def half(_half, tmp_path):
    """A folder that holds the first 2 of the small plan's 4 shards; a test may damage it."""
    return Path(shutil.copytree(_half, tmp_path / "half"))
