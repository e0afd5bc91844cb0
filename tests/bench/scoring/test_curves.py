"""Curves of scores: each point is a figure of the file, and a file without them is refused."""

import json
from pathlib import Path
from xml.etree import ElementTree as ET

import numpy as np
import pytest
from click.testing import CliRunner
from matplotlib import rc_context
from symsol_annot_cli.plot import plot

from symsol_annot.bench.scoring.reports import curves as score_plots
from symsol_annot.errors import ScoresError
from symsol_annot.plotting.canvas import write_figure

REFERENCE = Path(__file__).resolve().parents[3] / "docs" / "results" / "reference"
SHARES = ("recall", "precision")
TRUTH, ROUNDED, SPREAD = (REFERENCE / f"{name}.json" for name in ("truth", "rounded-to-grid", "evenly-placed"))


@pytest.fixture
def figures(monkeypatch):
    """The figures that would have been written."""
    drawn = []
    monkeypatch.setattr(score_plots, "write_figure", lambda figure, _: drawn.append(figure))
    return drawn


def rounded(points):
    return {tuple(float(round(number, 9)) for number in point) for point in points}


def of_file(path, name, track, stratum, metric, what="value"):
    return json.loads(path.read_text())["objects"][name][track][stratum][metric][what]


def test_points_are_how_much_of_the_sets_regions_hold_beside_the_diagonal(figures):
    score_plots.plot_calibration([TRUTH], Path("x.png"), "tetX")
    (axes,) = figures[0].axes
    diagonal, curve = axes.lines
    assert list(diagonal.get_xdata()) == list(diagonal.get_ydata()) == [0.0, 1.0]
    wanted = [of_file(TRUTH, "tetX", "density", "all", f"set_in_region_of_{q}_percent") for q in (50, 80, 90, 95, 99)]
    assert np.allclose(curve.get_xdata(), [0.5, 0.8, 0.9, 0.95, 0.99])
    assert np.allclose(curve.get_ydata(), wanted)
    (area,) = axes.collections
    ends = {
        (q / 100, of_file(TRUTH, "tetX", "density", "all", f"set_in_region_of_{q}_percent", end))
        for q in (50, 80, 90, 95, 99)
        for end in ("low", "high")
    }
    assert rounded(area.get_paths()[0].vertices) == rounded(ends)


def test_scores_of_before_regions_were_counted_are_refused_by_name(tmp_path):
    document = json.loads(TRUTH.read_text())
    scores = document["objects"]["tetX"]
    for table in (scores["per_image"]["density"], *scores["density"].values()):
        for name in [name for name in table if "region" in name] if isinstance(table, dict) else ():
            del table[name]
    path = tmp_path / "old.json"
    path.write_text(json.dumps(document))
    with pytest.raises(ScoresError, match="earlier version; `symsol-annot score` writes them again"):
        score_plots.plot_calibration([path], tmp_path / "x.png", "tetX")


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
    named = {text.get_text(): text.xy for text in axes.texts[: len(axes.texts) // 2]}
    assert named == {
        f"{t:g}": tuple(of_file(TRUTH, "tetX", "classifier", stratum, f"{what}_above_{t:g}") for what in SHARES)
        for t in (0.1, 0.5, 0.8, 0.99)
    }
    assert axes.get_title() == ("tetX" if stratum == "all" else "tetX, shown")


@pytest.mark.parametrize(
    ("draw", "are_both_shares"),
    [
        (score_plots.plot_precision_recall, True),
        (score_plots.plot_calibration, True),
        (score_plots.plot_coverage, False),
    ],
)
def test_axes_of_shares_have_0_and_1_inside_with_a_narrow_margin(draw, are_both_shares, figures):
    draw([TRUTH], Path("x.png"), "tetX")
    (axes,) = figures[0].axes
    for low, high in (axes.get_ylim(), axes.get_xlim())[: 1 + are_both_shares]:
        assert -0.1 < low < 0
        assert 1 < high < 1.1


def test_points_are_coverage_and_accuracy_at_each_angle(figures):
    score_plots.plot_coverage([SPREAD], Path("x.png"), "cylO")
    (axes,) = figures[0].axes
    assert len(axes.lines) == 2
    for line, what in zip(axes.lines, ("coverage", "accuracy"), strict=True):
        assert list(line.get_xdata()) == [1, 2, 5, 10, 15, 30]
        wanted = [of_file(SPREAD, "cylO", "hypotheses", "all", f"{what}_at_{t}_deg") for t in (1, 2, 5, 10, 15, 30)]
        assert np.allclose(line.get_ydata(), wanted)
    for area, what in zip(axes.collections, ("coverage", "accuracy"), strict=True):
        ends = {
            (angle, of_file(SPREAD, "cylO", "hypotheses", "all", f"{what}_at_{angle}_deg", end))
            for angle in (1, 2, 5, 10, 15, 30)
            for end in ("low", "high")
        }
        assert rounded(area.get_paths()[0].vertices) == rounded(ends)
    assert [text.get_text() for text in figures[0].legends[0].get_texts()] == [
        f"{json.loads(SPREAD.read_text())['method']} (M = 30)", "coverage", "accuracy",
    ]  # fmt: skip
    assert axes.lines[0].get_label() == figures[0].legends[0].get_texts()[0].get_text()


@pytest.mark.parametrize(
    ("draw", "track", "metric", "at"),
    [
        (score_plots.plot_coverage, "hypotheses", "coverage_at_2_deg", 2),
        (score_plots.plot_calibration, "density", "set_in_region_of_80_percent", 0.8),
    ],
)
def test_an_interval_that_lacks_an_end_is_left_out(draw, track, metric, at, figures, tmp_path):
    document = json.loads(TRUTH.read_text())
    document["objects"]["tetX"][track]["all"][metric]["low"] = None
    path = tmp_path / "scores.json"
    path.write_text(json.dumps(document))
    draw([path], Path("x.png"), "tetX")
    (axes,) = figures[0].axes
    across = axes.collections[0].get_paths()[0].vertices[:, 0]
    assert len(across) > 4
    assert at not in across


NAMES = ["$a_{$", "cost $5 and $6", "_mine", "\u65e5\u672c\u8a9e"]


@pytest.mark.parametrize("method", NAMES)
@pytest.mark.parametrize(("command", "label"), [("precision-recall", "{}"), ("coverage", "{} (M = 9)")])
def test_the_legend_names_each_method_as_its_file_does_and_its_M(command, label, method, tmp_path):
    scores, out = tmp_path / "scores.json", tmp_path / "curve.svg"
    scores.write_text(json.dumps({**json.loads(TRUTH.read_text()), "method": method}))
    with rc_context({"svg.fonttype": "none"}):  # text as text
        done = CliRunner().invoke(plot, [command, str(scores), str(ROUNDED), "--object", "tetX", "--out", str(out)])
    assert done.exit_code == 0, done.exception
    texts = [text.text.strip() for text in ET.parse(out).iter("{http://www.w3.org/2000/svg}text")]
    assert texts.count(label.format(method)) == 1


@pytest.mark.parametrize("draw", [score_plots.plot_precision_recall, score_plots.plot_coverage])
def test_a_stratum_without_figures_is_drawn_without_a_legend(draw, figures, tmp_path):
    draw([TRUTH, ROUNDED], Path("x.png"), "tetX", "barely")
    (axes,) = figures[0].axes
    assert axes.get_legend() is None
    assert figures[0].legends == []
    write_figure(figures[0], tmp_path / "x.png")


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


@pytest.mark.parametrize(
    ("track", "metric", "value"),
    [
        ("classifier", "recall_above_0.8", [0.5]),
        ("classifier", "recall_above_0.8", {"value": "0.5"}),
        ("classifier", "recall_above_0.8", {"value": 1e300, "low": 0, "high": 1, "images": 1, "undefined": 0}),
        ("hypotheses", "coverage_at_2_deg", None),
        ("hypotheses", "coverage_at_2_deg", {"value": 0.5, "low": [], "high": 1, "images": 1, "undefined": 0}),
    ],
)
def test_a_figure_that_is_none_is_refused_by_name(track, metric, value, tmp_path):
    document = json.loads(TRUTH.read_text())
    document["objects"]["tetX"][track]["all"][metric] = value
    path = tmp_path / "scores.json"
    path.write_text(json.dumps(document))
    draw = score_plots.plot_coverage if track == "hypotheses" else score_plots.plot_precision_recall
    with pytest.raises(ScoresError, match=f"{track}.all.{metric} has no value with an interval"):
        draw([path], tmp_path / "x.png", "tetX")


def test_metrics_of_other_names_and_missing_ones_are_not_drawn(figures, tmp_path):
    document = json.loads(TRUTH.read_text())
    figure_set = document["objects"]["tetX"]["classifier"]["all"]
    figure_set["recall_above_1.2.3"] = figure_set["recall_above_0.8"]
    del figure_set["precision_above_0.5"]
    path = tmp_path / "scores.json"
    path.write_text(json.dumps(document))
    score_plots.plot_precision_recall([str(path)], "x.png", "tetX")
    assert len(figures[0].axes[0].lines[0].get_xdata()) == 10
