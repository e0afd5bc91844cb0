"""The curve of a training: one epoch is seen, and many, and what happened between them is marked."""

from dataclasses import replace

import pytest
from PIL import Image
from tiny_training import HYPOTHESES

from symsol_annot.bench.models.training import curve
from symsol_annot.bench.models.training.checkpoints import read_record
from symsol_annot.bench.models.training.curve import plot_curve

_SERIES = {(31, 119, 180), (255, 127, 14)}  # matplotlib's first two colours
_ERRORS = {"recall_mean_error_rad": 0.5, "precision_mean_error_rad": 0.7}


@pytest.fixture
def record(trained):
    return replace(read_record(trained["hypotheses"] / "weights.safetensors"), rows=())


@pytest.fixture
def figures(monkeypatch):
    """The figures that are written, before they are."""
    drawn, write = [], curve.write_figure
    monkeypatch.setattr(curve, "write_figure", lambda figure, path: (drawn.append(figure), write(figure, path)))
    return drawn


def _rows(rates, **figures):
    return tuple({"epoch": n, "loss": 1 / n, "learning_rate": rate, **figures} for n, rate in enumerate(rates, 1))


def _coloured(path, left, right):
    """How many pixels of a part of the picture's width have a series' colour, the legend's lines left out."""
    with Image.open(path) as picture:
        pixels = picture.convert("RGB")
        width, height = pixels.size
        part = pixels.crop((int(left * width), 0, int(right * width), height))
        return sum(count for count, colour in part.getcolors(2**24) if colour in _SERIES)


def test_a_curve_of_one_epoch_shows_points_in_every_panel(record, figures, tmp_path, monkeypatch):
    record = replace(record, epochs=1, rows=_rows([1e-3], **_ERRORS))
    plot_curve(tmp_path / "points.png", record)
    monkeypatch.setattr(curve, "_FEW_EPOCHS", 0)  # a line of one epoch, so that the legend alone has colour
    plot_curve(tmp_path / "lines.png", record)
    for half in ((0.0, 0.5), (0.5, 1.0)):
        assert _coloured(tmp_path / "points.png", *half) > _coloured(tmp_path / "lines.png", *half) + 10


def test_many_epochs_are_a_line_without_points_at_whole_epochs(record, figures, tmp_path):
    plot_curve(tmp_path / "curve.png", replace(record, epochs=30, rows=_rows(30 * [1e-3])))
    (axes,) = figures[0].axes
    assert axes.lines[0].get_marker() == "None"
    assert all(float(tick).is_integer() for tick in axes.get_xticks())
    assert figures[0].get_suptitle() == "tetX: tiny"


def test_drops_of_steps_and_extensions_are_marked_and_a_cosine_is_not(record, figures, tmp_path):
    rows = _rows([1e-3, 1e-4, 1e-3, 1e-4])
    record = replace(record, epochs=4, rows=rows, extensions=((2, 2),))
    cosine = replace(HYPOTHESES, schedule="cosine", learning_rates=(1e-3,), milestones=())
    plot_curve(tmp_path / "steps.png", record)
    plot_curve(tmp_path / "cosine.png", replace(record, recipe=cosine, extensions=()))
    steps, falling = (figure.axes[0] for figure in figures)
    assert [axes.get_yscale() for axes in (steps, falling)] == ["log", "log"]
    assert [line.get_xdata()[0] for line in steps.lines[1:]] == [1.5, 3.5, 2.5]
    assert figures[0].get_suptitle() == "tetX: tiny; dotted: the learning rate drops; dashed: extended"
    assert len(falling.lines) == 1


def test_a_loss_below_0_is_drawn(record, figures, tmp_path):
    rows = tuple({**row, "loss": 1.0 - row["epoch"]} for row in _rows(3 * [1e-3]))
    plot_curve(tmp_path / "curve.png", replace(record, rows=rows))
    assert figures[0].axes[0].get_yscale() == "linear"


def test_one_epoch_is_a_whole_number_on_its_axis(record, figures, tmp_path):
    plot_curve(tmp_path / "curve.png", replace(record, rows=_rows([1e-3])))
    figures[0].canvas.draw()
    (axes,) = figures[0].axes
    left, right = axes.get_xlim()
    assert [tick for tick in axes.get_xticks() if left <= tick <= right] == [1]
