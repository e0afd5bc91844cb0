"""Draws the pictures on top of README: docs/images/front-*.png: .venv/bin/python docs/figures_front.py."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import symsol_annot
from symsol_annot.plotting.canvas import PREDICTED, TRUTH, write_figure
from symsol_annot.plotting.rotations import draw_pi_ball

SHOWN, HIDDEN = 1, 4  # images of the sample set's test split
FOLDER = Path(__file__).parent / "images"
INCHES, DOTS_PER_INCH = (2.8, 3.7), 200  # shown at 265 pixels: sharp on a screen of twice the density


def main():
    """Draw an image that shows the disc, one that hides it, and one answer about the second."""
    test = symsol_annot.load_sample("cylO")
    shown, hidden = test[SHOWN], test[HIDDEN]
    draw("shown", shown, "Disc in sight: 1 rotation fits")
    draw("hidden", hidden, f"Disc hidden: {len(hidden.symmetry_set)} rotations fit")
    answer = hidden.rotation[None]
    covered = share_within(hidden, answer)
    draw("scored", hidden, f"1 right answer finds {covered:.0%} of them", answer)


def share_within(sample, answers):
    """Return the share of a sample's set that is within 5 degrees of an answer (m, 3, 3): coverage."""
    traces = np.einsum("kij,mij->km", sample.symmetry_set.members, answers)
    apart_deg = np.degrees(np.arccos(np.clip((traces - 1.0) / 2.0, -1.0, 1.0)).min(axis=1))
    return np.mean(apart_deg <= 5.0 + 1e-4)


def draw(name, sample, title, answers=None):
    """Write a picture: the ball with the set, the image in a corner, and a title that can be read on a phone."""
    figure = Figure(figsize=INCHES)
    FigureCanvasAgg(figure)
    figure.text(0.5, 0.96, title, ha="center", va="center", fontsize=11.5)
    image = figure.add_axes((0.31, 0.63, 0.38, 0.29))
    image.imshow(sample.image, interpolation="antialiased")
    image.set(xticks=[], yticks=[])
    ball = figure.add_axes((0.04, 0.02, 0.92, 0.6), projection="3d")
    ball.computed_zorder = False  # what is drawn last is seen
    draw_pi_ball(ball, sample.symmetry_set.members, sample.rotation, answers)
    figure.text(0.03, 0.02, "● true rotations", color=TRUTH, fontsize=9)
    if answers is not None:
        figure.text(0.97, 0.02, "\u00d7 answer", color=PREDICTED, fontsize=9, ha="right")
    write_figure(figure, FOLDER / f"front-{name}.png", dots_per_inch=DOTS_PER_INCH)


if __name__ == "__main__":
    main()
