"""A ball of facets is drawn as the sphere that it stands for: by rays of this file, and by Blender."""

import numpy as np
import pytest

from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.frames.balls import BallPicture
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rendering.windows import Window
from symsol_annot.rotations.so3 import uniform_rotations

CAMERA = Camera.filling(64)
BODY, X, DISC = 1, 2, 3


def test_each_point_sees_what_its_ray_meets_first():
    ball = BallPicture.seen_by(CAMERA)
    for row, column in ((32, 32), (20, 41), (5, 30), (0, 0), (32, 60), (61, 32)):
        d = np.array([column + 0.5 - 32, row + 0.5 - 32, CAMERA.focal_px]) / CAMERA.focal_px
        along = np.linspace(2.5, 4.5, 200_001)  # of the axis
        points = along[:, None] * d - [0.0, 0.0, CAMERA.distance]
        met = np.flatnonzero(np.linalg.norm(points, axis=1) <= 1.0)
        assert ball.is_inside[row, column] == (len(met) > 0)
        expected = along[met[0]] if len(met) else 0.0
        assert ball.z[row, column] == pytest.approx(expected, abs=2e-5)
        light = 65535 * -points[met[0], 2] if len(met) else 0
        assert ball.light[row, column] == pytest.approx(light, abs=3)


def test_the_mesh_tells_the_parts_and_the_sphere_the_rest():
    ball = BallPicture.seen_by(CAMERA)
    window = Window(30, 0, 8, 6)
    words = np.zeros((6, 8), np.uint32)
    words[:, 2] = (X << 16) + 5  # a part, inside and beyond the outline
    words[:, 3] = (BODY << 16) + 7
    inside, drawn = ball.is_inside[window.slices], ball.cut(window).drawn_over(words)
    assert inside.any()
    assert not inside.all()
    ids = np.where(inside, BODY, 0)
    ids[:, 2] = X
    np.testing.assert_array_equal(drawn >> 16, ids)
    np.testing.assert_array_equal((drawn & 0xFFFF)[inside], ball.light[window.slices][inside])


def test_its_window_holds_all_points_that_see_it_and_no_more():
    ball = BallPicture.seen_by(CAMERA)
    assert ball.cut(ball.window).is_inside.sum() == ball.is_inside.sum()
    assert ball.window == Window(3, 3, 58, 58)  # of 90% of 64 pixels


@pytest.mark.blender
def test_pictures_of_sphereX_that_show_nothing_are_one_whatever_the_rotation_and_outlines_all_are():
    spec, rotations = load_object("sphereX"), uniform_rotations(24, np.random.default_rng(0))
    with RenderProcess(spec, CAMERA, RenderSettings("opengl", depth=True)) as renderer:
        views = [renderer.render(R) for R in rotations]
        windows = renderer.label_windows(rotations)
        counted = renderer.marking_pixels(rotations)
    hidden = [view for view in views if view.part_pixels[1:].sum() == 0]
    assert 3 < len(hidden) < 20
    for of_view in (lambda view: view.rgb, lambda view: view.segmentation, lambda view: view.depth):
        assert len({of_view(view).tobytes() for view in hidden}) == 1
    assert len({(view.segmentation > 0).tobytes() for view in views}) == 1
    for view, window, count in zip(views, windows, counted, strict=True):
        of_parts = [np.count_nonzero(window.ids == part) / 4 for part in (X, DISC)]
        assert view.part_pixels[1:].tolist() == of_parts
        assert sum(of_parts) == count
