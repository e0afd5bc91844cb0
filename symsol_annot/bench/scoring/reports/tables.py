"""Scores as tables for people, as wide as they have room for."""

import shutil
import textwrap
from collections.abc import Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.scoring.metric import HIGHER, Place
from symsol_annot.bench.scoring.reports.report import STRATA
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of, metrics_shown

WIDTH = 116  # where nobody says how much room there is
WORST = 10  # images are named
_NARROWEST = 24  # that a column of titles is wrapped to
_GAP = 2  # blanks between columns
_TIED = "\N{NO-BREAK SPACE}"  # a blank at which no line is broken


def room() -> int:
    """Return the width to print for: what COLUMNS says, else the terminal's; 116 where there is neither."""
    return shutil.get_terminal_size((WIDTH, 24)).columns


def tables(document: Mapping[str, Any], *, intervals: bool = False, width: int = WIDTH) -> str:
    """Return the tables of all objects of a scores.json, and the benchmark's where there are several.

    Args:
        document: as `report.to_document` makes it.
        intervals: whether figures stand with their 95% intervals.
        width: in characters; columns that do not fit follow below.
    """
    parts = [
        "\n".join(_object_tables(document["method"], name, entry, intervals=intervals, width=width))
        for name, entry in document["objects"].items()
    ]
    if len(document["objects"]) > 1:
        parts.append("\n".join(_summary(document, width)))
    return "\n\n".join(parts)


def worst_rows(values: npt.NDArray[np.float64], better: str, count: int = WORST) -> npt.NDArray[np.intp]:
    """Return the rows of the worst values (n,), the worst first; equal ones in their order, undefined ones left out."""
    order = np.argsort(values if better == HIGHER else -values, kind="stable")
    return order[~np.isnan(values[order])][:count]


def _object_tables(method: str, name: str, entry: Mapping[str, Any], *, intervals: bool, width: int) -> Iterator[str]:
    yield from _wrapped(f"{name}, {entry['split']} split, {entry['images']} images: {method}", width)
    for track in (track for track in SCORINGS if track in entry):
        for line in _headline(track, entry[track]):
            yield from _wrapped(line, width)
    for track in (track for track in SCORINGS if track in entry):
        yield ""
        yield from _track_table(track, entry, intervals=intervals, width=width)


def _track_table(track: str, entry: Mapping[str, Any], *, intervals: bool, width: int) -> Iterator[str]:
    scores = entry[track]
    strata = [stratum for stratum in STRATA if stratum in scores]
    rows = [[scores["name"], *(f"{s} ({entry['strata'][s]})" for s in strata)]]
    rows += [
        [metric.label + metric.arrow, *(cell(scores[s][metric.name], intervals=intervals) for s in strata)]
        for metric in metrics_shown(track, Place.TABLES)
        if metric.name in scores["all"]
    ]
    yield from aligned(rows, width)
    for line in (*SCORINGS[track].caption(scores), *_worst(track, entry)):
        yield from _wrapped(line, width)
    yield from remarks(scores, width=width)


def _headline(track: str, scores: Mapping[str, Any]) -> Iterator[str]:
    """Yield what ranks, beside chance and the best possible, as far as they are known."""
    headline = scores.get("headline")
    if headline is None or headline["value"] is None:
        return
    beside = [
        f"{words} {short(headline[key])}"
        for words, key in (("chance", "chance"), ("best possible", "best_possible"))
        if headline[key] is not None
    ]
    metric = metric_of(track, headline["metric"])
    words = f"  {track}: {metric.words} {short(headline['value'])}"
    yield words + (f" ({', '.join(beside)})" if beside else "")


def _worst(track: str, entry: Mapping[str, Any]) -> Iterator[str]:
    """Yield the images that are the worst by what ranks; none where all are alike."""
    headline = entry[track].get("headline")
    if headline is None or headline["metric"] not in entry["per_image"][track]:
        return
    values = np.array(entry["per_image"][track][headline["metric"]], dtype=np.float64)
    rows = worst_rows(values, metric_of(track, headline["metric"]).better)
    if len(rows) and np.nanmin(values) < np.nanmax(values):
        index = entry.get("image_index", range(len(values)))  # other than the row where some images were scored
        yield "  worst images: " + ", ".join(f"{index[row]}{_TIED}({short(values[row])})" for row in rows)


def remarks(scores: Mapping[str, Any], whose: str = "", width: int = WIDTH) -> list[str]:
    """Return a track's warnings, for which it does not rank, and notes, with which it does, as lines of a table.

    Args:
        scores: of the track, as the document has them.
        whose: they are, where several methods are shown.
        width: in characters.
    """
    found = [f"WARNING{whose}: {warning}" for warning in scores["warnings"]]
    found += [f"NOTE{whose}: {note}" for note in scores.get("notes", [])]
    return [line for remark in found for line in _wrapped(remark, width)]


def cell(figure: Mapping[str, Any], *, intervals: bool = True) -> str:
    """Return a figure, with its interval if there is one and it is asked for; "-" where it is undefined."""
    if figure["value"] is None:
        return "-"
    has_interval = intervals and figure["low"] is not None
    return short(figure["value"]) + (f" [{short(figure['low'])}, {short(figure['high'])}]" if has_interval else "")


def short(value: float, sign: str = "-") -> str:
    """Return a figure with four decimals, or as a power of ten where those say nothing; sign "+" always shows one."""
    return f"{value:{sign}.4f}" if value == 0 or abs(value) >= 1e-3 else f"{value:{sign}.1e}"


def _summary(document: Mapping[str, Any], width: int) -> Iterator[str]:
    """Yield a row per figure and a column per object, and their mean."""
    yield "all objects, all images"
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
        yield ""
        yield from aligned(rows, width)


def aligned(rows: Iterable[Sequence[str]], width: int | None = None) -> list[str]:
    """Return rows as lines with the first column to the left and the others to the right.

    Args:
        rows: of as many cells each.
        width: in characters; columns that do not fit stand below, after the first column again, which is wrapped where
            it alone leaves no room. None for any width.
    """
    table = [list(row) for row in rows]
    widths = [max(len(row[column]) for row in table) for column in range(len(table[0]))]
    if width is None or sum(widths) + _GAP * (len(widths) - 1) <= width:
        return _lines(table, widths, range(1, len(widths)))
    widest = max(widths[1:], default=0)
    widths[0] = min(widths[0], max(_NARROWEST, width - _GAP - widest))
    table = [line for row in table for line in _wrapped_row(row, widths[0])]
    found: list[str] = []
    for columns in _groups(widths, width):
        found += [*([""] if found else []), *_lines(table, widths, columns)]
    return found


def _groups(widths: Sequence[int], width: int) -> Iterator[range]:
    """Yield runs of columns that fit beside the first one; a run has one at the least."""
    start, used = 1, widths[0]
    for column in range(1, len(widths)):
        if column > start and used + _GAP + widths[column] > width:
            yield range(start, column)
            start, used = column, widths[0]
        used += _GAP + widths[column]
    yield range(start, len(widths))


def _wrapped_row(row: Sequence[str], width: int) -> Iterator[list[str]]:
    """Yield a row whose title is wrapped; its figures stand in the last line of it."""
    indent = row[0][: len(row[0]) - len(row[0].lstrip())]
    lines = textwrap.wrap(row[0].strip(), width, initial_indent=indent, subsequent_indent=indent + "  ") or [""]
    yield from ([line, *[""] * (len(row) - 1)] for line in lines[:-1])
    yield [lines[-1], *row[1:]]


def _lines(table: Iterable[Sequence[str]], widths: Sequence[int], columns: range) -> list[str]:
    gap = " " * _GAP
    return [
        gap.join([row[0].ljust(widths[0]), *(row[column].rjust(widths[column]) for column in columns)]).rstrip()
        for row in table
    ]


def _wrapped(line: str, width: int) -> list[str]:
    indent = line[: len(line) - len(line.lstrip())]
    wrap = partial(textwrap.wrap, width=width, break_long_words=False, break_on_hyphens=False)
    lines = wrap(line, subsequent_indent=indent) if len(line) > width else [line]
    return [line.replace(_TIED, " ") for line in lines]
