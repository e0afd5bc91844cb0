"""Scores as curves: precision and recall over thresholds, coverage over angles."""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from symsol_annot.bench.scores_file import read_scores
from symsol_annot.canvas import SERIES, new_figure, write_figure
from symsol_annot.errors import ScoresError

_INCHES = (4.2, 3.4)
_MARKERS = "os^Dv<>"
_LABELLED = (0.1, 0.5, 0.8, 0.99)  # thresholds whose points are named


def plot_precision_recall(scores: Sequence[Path], path: Path, name: str, stratum: str = "all") -> None:
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
        SymsolError: matplotlib is not installed.
    """
    figure = new_figure(figsize=_INCHES, layout="constrained")
    axes = figure.add_subplot()
    for number, (method, figures) in enumerate(_tracks(scores, name, "classifier", stratum)):
        recall, precision = (_by_number(figures, f"{what}_above_") for what in ("recall", "precision"))
        thresholds = [t for t in recall if recall[t]["value"] is not None and precision[t]["value"] is not None]
        points = [(recall[t]["value"], precision[t]["value"]) for t in thresholds]
        axes.plot(*zip(*points, strict=True), label=method, **_style(number))
        for threshold, point in zip(thresholds, points, strict=True):
            if threshold in _LABELLED:
                axes.annotate(f"{threshold:g}", point, (3, 3), textcoords="offset points", fontsize=6)
    axes.set(xlabel="recall", ylabel="precision", xlim=(-0.02, 1.02), ylim=(-0.02, 1.02), title=_title(name, stratum))
    _finish(figure, axes, path)


def plot_coverage(scores: Sequence[Path], path: Path, name: str, stratum: str = "all") -> None:
    """Write the coverage of hypotheses over the angle, and dashed their accuracy, with their 95% intervals.

    Args, Raises: as `plot_precision_recall`, of the hypotheses track.
    """
    figure = new_figure(figsize=_INCHES, layout="constrained")
    axes = figure.add_subplot()
    for number, (method, figures) in enumerate(_tracks(scores, name, "hypotheses", stratum)):
        for what, dashes in (("coverage", "-"), ("accuracy", "--")):
            values = {angle: f for angle, f in _by_number(figures, f"{what}_at_").items() if f["value"] is not None}
            style = {**_style(number), "linestyle": dashes}
            axes.plot(list(values), [figure["value"] for figure in values.values()], label=f"{what}, {method}", **style)
            known = {angle: f for angle, f in values.items() if f.get("low") is not None and f.get("high") is not None}
            ends = ([figure[end] for figure in known.values()] for end in ("low", "high"))
            axes.fill_between(list(known), *ends, color=style["color"], alpha=0.12, linewidth=0)
    axes.set(xlabel="angle, degrees", ylabel="share within it", ylim=(-0.02, 1.02), title=_title(name, stratum))
    _finish(figure, axes, path)


def _tracks(
    paths: Sequence[Path], name: str, track: str, stratum: str
) -> list[tuple[str, Mapping[str, Mapping[str, Any]]]]:
    """Return method and figures of each file."""
    found = []
    for path in paths:
        document = read_scores(path)
        figures = document["objects"].get(name, {}).get(track, {}).get(stratum)
        if figures is None:
            there = ", ".join(document["objects"])
            raise ScoresError(
                f"{path}: expected a {track} track about {name}, with a stratum {stratum}; it is about {there}"
            )
        found.append((document["method"], figures))
    return found


def _by_number(figures: Mapping[str, Any], prefix: str) -> dict[float, Mapping[str, Any]]:
    """Return threshold or angle to figure, ascending, of the metrics that are named by one."""
    number = re.compile(rf"{prefix}([\d.]+)(_deg)?")
    named = {float(found[1]): figures[metric] for metric in figures if (found := number.fullmatch(metric))}
    return dict(sorted(named.items()))


def _style(number: int) -> dict[str, Any]:
    colour, marker = SERIES[number % len(SERIES)], _MARKERS[number % len(_MARKERS)]
    return {"color": colour, "marker": marker, "markersize": 3.5, "linewidth": 1.2}


def _title(name: str, stratum: str) -> str:
    return name if stratum == "all" else f"{name}, {stratum}"


def _finish(figure: Any, axes: Any, path: Path) -> None:
    axes.title.set_fontsize(9)
    axes.grid(visible=True, color="0.9", linewidth=0.5)
    axes.legend(fontsize=7, frameon=False)
    write_figure(figure, path)
