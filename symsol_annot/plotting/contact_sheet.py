"""Contact sheets: images, segmentations and symmetry sets (figures 2.1 and 5.3)."""

import colorsys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.plotting.canvas import colour_patch, label_text, legend_below, new_figure, write_figure
from symsol_annot.plotting.rotations import draw_pi_ball, marks_of_sets, shown_of, size_text
from symsol_annot.sets.dataset import Sample
from symsol_annot.sets.stated.equality import PartsOfSet

_THESIS_COLOURS = ((0, 0, 0), (140, 30, 30), (240, 128, 128))  # as in figure 5.2
_GOLDEN = (5**0.5 - 1.0) / 2.0  # of a turn of the hue from one id to the next
_COLUMN_INCHES, _LEGEND_INCHES = 2.2, 0.3
_SHEET_DPI = 100  # a sheet is looked at, and has many images
_TOWER = 12  # rows per column that are too many
_MOST_IN_LEGEND = 12


def _colours_of_ids() -> npt.NDArray[np.uint8]:
    others = (colorsys.hsv_to_rgb((0.2 + number * _GOLDEN) % 1.0, 0.75, 0.9) for number in range(256))
    colours = [tuple(round(255 * part) for part in colour) for colour in others]
    return np.array([*_THESIS_COLOURS, *colours[len(_THESIS_COLOURS) :]], dtype=np.uint8)


ID_COLOURS = _colours_of_ids()  # (256, 3), of a segmentation's ids: background, body, then the other parts


def contact_sheet(
    samples: Sequence[Sample],
    path: Path,
    columns: int = 4,
    *,
    has_marking: bool = True,
    parts: PartsOfSet | None = None,
) -> None:
    """Write a picture with each sample's image, its segmentation, and its symmetry set in the pi-ball.

    Args:
        samples: what to draw, row by row.
        path: a PNG, PDF or SVG.
        columns: how many samples stand in a row; fewer where that leaves no place empty.
        has_marking: whether to say over a segmentation how much of the marking shows.
        parts: those of an object of format version 2, which are named in its place, with a legend of their colours.

    Raises:
        OutputError: the file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    columns = _columns_without_gaps(len(samples), columns)
    rows = -(-len(samples) // columns)
    size = (3 * _COLUMN_INCHES * columns, (_COLUMN_INCHES + 0.3) * rows + _LEGEND_INCHES)
    figure = new_figure(figsize=size, layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.03, wspace=0.0, hspace=0.0)
    for number, sample in enumerate(samples):
        row, column = divmod(number, columns)
        places = [(rows, 3 * columns, 3 * columns * row + 3 * column + part + 1) for part in range(3)]
        _draw_picture(figure.add_subplot(*places[0]), sample.image, f"image {sample.index}")
        if sample.segmentation is not None:
            caption = parts.in_words(sample.part_pixels) if parts else _marking_caption(sample, has_marking=has_marking)
            _draw_picture(figure.add_subplot(*places[1]), ID_COLOURS[sample.segmentation], caption)
        if sample.is_annotated:
            ball = figure.add_subplot(*places[2], projection="3d")
            draw_pi_ball(ball, shown_of(sample.symmetry_set), sample.rotation)
            ball.set_title(size_text(sample.symmetry_set), fontsize=8, pad=0)
    marks = marks_of_sets() if any(sample.is_annotated for sample in samples) else []
    if named := [*marks, *(_colours_of(parts) if parts else [])]:
        legend_below(figure, named, columns=_MOST_IN_LEGEND)
    write_figure(figure, path, dots_per_inch=_SHEET_DPI)


def _columns_without_gaps(count: int, most: int) -> int:
    """Return the largest number of columns, up to `most`, that leaves no empty place and makes no tower."""
    fitting = [columns for columns in range(1, most + 1) if count % columns == 0 and count <= _TOWER * columns**2]
    return max(fitting, default=most)


def _colours_of(parts: PartsOfSet) -> list[Any]:
    """Return what a legend says of parts: their names, and their colours in the segmentations."""
    names = parts.names[:_MOST_IN_LEGEND]
    colours = ID_COLOURS[1 : len(names) + 1] / 255.0
    return [
        colour_patch((red, green, blue), label_text(name))
        for name, (red, green, blue) in zip(names, colours.tolist(), strict=True)
    ]


def _draw_picture(axes: Any, pixels: npt.NDArray[np.uint8], caption: str) -> None:
    axes.imshow(pixels, interpolation="antialiased")
    axes.set_title(caption, fontsize=8, pad=2)
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color="0.8", linewidth=0.6)


def _marking_caption(sample: Sample, *, has_marking: bool) -> str:
    if not has_marking:
        return "segmentation"
    if sample.marking_visible:
        return f"marking shows, {sample.marking_pixels:.4g} px"
    return "marking hidden" if sample.marking_pixels == 0 else f"hidden, {sample.marking_pixels:.4g} px"
