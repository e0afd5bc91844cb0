"""Pictures: a PNG of plausible size that shows the samples, and points that are the set's rotation vectors."""

import sys

import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from PIL import Image

from symsol_annot import load
from symsol_annot.dataset import Sample
from symsol_annot.errors import OutputError, SymsolError
from symsol_annot.plots import contact_sheet, draw_pi_ball
from symsol_annot.so3 import uniform_rotations


def pixels_of(path):
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB"))


def rotation_of(vector):
    """Rodrigues' formula, by hand."""
    angle = np.linalg.norm(vector)
    x, y, z = vector / angle if angle else vector
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def ball_of(rotations, R_gt=None):
    """The collections of points in a pi-ball: for each its (k, 3) places."""
    figure = Figure()
    FigureCanvasAgg(figure)
    axes = figure.add_subplot(projection="3d")
    draw_pi_ball(axes, rotations, R_gt)
    figure.canvas.draw()
    return axes, [np.stack(np.ma.getdata(points._offsets3d), axis=-1) for points in axes.collections]


def sample_without_set(sample):
    return Sample(**{**sample.__dict__, "symmetry_mask": None})


def test_a_contact_sheet_is_a_png_with_a_row_for_every_four_samples(tetX_set, tmp_path):
    samples = load(tetX_set)
    sizes = []
    for count in (3, 5):
        contact_sheet(samples[:count], tmp_path / "sheet.png")
        sizes.append(pixels_of(tmp_path / "sheet.png").shape)
    (height, width, _), (taller, same_width, _) = sizes
    assert taller == 2 * height
    assert same_width == width > 4 * height
    assert height >= 200


def test_a_contact_sheet_shows_image_segmentation_and_set_side_by_side(tetX_set, tmp_path):
    sample = next(sample for sample in load(tetX_set) if sample.marking_visible)
    contact_sheet([sample], tmp_path / "sheet.png", columns=1)
    sheet = pixels_of(tmp_path / "sheet.png")
    image, segmentation, ball = np.array_split(sheet, 3, axis=1)
    marking, body = [230, 90, 40], [180, 200, 230]  # the ray caster's colours
    assert holds(image, marking)
    assert holds(image, body)
    assert holds(segmentation, [240, 128, 128])
    assert holds(segmentation, [140, 30, 30])
    assert not holds(segmentation, body)
    assert holds_set_points(ball)
    assert not holds_set_points(image)
    assert not holds_set_points(segmentation)


def holds(picture, colour):
    return (picture == colour).all(axis=-1).any()


def holds_set_points(picture):
    """Points of a set are drawn in a blue far deeper than the body's."""
    return (picture[..., 2].astype(int) - picture[..., 0] > 90).any()


def test_a_sample_without_a_set_has_no_ball(tetX_set, tmp_path):
    sample = load(tetX_set)[0]
    for name, drawn in (("with", sample), ("without", sample_without_set(sample))):
        contact_sheet([drawn], tmp_path / f"{name}.png", columns=1)
    assert holds_set_points(pixels_of(tmp_path / "with.png"))
    assert not holds_set_points(pixels_of(tmp_path / "without.png"))


def test_equal_samples_give_equal_bytes(tetX_set, tmp_path):
    for name in ("a", "b"):
        contact_sheet(load(tetX_set)[:2], tmp_path / name)
    assert (tmp_path / "a").read_bytes() == (tmp_path / "b").read_bytes()


def test_points_in_the_ball_are_the_rotation_vectors_of_the_set(tetX_set):
    for sample in load(tetX_set)[:6]:
        _, (points, own) = ball_of(sample.symmetry_set, sample.rotation)
        assert np.linalg.norm(points, axis=-1).max() <= np.pi + 1e-9
        assert len(points) == len(sample.symmetry_set)
        for point, R in zip(points, sample.symmetry_set, strict=True):
            assert np.allclose(rotation_of(point), R, atol=1e-9)
        assert np.allclose(rotation_of(own[0]), sample.rotation, atol=1e-9)
        assert len(own) == 1


def test_the_ball_is_drawn_to_radius_pi_with_equal_axes():
    half_turns = np.array([np.diag([1.0, -1, -1]), np.diag([-1.0, 1, -1]), np.diag([-1.0, -1, 1])])
    axes, (points,) = ball_of(
        np.concatenate([np.eye(3)[None], half_turns, uniform_rotations(80, np.random.default_rng(0))])
    )
    assert np.allclose(np.linalg.norm(points[:4], axis=-1), [0, np.pi, np.pi, np.pi])
    for low, high in (axes.get_xlim(), axes.get_ylim(), axes.get_zlim()):
        assert (low, high) == (-np.pi, np.pi)
    outline = [np.stack(line.get_data_3d()) for line in axes.lines]
    assert np.allclose([np.linalg.norm(line, axis=0).max() for line in outline], np.pi)


def test_a_path_that_cannot_be_written_is_an_output_error(tetX_set, tmp_path):
    samples = load(tetX_set)[:1]
    for path in (tmp_path / "no such folder" / "sheet.png", tmp_path):
        with pytest.raises(OutputError, match="cannot be written") as caught:
            contact_sheet(samples, path)
        assert str(path) in str(caught.value)


@pytest.mark.parametrize("module", ["matplotlib", "matplotlib.figure", "matplotlib.backends.backend_agg"])
def test_without_matplotlib_the_error_says_how_to_install_it(tetX_set, tmp_path, monkeypatch, module):
    monkeypatch.setitem(sys.modules, module, None)
    if module == "matplotlib":  # its parts were imported above, and are found without it
        for part in ("matplotlib.figure", "matplotlib.backends.backend_agg"):
            monkeypatch.delitem(sys.modules, part)
    with pytest.raises(SymsolError, match=r"pip install 'symsol-annot\[plot\]'"):
        contact_sheet(load(tetX_set)[:1], tmp_path / "sheet.png")
    assert not (tmp_path / "sheet.png").exists()


def test_a_picture_of_a_set_needs_no_display(tetX_set, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MPLBACKEND", "TkAgg")
    contact_sheet(load(tetX_set)[:1], tmp_path / "sheet.png")
    assert pixels_of(tmp_path / "sheet.png").std() > 0
