"""`render --depth` with real Blender: what it stores, who says so, and who refuses."""

import numpy as np
import pytest
from command_line import TINY_SET, symsol

import symsol_annot


@pytest.mark.blender
def test_depth_is_stored_told_and_drawn_again(tmp_path):
    made = symsol("render", *TINY_SET, "--depth", "--out", tmp_path)
    assert made.returncode == 0, made.stderr
    folder = tmp_path / "tetX"
    assert "maps         segmentation into body, marking; depth" in symsol("info", folder).stdout.splitlines()
    checked = symsol("verify", folder, "--audit", "1")
    assert (checked.returncode, checked.stderr) == (0, "")
    for sample in symsol_annot.load(folder):
        is_object = sample.segmentation > 0
        assert np.array_equal(sample.depth > 0, is_object)
        assert 3.0 <= sample.depth[is_object].min() < sample.depth[is_object].max() <= 5.0  # a unit sphere, 4 away
    again = symsol("render", *TINY_SET, "--out", tmp_path)
    assert again.returncode == 1
    assert "'depth': True" in again.stderr


def test_an_engine_that_tells_no_depth_is_refused(tmp_path, here):
    done = here("render", *TINY_SET, "--engine", "cycles", "--depth", "--out", tmp_path)
    assert done.returncode == 1
    assert "depth: the engine cycles does not tell it; opengl does" in done.stderr
    assert list(tmp_path.iterdir()) == []


def test_a_set_without_depth_says_so(tetX_set, here):
    lines = here("info", tetX_set).stdout.splitlines()
    assert "maps         segmentation into body, marking; no depth" in lines
    assert "format       version 2" in lines
