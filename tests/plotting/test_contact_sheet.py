"""Contact sheets: pictures of plausible size that show the samples."""

import sys
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from matplotlib import rc_context
from PIL import Image

from symsol_annot import load
from symsol_annot.errors import MissingExtraError, OutputError, SettingsError
from symsol_annot.plotting import contact_sheet as plots
from symsol_annot.plotting.canvas import label_text, new_figure, write_figure
from symsol_annot.plotting.contact_sheet import contact_sheet
from symsol_annot.sets.dataset import Sample
from symsol_annot.sets.stated.equality import PartsOfSet


def pixels_of(path):
    with Image.open(path) as picture:
        assert picture.format == "PNG"
        return np.asarray(picture.convert("RGB"))


def sample_without_set(sample):
    return Sample(**{**sample.__dict__, "symmetry_mask": None})


@pytest.mark.parametrize(("count", "columns"), [(1, 1), (3, 3), (4, 4), (6, 3), (8, 4), (10, 2), (5, 1)])
def test_a_contact_sheet_has_no_empty_place_and_at_most_four_samples_per_row(count, columns, tetX_set, tmp_path):
    contact_sheet(load(tetX_set)[:count], tmp_path / "sheet.png")
    height, width, _ = pixels_of(tmp_path / "sheet.png").shape
    assert width == columns * 660
    assert height == 30 + 250 * count / columns


def test_a_contact_sheet_shows_image_segmentation_and_set_side_by_side(tetX_set, tmp_path):
    sample = next(sample for sample in load(tetX_set) if sample.marking_visible)
    contact_sheet([sample], tmp_path / "sheet.png", columns=1)
    sheet = pixels_of(tmp_path / "sheet.png")[:-30]  # without the legend
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


@pytest.mark.parametrize(
    ("pixels", "tolerance_px", "caption"),
    [
        (13.25, 5, "marking shows, 13.25 px"),
        (5, 5, "marking shows, 5 px"),
        (4.75, 5, "hidden, 4.75 px"),
        (0, 5, "marking hidden"),
    ],
)
def test_a_caption_says_how_much_of_the_marking_shows(tetX_set, monkeypatch, pixels, tolerance_px, caption):
    sample = replace(load(tetX_set)[3], marking_pixels=pixels, marking_visible=pixels >= tolerance_px)
    drawn = []
    monkeypatch.setattr(plots, "write_figure", lambda figure, *_, **__: drawn.append(figure))
    contact_sheet([sample], Path("sheet.png"))
    contact_sheet([sample], Path("sheet.png"), has_marking=False)
    titles = [[axes.get_title() for axes in figure.axes] for figure in drawn]
    size = f"{len(sample.symmetry_set)} rotations"
    assert titles == [["image 3", caption, size], ["image 3", "segmentation", size]]


FACES = ("bottom", "top", "front", "back", "left", "right")


@pytest.mark.parametrize(
    ("parts", "areas_px", "caption"),
    [
        (PartsOfSet(("body", "handle"), (2,), 0.125), [90, 12.25], "handle: 12.25 px"),
        (PartsOfSet(("body", "handle"), (2,), 0.125), [90, 0], "handle: out of sight"),
        (PartsOfSet(("body", "handle"), (2,), 5.0), [90, 0.25], "handle: 0.25 px"),
        (PartsOfSet(FACES, (2, 3, 4, 5, 6), 0.125), [3, 0, 4, 0, 0.1, 5], "in view: bottom, front, right"),
        (PartsOfSet(FACES, (2, 3, 4, 5, 6), 0.125), [3, 1, 4, 1, 0, 5], "5 of 6 parts in view"),
        (PartsOfSet(("body",), (), None), [90], "segmentation"),
    ],
)
def test_parts_are_named_by_what_an_image_shows_and_in_a_legend(tetX_set, monkeypatch, parts, areas_px, caption):
    sample, drawn = replace(load(tetX_set)[3], part_pixels=np.array(areas_px, np.float32)), []
    monkeypatch.setattr(plots, "write_figure", lambda figure, *_, **__: drawn.append(figure))
    contact_sheet([sample], Path("sheet.png"), parts=parts)
    assert drawn[0].axes[1].get_title() == caption
    (legend,) = drawn[0].legends
    marks = ["symmetry set", "drawn at this rotation"]
    assert [text.get_text() for text in legend.get_texts()] == [*marks, *parts.names]
    colours = [tuple(round(255 * part) for part in patch.get_facecolor()[:3]) for patch in legend.get_patches()]
    assert colours == [tuple(colour) for colour in plots.ID_COLOURS[1 : len(parts.names) + 1].tolist()]


def test_a_sample_without_a_set_has_no_ball(tetX_set, tmp_path):
    sample = load(tetX_set)[0]
    for name, drawn in (("with", sample), ("without", sample_without_set(sample))):
        contact_sheet([drawn], tmp_path / f"{name}.png", columns=1)
    assert holds_set_points(pixels_of(tmp_path / "with.png"))
    assert not holds_set_points(pixels_of(tmp_path / "without.png"))


def test_equal_samples_give_equal_bytes(tetX_set, tmp_path):
    for form in ("png", "pdf", "svg"):
        paths = [tmp_path / f"{name}.{form}" for name in ("a", "b")]
        for path in paths:
            contact_sheet(load(tetX_set)[:2], path)
        assert paths[0].read_bytes() == paths[1].read_bytes()


def test_a_path_that_cannot_be_written_is_an_output_error(tetX_set, tmp_path):
    samples = load(tetX_set)[:1]
    (tmp_path / "folder.png").mkdir()
    for path in (tmp_path / "no such folder" / "sheet.png", tmp_path / "folder.png"):
        with pytest.raises(OutputError, match="cannot be written") as caught:
            contact_sheet(samples, path)
        assert str(path) in str(caught.value)


def test_the_suffix_says_what_is_written_and_another_one_is_refused(tetX_set, tmp_path):
    for suffix, start in ((".png", b"\x89PNG"), (".pdf", b"%PDF"), (".svg", b"<?xml"), (".PDF", b"%PDF")):
        contact_sheet(load(tetX_set)[:1], tmp_path / f"sheet{suffix}")
        assert (tmp_path / f"sheet{suffix}").read_bytes().startswith(start)
    for name in ("sheet", "sheet.jpg"):
        with pytest.raises(SettingsError, match=r"expected a name that ends in \.png, \.pdf or \.svg"):
            contact_sheet(load(tetX_set)[:1], tmp_path / name)
        assert not (tmp_path / name).exists()


def test_without_matplotlib_the_error_says_how_to_install_it(tetX_set, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'symsol-annot\[plot\]'"):
        contact_sheet(load(tetX_set)[:1], tmp_path / "sheet.png")
    assert not (tmp_path / "sheet.png").exists()


def test_a_picture_of_a_set_needs_no_display(tetX_set, tmp_path, monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("MPLBACKEND", "TkAgg")
    contact_sheet(load(tetX_set)[:1], tmp_path / "sheet.png")
    assert pixels_of(tmp_path / "sheet.png").std() > 0


@pytest.mark.parametrize(
    "name", ["$a_{$", "cost $5 and $6", r"a\$b", "$", "$$", "_mine", "__", "a_b", "\u65e5\u672c\u8a9e", "\u05d0\u05d1"]
)
def test_a_name_is_shown_as_it_is_in_titles_and_legends(name, tmp_path):
    figure = new_figure(layout="constrained")
    axes = figure.add_subplot(title=label_text(name))
    axes.plot([0, 1], [0, 1], label=label_text(name))
    axes.legend()
    with rc_context({"svg.fonttype": "none"}):  # text as text
        write_figure(figure, tmp_path / "figure.svg")
    texts = [text.text for text in ET.parse(tmp_path / "figure.svg").iter("{http://www.w3.org/2000/svg}text")]
    assert [text.strip() for text in texts].count(name) == 2
    for form in ("png", "pdf"):
        write_figure(figure, tmp_path / f"figure.{form}")
