"""Fixtures: sets made with the numpy renderer, which cost little, and real ones, which are made once a session."""

import shutil
import sys
from functools import partial
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from numpy_renderer import NumpyRenderer

from symsol_annot.annotate import marking_pixels
from symsol_annot.generate import SetPlan, generate
from symsol_annot.objects import load_object
from symsol_annot.scene import Camera, RenderSettings

SIZE = 32


def make_plan(name="tetX", train=0, test=40, seed=0, size=SIZE, annotate="test"):
    return SetPlan(
        load_object(name), {"train": train, "test": test}, seed, Camera.filling(size), RenderSettings(), annotate
    )


def pixels_of(spec, R, renderer):
    """The area by which the image at R shows the marking, as a set would store it."""
    return marking_pixels(spec, R, float(renderer.marking_pixels(R[None])[0]), renderer) if spec.marking else 0.0


def make_set(folder, name="tetX", workers=1, **plan):
    """Make a set with the numpy renderer; the folder of the set is returned."""
    made = make_plan(name, **plan)
    generate(made, folder / name, partial(NumpyRenderer, name, made.camera.width), workers)
    return folder / name


@pytest.fixture(scope="session")
def _pristine(tmp_path_factory):
    """A small tetX set of both splits, 3 shards of test and 1 of train; not to be written to."""
    return make_set(tmp_path_factory.mktemp("pristine"), train=5, test=40)


@pytest.fixture
def tetX_set(_pristine, tmp_path):
    """A copy of a small tetX set that a test may damage."""
    return Path(shutil.copytree(_pristine, tmp_path / "tetX"))
