"""Scores as curves: precision and recall over thresholds, coverage over angles, and how much of a set regions hold."""

import os
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

from symsol_annot.bench.scoring.reports.report import STRATA
from symsol_annot.bench.scoring.reports.scores_file import read_scores
from symsol_annot.bench.scoring.scorers.classifier import CLASSIFIER_SCORING, SWEPT_THRESHOLDS
from symsol_annot.bench.scoring.scorers.density import DENSITY_SCORING, REGIONS, region_metric
from symsol_annot.bench.scoring.scorers.hypotheses import ANGLES_DEG, HYPOTHESES_SCORING
from symsol_annot.bench.scoring.scorers.scorer import TrackScoring
from symsol_annot.errors import ScoresError
from symsol_annot.plotting.canvas import SERIES, label_text, legend_below, legend_mark, new_figure, write_figure

AnyPath: TypeAlias = str | os.PathLike[str]
Figures: TypeAlias = Mapping[str, Mapping[str, Any]]

_INCHES = (4.2, 3.7)
_MARKERS = "os^Dv<>"
_COVERAGE_LINES = {"coverage": "-", "accuracy": "--"}  # what is drawn of each method, and how
_LABELLED = (0.1, 0.5, 0.8, 0.99)  # thresholds whose points are named
_SHARE = (-0.02, 1.06)  # the limits of an axis


def plot_precision_recall(scores: Sequence[AnyPath], path: AnyPath, name: str, stratum: str = "all") -> None:
    """Write the precision of classifiers over their recall, at the thresholds that `score` sweeps.

    Args:
        scores: files of scores, a curve each.
        path: a PNG, PDF or SVG.
        name: of the object.
        stratum: of its images.

    Raises:
        ScoresError: a file is broken, or has no classifier's track about the object.
        OutputError: the picture cannot be written.
        SettingsError: it is none of those forms.
        MissingExtraError: matplotlib is not installed.
    """
    axes_options = {"xlabel": "recall (numbers: threshold of the probability)", "ylabel": "precision", "xlim": _SHARE}
    _plot(scores, path, name, stratum, CLASSIFIER_SCORING, _draw_precision_recall, axes_options)


def plot_coverage(scores: Sequence[AnyPath], path: AnyPath, name: str, stratum: str = "all") -> None:
    """Write the coverage of hypotheses over the angle, and dashed their accuracy, with their 95% intervals.

    Args:
        scores: files of scores, two curves each.
        path: a PNG, PDF or SVG.
        name: of the object.
        stratum: of its images.

    Raises:
        ScoresError: a file is broken, or has no hypotheses' track about the object.
        OutputError: the picture cannot be written.
        SettingsError: it is none of those forms.
        MissingExtraError: matplotlib is not installed.
    """
    axes_options = {"xlabel": "angle, degrees", "ylabel": "share within the angle"}
    _plot(scores, path, name, stratum, HYPOTHESES_SCORING, _draw_coverage, axes_options, more=_COVERAGE_LINES)


def plot_calibration(scores: Sequence[AnyPath], path: AnyPath, name: str, stratum: str = "all") -> None:
    """Write how much of the sets the smallest regions of densities hold, over the regions' mass, with 95% intervals.

    A density that is right is on the diagonal; below it, it is surer than it should be.

    Args:
        scores: files of scores, a curve each.
        path: a PNG, PDF or SVG.
        name: of the object.
        stratum: of its images.

    Raises:
        ScoresError: a file is broken, or has no density's track about the object, or is of before regions were scored.
        OutputError: the picture cannot be written.
        SettingsError: it is none of those forms.
        MissingExtraError: matplotlib is not installed.
    """
    axes_options = {"xlabel": "mass of the region", "ylabel": "share of the set in it", "xlim": _SHARE}
    _plot(scores, path, name, stratum, DENSITY_SCORING, _draw_calibration, axes_options)


def _plot(
    scores: Sequence[AnyPath],
    path: AnyPath,
    name: str,
    stratum: str,
    scoring: TrackScoring,
    draw: Callable[[Any, str, Figures, Mapping[str, Any]], None],
    axes_options: Mapping[str, Any],
    more: Mapping[str, str] | None = None,
) -> None:
    """Write a picture to which each file adds, by `draw`, its method's figures in a style of its own.

    `more` are lines that the legend names beside the methods, by their labels.
    """
    figure = new_figure(figsize=_INCHES, layout="constrained")
    axes = figure.add_subplot()
    for number, (method, figures) in enumerate(_results(scores, name, scoring, stratum)):
        colour, marker = SERIES[number % len(SERIES)], _MARKERS[number % len(_MARKERS)]
        draw(axes, method, figures, {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.2})
    title = name if stratum == "all" else f"{name}, {stratum}"
    axes.set(**axes_options, ylim=_SHARE, title=label_text(title))
    axes.title.set_fontsize(9)
    axes.grid(visible=True, color="0.9", linewidth=0.5)
    if any(len(line.get_xdata()) for line in axes.lines):
        handles, _ = axes.get_legend_handles_labels()
        legend_below(figure, [*handles, *(legend_mark(label, line=line) for label, line in (more or {}).items())])
    write_figure(figure, Path(path))


def _draw_precision_recall(axes: Any, method: str, figures: Figures, style: Mapping[str, Any]) -> None:
    recall, precision = (
        _values(figures, {t: f"{what}_above_{t:g}" for t in SWEPT_THRESHOLDS}) for what in ("recall", "precision")
    )
    thresholds = [t for t in recall if t in precision]
    points = [(recall[t]["value"], precision[t]["value"]) for t in thresholds]
    axes.plot([x for x, _ in points], [y for _, y in points], label=label_text(method), **style)
    for threshold, point in zip(thresholds, points, strict=True):
        if threshold in _LABELLED:
            axes.annotate(f"{threshold:g}", point, (4, 3), textcoords="offset points", fontsize=6)


def _draw_coverage(axes: Any, method: str, figures: Figures, style: Mapping[str, Any]) -> None:
    for what, dashes in _COVERAGE_LINES.items():
        values = _values(figures, {angle: f"{what}_at_{angle}_deg" for angle in ANGLES_DEG})
        shares = [figure["value"] for figure in values.values()]
        label = label_text(method) if what == "coverage" else None
        axes.plot(list(values), shares, label=label, **{**style, "linestyle": dashes})
        known = {angle: f for angle, f in values.items() if f["low"] is not None and f["high"] is not None}
        ends = ([figure[end] for figure in known.values()] for end in ("low", "high"))
        axes.fill_between(list(known), *ends, color=style["color"], alpha=0.12, linewidth=0)


def _draw_calibration(axes: Any, method: str, figures: Figures, style: Mapping[str, Any]) -> None:
    values = _values(figures, {percent / 100.0: region_metric(percent) for percent in REGIONS})
    if not values:
        raise ScoresError(
            f"the scores of {method} do not say how much of a set regions hold: they are of an earlier version; "
            "`symsol-annot score` writes them again"
        )
    if not axes.lines:
        axes.plot([0.0, 1.0], [0.0, 1.0], color="0.6", linewidth=0.8, linestyle=":")
    axes.plot(list(values), [figure["value"] for figure in values.values()], label=label_text(method), **style)
    known = {mass: f for mass, f in values.items() if f["low"] is not None and f["high"] is not None}
    ends = ([figure[end] for figure in known.values()] for end in ("low", "high"))
    axes.fill_between(list(known), *ends, color=style["color"], alpha=0.12, linewidth=0)


def _results(paths: Sequence[AnyPath], name: str, scoring: TrackScoring, stratum: str) -> list[tuple[str, Figures]]:
    """Return the name of each file's result, with its M where it has one, and its figures."""
    found, track = [], scoring.track.name
    for path in paths:
        document = read_scores(path)
        scores = document["objects"].get(name, {}).get(track, {})
        figures = scores.get(stratum) if stratum in STRATA else None
        if figures is None:
            there = ", ".join(document["objects"]) or "no object"
            raise ScoresError(
                f"{path}: expected a {track} track about {name}, with a stratum {stratum}; it is about {there}"
            )
        facts = "".join(f" ({fact} = {scores[fact]})" for fact in scoring.shown_facts)
        found.append((f"{document['method']}{facts}", figures))
    return found


def _values(figures: Figures, names: Mapping[float, str]) -> dict[float, Mapping[str, Any]]:
    """Return threshold or angle to figure, of the metrics that are there and defined."""
    there = {number: figures[name] for number, name in names.items() if name in figures}
    return {number: figure for number, figure in there.items() if figure["value"] is not None}
