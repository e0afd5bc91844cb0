"""From samples to a view: averages by loops, ids by colour, and colours that no material can show."""

from dataclasses import replace

import numpy as np
import pytest

from symsol_annot.errors import RenderError, SettingsError
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import MARKING
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rendering.shading import ColourIds, CornerLight, srgb_bytes
from symsol_annot.rendering.supersampling import pixel_averages, view_of
from symsol_annot.rotations.so3 import uniform_rotations

SETTINGS = RenderSettings()


@pytest.mark.parametrize("name", ["cylO", "tetX"])
def test_corners_are_lit_by_the_cosine_to_the_camera_axis(name):
    mesh = load_object(name).mesh
    R = uniform_rotations(1, np.random.default_rng(4))[0]
    colours = CornerLight(mesh, Camera.filling(224).lattice(2), SETTINGS).colours(R)
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
    colours = CornerLight(mesh, lattice, SETTINGS).colours(R)
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


def shade(colour, light):
    return srgb_bytes(light * np.array(colour))


@pytest.mark.parametrize("n", [2, 4, 8])
def test_a_pixel_is_the_trapezoidal_average_over_its_square(n):
    height, width = 3, 4
    samples = np.random.default_rng(n).integers(0, 256, (n * height + 1, n * width + 1, 3)).astype(np.uint8)
    weights = np.array([0.5, *[1.0] * (n - 1), 0.5])
    found = pixel_averages(samples, n)
    for row, column, channel in np.ndindex(height, width, 3):
        square = samples[n * row : n * row + n + 1, n * column : n * column + n + 1, channel]
        assert found[row, column, channel] == int(weights @ square @ weights / n**2 + 0.5)


def test_the_average_of_one_colour_is_that_colour_also_of_the_brightest():
    for value in (0, 1, 254, 255):
        assert (pixel_averages(np.full((17, 17, 3), value, np.uint8), 8) == value).all()


def test_ids_are_told_by_colour_in_every_shade():
    ids = ColourIds(SETTINGS)
    light = np.linspace(SETTINGS.ambient, SETTINGS.ambient + SETTINGS.diffuse, 50)
    samples = np.stack(
        [
            np.tile(shade(SETTINGS.background_colour, 1.0), (50, 1)),
            np.stack([shade(SETTINGS.body_colour, x) for x in light]),
            np.stack([shade(SETTINGS.marking_colour, x) for x in light]),
        ]
    )
    assert ids.of(samples).tolist() == [[0] * 50, [1] * 50, [2] * 50]


@pytest.mark.parametrize("stray", [[0, 255, 0], [254, 255, 255], [0, 0, 0], [128, 128, 128], [255, 0, 0]])
def test_a_colour_that_no_material_shows_is_an_error(stray):
    samples = np.full((4, 4, 3), 255, np.uint8)
    samples[2, 3] = stray
    with pytest.raises(RenderError, match="neither background, body nor marking"):
        ColourIds(SETTINGS).of(samples)


def test_a_mixture_of_body_and_background_is_no_sample():
    """Anti-aliasing left on in the engine would be noticed."""
    body = shade(SETTINGS.body_colour, 0.5).astype(int)
    with pytest.raises(RenderError):
        ColourIds(SETTINGS).of(((body + 255) // 2).astype(np.uint8).reshape(1, 1, 3))


def test_colours_that_cannot_be_told_apart_are_refused():
    with pytest.raises(SettingsError, match="must differ"):
        ColourIds(replace(SETTINGS, marking_colour=SETTINGS.body_colour))


def test_the_segmentation_is_taken_at_the_centre_of_each_pixel():
    ids = np.random.default_rng(0).integers(0, 3, (9, 13)).astype(np.uint8)
    view = view_of(np.zeros((9, 13, 3), np.uint8), ids, 4)
    assert view.segmentation.tolist() == [[ids[4 * r + 2, 4 * c + 2] for c in range(3)] for r in range(2)]
    assert view.marking_pixels == np.count_nonzero(ids == MARKING) / 16


@pytest.mark.parametrize("n", [0, 1, 3, 10])
def test_a_lattice_without_a_sample_at_the_centre_is_refused(n):
    with pytest.raises(SettingsError, match="samples_per_axis"):
        RenderSettings(samples_per_axis=n)
