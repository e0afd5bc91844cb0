"""The toy converges as the thesis describes, the curves have the minima that it names, and the pictures show them."""

import math
import sys
from itertools import pairwise

import numpy as np
import pytest
import torch
from click.testing import CliRunner
from symsol_annot_cli.plot import plot as plot_command

from symsol_annot.bench.models.losses import (
    cyclic_cosine_loss,
    geodesic_loss,
    von_mises_loss,
    winner_takes_all,
)
from symsol_annot.bench.models.plots import losses as loss_plots
from symsol_annot.bench.models.plots import toy
from symsol_annot.errors import MissingExtraError, OutputError

torch.set_num_threads(1)
TOYS = {a_toy.figure: a_toy for a_toy in toy.TOYS}
CURVES = {curves.figure: curves for row in loss_plots.CURVES for curves in row}
CIRCLE = np.linspace(0, 2 * np.pi, 2000, endpoint=False)


@pytest.fixture(scope="module")
def places():
    return {figure: toy.positions(a_toy) for figure, a_toy in TOYS.items()}


def near(points, place, within=0.01):
    return [index for index, point in enumerate(points) if np.linalg.norm(point - place) < within]


# --- the toy (section 4.1.2) ---


def test_the_toys_have_as_many_hypotheses_and_modes_as_the_figures():
    assert {figure: (len(a_toy.start), len(a_toy.modes)) for figure, a_toy in TOYS.items()} == {
        "4.2": (5, 4),
        "4.3": (6, 3),
        "4.4": (8, 3),
    }
    assert [stage.winners for stage in TOYS["4.4"].stages] == [8, 4, 2]


def test_under_wta_whoever_wins_nothing_stays_and_who_wins_two_modes_ends_between_them(places):
    start, end = places["4.2"]
    modes = TOYS["4.2"].modes
    assert sum(np.array_equal(a, b) for a, b in zip(start, end, strict=True)) == 2
    assert len(near(end, (modes[0] + modes[1]) / 2)) == 1
    assert [len(near(end, mode)) for mode in modes] == [0, 0, 1, 1]


def test_under_rwta_losers_meet_at_the_average_and_winners_stop_short_of_their_modes(places):
    """A winner of one of n modes is pulled by it with 1 - epsilon, by the others with epsilon / (M - 1)."""
    _, end = places["4.3"]
    modes, epsilon, M = TOYS["4.3"].modes, 0.05, 6
    assert len(near(end, modes.mean(axis=0), 1e-3)) == 3
    for mode in modes:
        others = modes.sum(axis=0) - mode
        equilibrium = ((1 - epsilon) * mode + epsilon / (M - 1) * others) / (1 - epsilon + 2 * epsilon / (M - 1))
        assert len(near(end, equilibrium, 1e-4)) == 1
        assert np.linalg.norm(equilibrium - mode) > 0.01


def test_ewta_gathers_all_then_frees_them_until_each_mode_has_its_own_two(places):
    _, all_pulled, half_pulled, end = places["4.4"]
    top, left, right = TOYS["4.4"].modes
    assert len(near(all_pulled, TOYS["4.4"].modes.mean(axis=0))) == 8
    for place in (left, right, (top + left) / 2, (top + right) / 2):
        assert len(near(half_pulled, place)) == 2
    assert [len(near(end, mode)) for mode in (top, left, right)] == [2, 2, 2]
    still = [index for index in range(8) if np.array_equal(half_pulled[index], end[index])]
    assert still == near(end, (top + right) / 2)


def test_winners_are_the_nearest_in_order():
    points, modes = np.array([(0.0, 0.0), (3.0, 0.0), (1.0, 0.0)]), np.array([(0.9, 0.0), (2.5, 0.0)])
    assert toy.winners(points, modes, 2).tolist() == [[2, 0], [1, 2]]


def test_a_step_goes_down_the_mean_over_the_modes_of_their_meta_loss():
    """Of two modes the first is won by one hypothesis, whose squared distance has the gradient 2 (f - y)."""
    start, modes = np.array([(0.0, 0.0), (1.0, 1.0)]), np.array([(0.1, 0.2), (1.0, 0.6)])
    step = toy.Stage("WTA", winner_takes_all, 1, steps=1, rate=0.25)
    np.testing.assert_allclose(toy.converge(start, modes, step), [(0.025, 0.05), (1.0, 0.9)], atol=1e-12)


def test_a_toy_leaves_where_it_began_alone():
    start = TOYS["4.2"].start.copy()
    toy.converge(TOYS["4.2"].start, TOYS["4.2"].modes, TOYS["4.2"].stages[0])
    assert np.array_equal(TOYS["4.2"].start, start)


# --- the curves (appendix A) ---


def summed_by_hand(x, truths, loss):
    """Equations A.6 and A.7, and the geodesic loss as the shorter way around the circle."""
    one = {
        "cosine": lambda d: 1 - math.cos(d),
        "von Mises": lambda d: 1 - math.exp(4 * (math.cos(d) - 1)),
        "geodesic": lambda d: min(abs(d), 2 * math.pi - abs(d)),
    }[loss]
    return sum(one(x - y) for y in truths)


@pytest.mark.parametrize(
    ("name", "loss"), [("cosine", cyclic_cosine_loss), ("von Mises", von_mises_loss), ("geodesic", geodesic_loss)]
)
def test_a_curve_is_the_loss_of_angles_summed_over_the_truths(name, loss):
    truths = [1.0, 2.5, 4.5]
    found = loss_plots.summed_loss(CIRCLE[::50], np.array(truths), loss)
    np.testing.assert_allclose(found, [summed_by_hand(x, truths, name) for x in CIRCLE[::50]], atol=1e-9)


def minima(loss, truths):
    values = loss_plots.summed_loss(CIRCLE, np.array(truths), loss)
    is_least = (values < np.roll(values, 1)) & (values <= np.roll(values, -1))
    return CIRCLE[is_least & (values < values.max() - 1e-9)]  # far from all truths it is flat


@pytest.mark.parametrize("figure", ["A.1a", "A.1b", "A.1c", "A.2a"])
def test_the_cosines_one_minimum_is_where_equation_A_16_has_it(figure):
    truths = CURVES[figure].truths_rad
    expected = math.atan2(sum(map(math.sin, truths)), sum(map(math.cos, truths))) % (2 * math.pi)
    np.testing.assert_allclose(minima(CURVES[figure].losses["cyclic cosine"], truths), [expected], atol=0.004)


@pytest.mark.parametrize(
    ("figure", "own"), [("A.1a", True), ("A.1b", True), ("A.1c", True), ("A.2a", False), ("A.2b", True)]
)
def test_von_mises_has_a_minimum_by_each_truth_that_is_far_enough(figure, own):
    (loss,) = [loss for name, loss in CURVES[figure].losses.items() if name.startswith("von Mises")]
    truths = CURVES[figure].truths_rad
    if own:
        np.testing.assert_allclose(minima(loss, truths), truths, atol=0.05)
    else:
        np.testing.assert_allclose(minima(loss, truths), [np.mean(truths)], atol=0.004)


def test_the_curves_are_those_of_the_thesis():
    assert {figure: curves.truths_rad for figure, curves in CURVES.items()} == {
        "4.5a": (math.pi,),
        "4.5b": (2, 4),
        "A.1a": (math.pi,),
        "A.1b": (2, 4),
        "A.1c": (1, 2.5, 4.5),
        "A.2a": (3, 3.75),
        "A.2b": (3, 3.75),
    }
    for figure, curves in CURVES.items():
        first = "geodesic" if figure.startswith("4.5") else "cyclic cosine"
        assert list(curves.losses) == [first, f"von Mises, K = {16 if figure == 'A.2b' else 4}"]


# --- the pictures ---


@pytest.mark.parametrize(("plot", "rows"), [(loss_plots.plot_curves, 3), (loss_plots.plot_toys, 2)])
def test_every_row_of_a_picture_is_full_and_nothing_covers_the_curves(plot, rows, monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(loss_plots, "write_figure", lambda figure, _: figures.append(figure))
    plot(tmp_path / "plot.png")
    (figure,) = figures
    figure.draw_without_rendering()
    boxes = [axes.get_position() for axes in figure.axes]
    assert all(axes.get_legend() is None for axes in figure.axes)
    tops = sorted({round(box.y0, 3) for box in boxes})
    assert len(tops) == rows
    for top in tops:
        row = [box for box in boxes if round(box.y0, 3) == top]
        assert min(box.x0 for box in row) < 0.1
        assert max(box.x1 for box in row) > 0.95


def test_a_toys_panels_show_its_hypotheses_where_they_are(monkeypatch, tmp_path, places):
    figures = []
    monkeypatch.setattr(loss_plots, "write_figure", lambda figure, _: figures.append(figure))
    loss_plots.plot_toys(tmp_path / "plot.png")
    panels = iter(figures[0].axes)
    for figure, stages in places.items():
        for points in stages:
            modes, drawn = (np.asarray(markers.get_offsets()) for markers in next(panels).collections[-2:])
            np.testing.assert_allclose(drawn, points)
            np.testing.assert_allclose(modes, TOYS[figure].modes)
    assert next(panels, None) is None


def test_curves_panels_show_two_curves_over_the_whole_circle(monkeypatch, tmp_path):
    figures = []
    monkeypatch.setattr(loss_plots, "write_figure", lambda figure, _: figures.append(figure))
    loss_plots.plot_curves(tmp_path / "plot.png")
    for axes, curves in zip(figures[0].axes, CURVES.values(), strict=True):
        assert axes.get_title().startswith(curves.figure)
        drawn = [line for line in axes.lines if len(line.get_xdata()) > 2]
        assert [line.get_label() for line in drawn] == list(curves.losses)
        for line, loss in zip(drawn, curves.losses.values(), strict=True):
            x = line.get_xdata()
            assert (x[0], x[-1]) == (0, 2 * np.pi)
            assert all(a < b for a, b in pairwise(x))
            np.testing.assert_allclose(line.get_ydata(), loss_plots.summed_loss(x, np.array(curves.truths_rad), loss))


@pytest.mark.parametrize(("options", "function"), [([], "plot_curves"), (["--toy"], "plot_toys")])
def test_the_command_draws_curves_or_the_toy(options, function, tmp_path, monkeypatch):
    drawn, out = [], tmp_path / "losses.svg"
    draw = getattr(loss_plots, function)
    monkeypatch.setattr(loss_plots, function, lambda path: (drawn.append(path), draw(path)))
    done = CliRunner().invoke(plot_command, ["losses", *options, "--out", str(out)])
    assert done.exit_code == 0, done.exception
    assert done.output == f"{out}\n"
    assert drawn == [out]
    assert out.read_bytes().startswith(b"<?xml")


@pytest.mark.parametrize("plot", [loss_plots.plot_curves, loss_plots.plot_toys])
def test_pictures_fail_with_advice(plot, tmp_path, monkeypatch):
    with pytest.raises(OutputError, match="cannot be written"):
        plot(tmp_path / "no such folder" / "plot.png")
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'symsol-annot\[plot\]'"):
        plot(tmp_path / "plot.png")
