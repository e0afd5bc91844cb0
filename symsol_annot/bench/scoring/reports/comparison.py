"""Methods side by side: their scores, and paired bootstrap differences from the first."""

import os
from collections.abc import Sequence
from typing import Any, TypeAlias

import numpy as np

from symsol_annot.bench.scoring.averages import difference
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.reports.report import STRATA
from symsol_annot.bench.scoring.reports.scores_file import per_image_table, read_scores, strata_of
from symsol_annot.bench.scoring.reports.tables import aligned, remarks, short
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.errors import ScoresError

AnyPath: TypeAlias = str | os.PathLike[str]


def compare(paths: Sequence[AnyPath]) -> str:
    """Return tables of the scores files side by side, object by object and track by track.

    Raises:
        ScoresError: a file is broken, or they are about different images.
    """
    documents = [read_scores(path) for path in paths]
    shared = [name for name in documents[0]["objects"] if all(name in other["objects"] for other in documents)]
    if not shared:
        raise ScoresError("the files have no object in common")
    tables = []
    for name in shared:
        entries = [document["objects"][name] for document in documents]
        for entry, path in zip(entries, paths, strict=True):
            _refuse_other_images(name, entries[0], paths[0], entry, path)
        for track in SCORINGS:
            sides = [(d["method"], entry) for d, entry in zip(documents, entries, strict=True) if track in entry]
            if len(sides) > 1:
                tables.append(_compare_track(name, track, sides))
    if not tables:
        raise ScoresError("the files have no track in common")
    return "\n\n".join(tables)


def _refuse_other_images(name: str, a: dict[str, Any], a_path: AnyPath, b: dict[str, Any], b_path: AnyPath) -> None:
    for what in ("split", "fingerprint", "images"):
        if a[what] != b[what]:
            raise ScoresError(
                f"{name}: {a_path} is about {what} {a[what]!r}, {b_path} about {b[what]!r}; "
                "only scores on the same images can be compared"
            )
    for what in ("set_size", "strata"):
        if a["per_image"][what] != b["per_image"][what]:
            raise ScoresError(f"{name}: {a_path} and {b_path} differ in per_image.{what} of the same images")


def _compare_track(name: str, track: str, sides: list[tuple[str, dict[str, Any]]]) -> str:
    tables = [per_image_table(entry, track) for _, entry in sides]
    metrics = [
        metric for metric in metrics_shown(track, Place.TABLES) if all(metric.name in table.values for table in tables)
    ]
    if not metrics:
        raise ScoresError(f"{name}, {track}: the files have no metric in common")
    strata = strata_of(sides[0][1])
    names = [metric.name for metric in metrics]
    differences = [difference(tables[0].select(names), other.select(names), strata) for other in tables[1:]]
    first = f"{sides[0][0]}: {sides[0][1][track]['name']}"
    lines = [f"{name}, {track}; differences from {first}, with the 95% interval of the paired bootstrap"]
    labels = [f"{method}: {entry[track]['name']}" for method, entry in sides]
    for stratum in (s for s in STRATA if s in strata):
        rows = [
            [
                f"{stratum} ({int(strata[stratum].sum())})",
                labels[0],
                *(x for label in labels[1:] for x in (label, "difference")),
            ]
        ]
        for metric in metrics:
            cells = [_value(sides[0][1][track][stratum][metric.name])]
            for (_, entry), made in zip(sides[1:], differences, strict=True):
                figure, value = made[stratum][metric.name], entry[track][stratum][metric.name]
                cells += [_value(value), _difference(figure.value, figure.low, figure.high)]
            rows.append([metric.label, *cells])
        lines += ["", *aligned(rows)]
    for method, entry in sides:
        lines += remarks(entry[track], f", {method}")
    return "\n".join(lines)


def _value(figure: dict[str, Any]) -> str:
    return "-" if figure["value"] is None else short(figure["value"])


def _difference(value: float, low: float, high: float) -> str:
    if np.isnan(value):
        return "-"
    return short(value, "+") + ("" if np.isnan(low) else f" [{short(low, '+')}, {short(high, '+')}]")
