"""The mug of the examples, drawn by Blender: its sets are those of all 360 candidates drawn and compared."""

import runpy
from pathlib import Path

import numpy as np
import pytest

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotations_about

FOLDER = Path(__file__).parents[2] / "examples" / "mug"
pytestmark = pytest.mark.blender
CAMERA, SETTINGS = Camera.filling(64), RenderSettings()


@pytest.fixture(scope="module")
def spec():
    return read_object(FOLDER)


@pytest.fixture(scope="module")
def renderer(spec):
    with RenderProcess(spec, CAMERA, SETTINGS) as process:
        yield process


def test_the_mesh_is_what_its_script_builds_and_has_the_symmetry_it_states(spec):
    assert runpy.run_path(str(FOLDER / "build.py"))["build"]() == (FOLDER / "mesh.obj").read_text()
    check_object(spec)
    assert [part.name for part in spec.parts] == ["body", "handle"]
    assert len(spec.symmetry_group) == 360
    assert len(spec.stabiliser) == 1


def canvases(renderer, R):
    """Ids and colours around the handle, each candidate's on a lattice of the whole picture."""
    side = 2 * CAMERA.width + 1
    for lit in (lit for start in range(0, len(R), 60) for lit in renderer.lit_windows(R[start : start + 60])):
        ids, rgb = np.zeros((side, side), int), np.zeros((side, side, 3), int)
        ids[lit.window.slices], rgb[lit.window.slices] = lit.ids, lit.rgb
        yield ids, rgb


def tilted(azimuth_deg, tilt_deg):
    """The mug upright, turned about its axis, then tilted towards the camera."""
    upright = rotations_about([1, 0, 0], np.radians([90.0 + tilt_deg]))[0]
    return upright @ rotations_about([0, 0, 1], np.radians([azimuth_deg]))[0]


@pytest.mark.parametrize(("azimuth_deg", "tilt_deg"), [(90.0, 10.0), (270.0, 10.0), (0.0, -15.0), (250.0, 35.0)])
def test_sets_are_those_of_all_candidates_drawn(spec, renderer, azimuth_deg, tilt_deg):
    R_gt = tilted(azimuth_deg, tilt_deg)
    fast = Annotator.for_object(spec, CAMERA, SETTINGS, renderer).annotate(R_gt, 0.0)
    exhaustive = Annotator.for_object(spec, CAMERA, SETTINGS, renderer, exhaustive=True).annotate(R_gt, 0.0)
    drawn = [*canvases(renderer, R_gt @ spec.symmetry_group)]
    ids, rgb = drawn[0]
    differs = [
        np.count_nonzero(((ids == 2) | (i == 2)) & ((ids != i) | (np.abs(rgb - c).max(axis=-1) > 12))) for i, c in drawn
    ]
    expected = np.array(differs) / 4 < spec.tolerance_px
    np.testing.assert_array_equal(fast.mask, exhaustive.mask)
    if (ids == 2).any():  # on a circle, neighbours that the lattice cannot tell apart are no members
        assert fast.mask.sum() == 1
        assert np.all(np.isin(np.flatnonzero(expected), [*range(8), *range(353, 360)]))
    else:
        np.testing.assert_array_equal(fast.mask, expected)
        assert 1 < fast.mask.sum() < 360


def test_a_view_has_the_parts_in_their_colours(spec, renderer):
    view = renderer.render(tilted(0.0, 10.0))
    assert view.part_pixels.shape == (2,)
    assert (view.part_pixels > 50).all()
    assert set(np.unique(view.segmentation)) == {0, 1, 2}
    handle, body = (view.rgb[view.segmentation == part].astype(int) for part in (2, 1))
    assert (handle[:, 0] > handle[:, 2]).mean() > 0.8  # red against blue
    assert (body[:, 2] > body[:, 0]).mean() > 0.9
