"""From samples to a view: averages by loops, areas and ids by counting."""

import numpy as np
import pytest

from symsol_annot.errors import RenderError, SettingsError
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.frames.shading import CornerLight, linear, srgb, srgb_bytes
from symsol_annot.rendering.frames.supersampling import lanes_of, part_pixels_of, pixel_averages, segmentation_of
from symsol_annot.rendering.renderer import Scene
from symsol_annot.rendering.settings import SAMPLES_PER_AXIS, RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

SETTINGS = RenderSettings()


def corner_light(mesh, lattice):
    return CornerLight(mesh, Scene(mesh, Camera.filling(224), SETTINGS).part_colours, lattice, SETTINGS)


@pytest.mark.parametrize("name", ["cylO", "tetX"])
def test_corners_are_lit_by_the_cosine_to_the_camera_axis(name):
    mesh = load_object(name).mesh
    R = uniform_rotations(1, np.random.default_rng(4))[0]
    colours = corner_light(mesh, Camera.filling(224).lattice(2)).colours(R)
    varying = np.ptp(colours, axis=1).any(axis=1) | (mesh.corner_normals == mesh.corner_normals[:, :1]).all(axis=(1, 2))
    assert varying.mean() > 0.5  # others look away, or are thin
    for triangle in np.flatnonzero(varying)[::7]:
        for corner in range(3):
            towards_camera = -(R @ mesh.corner_normals[triangle, corner])[2]
            colour = SETTINGS.marking_colour if mesh.is_marking[triangle] else SETTINGS.body_colour
            light = SETTINGS.ambient + SETTINGS.diffuse * max(0.0, towards_camera)
            assert np.allclose(colours[triangle, corner], [*(light * c for c in colour), 1.0], atol=1e-6)


def test_a_triangle_thinner_than_a_quarter_of_a_sample_has_one_colour():
    mesh, lattice = load_object("cyl").mesh, Camera.filling(224).lattice(2)
    R = uniform_rotations(1, np.random.default_rng(4))[0]
    points = lattice.project(mesh.vertices @ R.T)[mesh.triangles]
    colours = corner_light(mesh, lattice).colours(R)
    is_smooth = (mesh.corner_normals != mesh.corner_normals[:, :1]).any(axis=(1, 2))
    thin = 0
    for triangle in np.flatnonzero(is_smooth):
        (a, b, c) = points[triangle]
        longest = max(np.linalg.norm(b - a), np.linalg.norm(c - b), np.linalg.norm(a - c))
        height = abs(np.linalg.det([b - a, c - a])) / longest
        is_one_colour = not np.ptp(colours[triangle], axis=0).any()
        if height < 0.25:
            assert is_one_colour
            thin += 1
        elif (R @ mesh.corner_normals[triangle].T)[2].max() < 0:  # lit at all corners
            assert not is_one_colour
    assert thin > 4


@pytest.mark.parametrize("n", SAMPLES_PER_AXIS)
def test_a_pixel_is_the_trapezoidal_average_over_its_square(n):
    height, width = 3, 4
    samples = np.random.default_rng(n).integers(0, 256, (n * height + 1, n * width + 1, 3)).astype(np.uint8)
    weights = np.array([0.5, *[1.0] * (n - 1), 0.5])
    found = pixel_averages(lanes_of(samples), n)
    for row, column, channel in np.ndindex(height, width, 3):
        square = samples[n * row : n * row + n + 1, n * column : n * column + n + 1, channel]
        assert found[row, column, channel] == int(weights @ square @ weights / n**2 + 0.5)


def test_the_average_of_one_colour_is_that_colour_also_of_the_brightest():
    for value in (0, 1, 254, 255):
        assert (pixel_averages(lanes_of(np.full((17, 17, 3), value, np.uint8)), 8) == value).all()


def test_the_segmentation_is_taken_at_the_centre_of_each_pixel():
    ids = np.random.default_rng(0).integers(0, 3, (9, 13)).astype(np.uint8)
    assert segmentation_of(ids, 4).tolist() == [[ids[4 * r + 2, 4 * c + 2] for c in range(3)] for r in range(2)]


def test_the_areas_are_each_parts_points_over_those_per_pixel():
    ids = np.random.default_rng(0).integers(0, 4, (9, 13)).astype(np.uint8)
    assert part_pixels_of(ids, 4, 3).tolist() == [(ids == part).sum() / 16 for part in (1, 2, 3)]


@pytest.mark.parametrize("stray", [3, 4, 255])
def test_an_id_of_no_part_is_an_error(stray):
    ids = np.ones((5, 5), np.uint8)
    ids[2, 3] = stray
    with pytest.raises(RenderError, match=f"ids of no part, {stray} the highest of 0 to 2"):
        part_pixels_of(ids, 2, 2)


def test_a_frame_without_the_object_is_an_error():
    with pytest.raises(RenderError, match="came back empty"):
        part_pixels_of(np.zeros((5, 5), np.uint8), 2, 2)


def test_linear_is_the_inverse_of_srgb():
    levels = np.arange(256) / 255
    assert np.abs(srgb(linear(levels)) - levels).max() < 1e-12
    assert np.array_equal(srgb_bytes(linear(levels)), np.arange(256))


@pytest.mark.parametrize("n", [0, 1, 3, 10])
def test_a_lattice_without_a_sample_at_the_centre_is_refused(n):
    with pytest.raises(SettingsError, match="samples_per_axis"):
        RenderSettings(samples_per_axis=n)
