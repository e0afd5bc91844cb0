"""What certainly shows of parts that stand out of the rest, without drawing."""

import numpy as np
import pytest
from mesh_renderer import MeshRenderer
from parted_objects import TOML, mug

from symsol_annot.annotation.standing_out import StandingOut, _inradii
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

CAMERA, SETTINGS = Camera.filling(32), RenderSettings()
POINT_PX = 1.0 / SETTINGS.points_per_pixel


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    folder = tmp_path_factory.mktemp("mug")
    (folder / "object.toml").write_text(TOML)
    (folder / "mesh.obj").write_text(mug())
    return read_object(folder)


def test_a_right_triangle_has_the_inradius_of_the_textbook_and_its_back_the_negative_one():
    front = np.array([[0.0, 0.0], [0.0, 3.0], [4.0, 0.0]])  # v runs downwards
    found = _inradii(np.stack([front, front[::-1], 2.0 * front + 7.0]))
    assert np.abs(found) == pytest.approx([1.0, 1.0, 2.0])
    assert found[0] * found[1] < 0
    assert found[0] * found[2] > 0


def test_what_is_said_to_show_is_seen_by_a_ray_caster(spec):
    R = uniform_rotations(60, np.random.default_rng(0))
    said = StandingOut(spec.mesh, CAMERA, SETTINGS).areas(R, POINT_PX)
    seen = MeshRenderer(spec, CAMERA).marking_pixels(R) > 0
    assert np.count_nonzero(said == POINT_PX) > 5
    assert seen[said == POINT_PX].all()
    assert np.isnan(said[said != POINT_PX]).all()


def test_a_point_decides_no_tolerance_that_is_larger(spec):
    R = uniform_rotations(60, np.random.default_rng(0))
    assert np.isnan(StandingOut(spec.mesh, CAMERA, SETTINGS).areas(R, 1.001 * POINT_PX)).all()
