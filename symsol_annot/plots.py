"""Pictures of images, segmentations and symmetry sets (figures 2.1 and 5.3)."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial.transform import Rotation

from symsol_annot.canvas import new_figure, write_png
from symsol_annot.dataset import Sample
from symsol_annot.so3 import Rotations

ID_COLOURS = np.array([[0, 0, 0], [140, 30, 30], [240, 128, 128]], dtype=np.uint8)  # as in figure 5.2
_SET_COLOUR, _GT_COLOUR = "#1f5fa8", "#d1401f"
_COLUMN_INCHES = 2.2
_VIEW_DEG = {"elev": 18.0, "azim": -60.0}


def contact_sheet(samples: Sequence[Sample], path: Path, columns: int = 4, *, has_marking: bool = True) -> None:
    """Write a PNG with each sample's image, its segmentation, and its symmetry set in the pi-ball.

    Args:
        samples: what to draw, row by row.
        path: the PNG.
        columns: how many samples a row.
        has_marking: whether to say over a segmentation how much of the marking shows.

    Raises:
        OutputError: the file cannot be written.
        SymsolError: matplotlib is not installed.
    """
    rows = -(-len(samples) // columns)
    figure = new_figure(figsize=(3 * _COLUMN_INCHES * columns, (_COLUMN_INCHES + 0.3) * rows), layout="constrained")
    figure.get_layout_engine().set(w_pad=0.02, h_pad=0.03, wspace=0.0, hspace=0.0)
    for number, sample in enumerate(samples):
        row, column = divmod(number, columns)
        places = [(rows, 3 * columns, 3 * columns * row + 3 * column + part + 1) for part in range(3)]
        _draw_picture(figure.add_subplot(*places[0]), sample.image, f"image {sample.index}")
        caption = _marking_caption(sample) if has_marking else "segmentation"
        _draw_picture(figure.add_subplot(*places[1]), ID_COLOURS[sample.segmentation], caption)
        if sample.symmetry_mask is not None:
            ball = figure.add_subplot(*places[2], projection="3d")
            draw_pi_ball(ball, sample.symmetry_set, sample.rotation)
            ball.set_title(f"|S| = {len(sample.symmetry_set)}", fontsize=8, pad=0)
    write_png(figure, path)


def draw_pi_ball(axes: Any, rotations: Rotations, R_gt: Rotations | None = None) -> None:
    """Draw rotations as rotation vectors in the ball of radius pi (section 2.1.3).

    Args:
        axes: a 3D axes of matplotlib.
        rotations: (k, 3, 3).
        R_gt: (3, 3) one rotation to point out, or None.
    """
    _draw_ball_outline(axes)
    points = Rotation.from_matrix(rotations).as_rotvec()
    axes.scatter(*points.T, s=6 if len(points) > 60 else 18, color=_SET_COLOUR, depthshade=True, linewidths=0)
    if R_gt is not None:
        at = Rotation.from_matrix(R_gt).as_rotvec()
        axes.scatter(*at[:, None], s=28, facecolors="none", edgecolors=_GT_COLOUR, linewidths=1.4)
    axes.set(xlim=(-np.pi, np.pi), ylim=(-np.pi, np.pi), zlim=(-np.pi, np.pi))
    axes.set_box_aspect((1, 1, 1), zoom=1.45)
    axes.view_init(**_VIEW_DEG)
    axes.set_axis_off()


def _draw_ball_outline(axes: Any) -> None:
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.pi * np.stack([np.cos(turn), np.sin(turn), np.zeros_like(turn)])
    for shift in range(3):
        axes.plot(*np.roll(circle, shift, axis=0), color="0.8", linewidth=0.6)
    for axis, name in enumerate("xyz"):
        ends = np.zeros((3, 2))
        ends[axis] = [-np.pi, np.pi]
        axes.plot(*ends, color="0.85", linewidth=0.5)
        axes.text(*(1.1 * ends[:, 1]), name, fontsize=6, color="0.5", ha="center", va="center")


def _draw_picture(axes: Any, pixels: npt.NDArray[np.uint8], caption: str) -> None:
    axes.imshow(pixels, interpolation="antialiased")
    axes.set_title(caption, fontsize=8, pad=2)
    axes.set(xticks=[], yticks=[])
    for spine in axes.spines.values():
        spine.set(color="0.8", linewidth=0.6)


def _marking_caption(sample: Sample) -> str:
    if sample.marking_visible:
        return f"marking shows, {sample.marking_pixels:.4g} px"
    return "marking hidden" if sample.marking_pixels == 0 else f"hidden, {sample.marking_pixels:.4g} px"
