"""Curves of scores: each point is a figure of the file, and a file without them is refused."""

import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from symsol_annot_cli.plot import plot

from symsol_annot.bench import score_plots
from symsol_annot.errors import ScoresError

REFERENCE = Path(__file__).resolve().parent.parent / "docs" / "results" / "reference"
TRUTH, ROUNDED, SPREAD = (REFERENCE / f"{name}.json" for name in ("truth", "rounded-to-grid", "evenly-placed"))


@pytest.fixture
def figures(monkeypatch):
    """The figures that would have been written."""
    drawn = []
    monkeypatch.setattr(score_plots, "write_figure", lambda figure, _: drawn.append(figure))
    return drawn


def of_file(path, name, track, stratum, metric):
    return json.loads(path.read_text())["objects"][name][track][stratum][metric]["value"]


@pytest.mark.parametrize("stratum", ["all", "shown"])
def test_points_are_precision_and_recall_at_each_threshold(figures, stratum):
    score_plots.plot_precision_recall([TRUTH, ROUNDED], Path("x.png"), "tetX", stratum)
    (axes,) = figures[0].axes
    assert [line.get_label() for line in axes.lines] == [json.loads(p.read_text())["method"] for p in (TRUTH, ROUNDED)]
    for line, path in zip(axes.lines, (TRUTH, ROUNDED), strict=True):
        thresholds = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
        for axis, what in ((line.get_xdata(), "recall"), (line.get_ydata(), "precision")):
            wanted = [of_file(path, "tetX", "classifier", stratum, f"{what}_above_{t:g}") for t in thresholds]
            assert np.allclose(axis, wanted)


def test_points_are_coverage_and_accuracy_at_each_angle(figures):
    score_plots.plot_coverage([SPREAD], Path("x.png"), "cylO")
    (axes,) = figures[0].axes
    assert len(axes.lines) == 2
    for line, what in zip(axes.lines, ("coverage", "accuracy"), strict=True):
        assert list(line.get_xdata()) == [1, 2, 5, 10, 15, 30]
        wanted = [of_file(SPREAD, "cylO", "hypotheses", "all", f"{what}_at_{t}_deg") for t in (1, 2, 5, 10, 15, 30)]
        assert np.allclose(line.get_ydata(), wanted)
    assert len(axes.collections) == 2  # their intervals


@pytest.mark.parametrize("command", ["precision-recall", "coverage"])
def test_commands_write_a_picture_or_say_what_is_missing(command, tmp_path):
    out = tmp_path / "curve.pdf"
    done = CliRunner().invoke(plot, [command, str(TRUTH), "--object", "tetX", "--out", str(out)])
    assert done.exit_code == 0, done.exception
    assert out.read_bytes().startswith(b"%PDF")
    done = CliRunner().invoke(plot, [command, str(TRUTH), "--object", "cube", "--out", str(tmp_path / "none.pdf")])
    assert isinstance(done.exception, ScoresError)
    assert "track about cube, with a stratum all; it is about cylO, tetX" in str(done.exception)
    assert not (tmp_path / "none.pdf").exists()


def test_a_stratum_that_an_object_lacks_is_refused(tmp_path):
    with pytest.raises(ScoresError, match=r"classifier track about tetX, with a stratum of all"):
        score_plots.plot_precision_recall([TRUTH], tmp_path / "x.png", "tetX", "of all")
    with pytest.raises(ScoresError, match="expected a classifier track"):
        score_plots.plot_precision_recall([SPREAD], tmp_path / "x.png", "tetX")
