"""Scores as a document (scores.json), a table for people, and a CSV with a row per image."""

import csv
import io
import json
import math
import re
import textwrap
from collections.abc import Iterable, Sequence
from functools import partial
from importlib.metadata import version
from typing import Any

import numpy as np

from symsol_annot import __version__
from symsol_annot.bench.predictions.queries import group_sha256
from symsol_annot.bench.scoring.averages import DRAWS, MIN_IMAGES, Figure
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.bench.scoring.scoring import ObjectScores, TrackScores
from symsol_annot.errors import ScoresError
from symsol_annot.rotations.grid import grid_sha256

SCORES_FORMAT = "symsol-annot scores"
SCORES_FORMAT_VERSION = 1
DECIMALS = "decimals"  # the key that says to how many each image's figures were rounded
_WIDTH = 116
STRATA = ("all", "shown", "hidden", "barely")
_LISTS = re.compile(r"\[\n[^\[\]{}]*\]")  # innermost lists; a string holds no line break
F_NOTE = (
    "F is not compared from one stratum to another: a set of 720 has more grid rotations around it than a set of 1,\n"
    "but not 720 times as many, so that equally tight answers have other precisions."
)


def to_document(scores: Sequence[ObjectScores], decimals: int | None = None) -> dict[str, Any]:
    """Return the scores of one method on some objects as a JSON document.

    Args:
        scores: of each object.
        decimals: to how many the figures of single images are rounded, which makes the file smaller; None for twelve
            digits. What is averaged is not rounded.

    Raises:
        ScoresError: two files are about one object, or of different methods.
    """
    names = [one.truth.object for one in scores]
    doubled = sorted({name for name in names if names.count(name) > 1})
    if doubled:
        raise ScoresError(f"more than one of the files is about {', '.join(doubled)}; score one file per object")
    methods = sorted({one.method for one in scores})
    if len(methods) > 1:
        raise ScoresError(f"the files are of different methods ({', '.join(methods)}); score one method at a time")
    return {
        "format": SCORES_FORMAT,
        "format_version": SCORES_FORMAT_VERSION,
        "method": methods[0],
        "ranks": not any(track.warnings for one in scores for track in one.tracks.values()),
        "versions": {
            "symsol-annot": __version__,
            **{name: version(name) for name in ("numpy", "scipy", "h5py")},
        },
        "bootstrap": {"draws": DRAWS, "interval": 0.95, "min_images": MIN_IMAGES},
        "objects": {one.truth.object: _object(one, decimals) for one in scores},
    }


def _object(scores: ObjectScores, decimals: int | None) -> dict[str, Any]:
    truth = scores.truth
    document: dict[str, Any] = {
        "split": truth.split,
        "images": len(truth),
        "fingerprint": truth.fingerprint,
        "group_sha256": group_sha256(truth.labels.symmetry_group),
        "predictions": {"file": scores.file, "sha256": scores.sha256},
        "strata": {name: int(rows.sum()) for name, rows in truth.strata.items()},
    }
    for name, track in scores.tracks.items():
        level = track.facts.get("grid_level")
        document[name] = {
            "name": track.name,
            **track.facts,
            **({} if level is None else {"grid_sha256": grid_sha256(int(level))}),
            "warnings": list(track.warnings),
            "notes": list(track.notes),
            **{
                stratum: {metric: _figure(figure) for metric, figure in figures.items()}
                for stratum, figures in track.figures.items()
            },
        }
    document["per_image"] = _per_image(scores, decimals)
    return document


def _figure(figure: Figure) -> dict[str, Any]:
    return {
        "value": _number(figure.value),
        "low": _number(figure.low),
        "high": _number(figure.high),
        "images": figure.images,
        "undefined": figure.undefined,
    }


def _per_image(scores: ObjectScores, decimals: int | None) -> dict[str, Any]:
    """Return what `compare` needs: strata, set sizes and the table's metrics of each image."""
    truth = scores.truth
    return {
        **({} if decimals is None else {DECIMALS: decimals}),
        "set_size": truth.set_sizes.tolist(),
        "strata": {name: np.flatnonzero(rows).tolist() for name, rows in truth.strata.items() if name != "all"},
        **{
            name: {
                metric: [_number(value, decimals) for value in track.per_image.values[metric].tolist()]
                for metric in _tabulated(name, track)
            }
            for name, track in scores.tracks.items()
        },
    }


def _tabulated(name: str, track: TrackScores) -> list[str]:
    """Return the metrics that tables show of a track, as far as this object has them."""
    return [metric.name for metric in metrics_shown(name, Place.TABLES) if metric.name in track.per_image.values]


def _number(value: float, decimals: int | None = None) -> float | None:
    """Return a JSON number with what digits mean something, rounded where asked; null where undefined."""
    if not math.isfinite(value):
        return None
    return float(f"{value:.12g}") if decimals is None else round(value, decimals)


def to_json(document: dict[str, Any]) -> str:
    """Return a document as JSON that a person can read down to the figures and that has one line per list."""
    text = json.dumps(document, indent=1, allow_nan=False)
    return _LISTS.sub(lambda found: re.sub(r"\n *", " ", found.group()), text) + "\n"


def tables(document: dict[str, Any]) -> str:
    """Return the tables of all objects, and the benchmark's where there are several."""
    parts = [_object_tables(document["method"], name, entry) for name, entry in document["objects"].items()]
    if len(document["objects"]) > 1:
        parts.append(_summary(document))
    return "\n\n".join(parts)


def _object_tables(method: str, name: str, entry: dict[str, Any]) -> str:
    lines = [f"{name}, {entry['split']} split, {entry['images']} images: {method}"]
    for track in SCORINGS:
        if track in entry:
            lines += ["", *_track_table(track, entry)]
    if len(entry["strata"]) > 1 and any(track in entry and _has_f_measure(track) for track in SCORINGS):
        lines += ["", *F_NOTE.splitlines()]
    return "\n".join(lines)


def _track_table(track: str, entry: dict[str, Any]) -> list[str]:
    scores = entry[track]
    strata = [stratum for stratum in STRATA if stratum in scores]
    rows = [[scores["name"], *(f"{s} ({entry['strata'][s]})" for s in strata)]]
    rows += [
        [metric.label + metric.arrow, *(cell(scores[s][metric.name]) for s in strata)]
        for metric in metrics_shown(track, Place.TABLES)
        if metric.name in scores["all"]
    ]
    return [*aligned(rows), *SCORINGS[track].caption(scores), *remarks(scores)]


def _has_f_measure(track: str) -> bool:
    return any(metric.name.startswith("f_measure") for metric in metrics_shown(track, Place.TABLES))


def remarks(scores: dict[str, Any], whose: str = "") -> list[str]:
    """Return a track's warnings, for which it does not rank, and notes, with which it does, as lines of a table.

    Args:
        scores: of the track, as the document has them.
        whose: they are, where several methods are shown.
    """
    found = [f"WARNING{whose}: {warning}" for warning in scores["warnings"]]
    found += [f"NOTE{whose}: {note}" for note in scores.get("notes", [])]
    wrap = partial(textwrap.wrap, width=_WIDTH, break_long_words=False, break_on_hyphens=False)
    return [line for remark in found for line in wrap(remark)]


def cell(figure: dict[str, Any]) -> str:
    """Return a figure with its interval; "-" where it is undefined."""
    if figure["value"] is None:
        return "-"
    interval = "" if figure["low"] is None else f" [{short(figure['low'])}, {short(figure['high'])}]"
    return short(figure["value"]) + interval


def short(value: float, sign: str = "-") -> str:
    """Return a figure with four decimals, or as a power of ten where those say nothing; sign "+" always shows one."""
    return f"{value:{sign}.4f}" if value == 0 or abs(value) >= 1e-3 else f"{value:{sign}.1e}"


def _summary(document: dict[str, Any]) -> str:
    """Return a row per figure and a column per object, and their mean."""
    lines = ["all objects, all images"]
    for track, scoring in SCORINGS.items():
        entries = {name: entry[track] for name, entry in document["objects"].items() if track in entry}
        if not entries:
            continue
        rows = [[track, *entries, "mean"]]
        for fact, title in scoring.shown_facts.items():
            rows.append([title, *(str(entry[fact]) for entry in entries.values()), ""])
        for metric in metrics_shown(track, Place.SUMMARY):
            values = [entry["all"][metric.name]["value"] for entry in entries.values()]
            known = [value for value in values if value is not None]
            mean = short(float(np.mean(known))) if known else "-"
            rows.append([metric.title, *("-" if v is None else short(v) for v in values), mean])
        lines += ["", *aligned(rows)]
    return "\n".join(lines)


def aligned(rows: Iterable[Sequence[str]]) -> list[str]:
    """Return rows as lines with the first column to the left and the others to the right."""
    table = [list(row) for row in rows]
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    return [
        "  ".join(
            cell.rjust(width) if column else cell.ljust(width)
            for column, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in table
    ]


def per_image_csv(scores: Sequence[ObjectScores]) -> str:
    """Return a row per image, of all objects, with every metric of every track as a column."""
    columns = {
        f"{name}.{metric}": None
        for one in scores
        for name, track in one.tracks.items()
        for metric in track.per_image.values
    }
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["object", "split", "image_index", "stratum", "barely", "set_size", *columns])
    for one in scores:
        strata = one.truth.strata
        for i in range(len(one.truth)):
            stratum = next((name for name in ("shown", "hidden") if name in strata and strata[name][i]), "all")
            figures = {
                f"{name}.{metric}": _number(float(values[i]))
                for name, track in one.tracks.items()
                for metric, values in track.per_image.values.items()
            }
            barely = int("barely" in strata and strata["barely"][i])
            about = [one.truth.object, one.truth.split, i, stratum, barely, int(one.truth.set_sizes[i])]
            writer.writerow([*about, *("" if figures.get(c) is None else figures[c] for c in columns)])
    return text.getvalue()
