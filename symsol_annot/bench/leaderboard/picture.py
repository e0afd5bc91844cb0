"""The leaderboard as pictures: of each set and track, what ranks of each method, by object."""

import hashlib
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any

from symsol_annot.bench.leaderboard.entries import Leaderboard
from symsol_annot.bench.leaderboard.rows import COUNT, Mark, Row, Table, tables_of
from symsol_annot.plotting.canvas import SERIES, label_text, new_figure, write_figure

PICTURES = "images"  # the folder beside the page
_WIDTH_INCHES = 5.2  # as wide as a phone shows without letters too small
_ROW_INCHES, _LEGEND_INCHES, _MARGIN_INCHES = 0.15, 0.19, 0.75
_MARKERS = "osD^v<>PX"
_GREY = "0.45"  # of references, which are hollow
_LONGEST_LABEL = 60
_DECIMALS = 3  # of figures, on the page
_MANY_COUNTS = 4  # of which the least and the largest M are told


@dataclass(frozen=True, kw_only=True)
class Point:
    """A figure of a method about an object, with its interval."""

    object: str
    value: float
    low: float
    high: float


@dataclass(frozen=True, kw_only=True)
class Series:
    """A method and its points.

    Attributes:
        label: its title, with its sign and its M.
        is_reference: whether it was made from the labels.
        style: the number of its colour and its sign, its own among the results, or references, of a set.
        points: one per object that it says something of.
    """

    label: str
    is_reference: bool
    style: int
    points: tuple[Point, ...]


@dataclass(frozen=True, kw_only=True)
class Picture:
    """What a picture shows.

    Attributes:
        name: of its file.
        axis: the metric, in words, with an arrow to the better side.
        objects: from the top down.
        series: in the order of the legend.
    """

    name: str
    axis: str
    objects: tuple[str, ...]
    series: tuple[Series, ...]

    @property
    def digest(self) -> str:
        """A SHA-256 of what is shown; the picture's file names it, so that it can be compared on any machine.

        Figures count as the page tells them: their last bits depend on the machine, and on how many threads add up.
        """
        told = replace(self, series=tuple(replace(one, points=tuple(map(_told, one.points))) for one in self.series))
        return hashlib.sha256(repr(told).encode()).hexdigest()


def _told(point: Point) -> Point:
    value, low, high = (round(float(figure), _DECIMALS) + 0.0 for figure in (point.value, point.low, point.high))
    return replace(point, value=value, low=low, high=high)


def picture_name(folder: str, track: str) -> str:
    """Return the name of the picture of a set's track."""
    return f"leaderboard-{folder}-{track}.svg"


def pictures_of(board: Leaderboard) -> list[Picture]:
    """Return the pictures of a leaderboard: of each set and track that has results."""
    made = []
    for folder in board.sets:
        tables = tables_of(board, folder)
        styles = _styles(tables)
        for track in dict.fromkeys(table.track for table in tables if table.has_results):
            alike = [table for table in tables if table.track == track]
            metric = alike[0].metrics[0]
            objects = tuple(table.object for table in alike)
            axis = f"{metric.title}{metric.arrow}"
            made.append(
                Picture(name=picture_name(folder, track), axis=axis, objects=objects, series=_series(alike, styles))
            )
    return made


def _styles(tables: Sequence[Table]) -> Mapping[tuple[bool, str], int]:
    """Number the methods of a set's tables, those in most tables first, and its references for themselves."""
    keys = [_key(row) for table in tables for row in table.rows]
    found: dict[tuple[bool, str], int] = {}
    for is_reference in (False, True):
        alike = Counter(key for key in keys if key[0] == is_reference)
        found |= {key: number for number, (key, _) in enumerate(alike.most_common())}
    return found


def _series(tables: Sequence[Table], styles: Mapping[tuple[bool, str], int]) -> tuple[Series, ...]:
    """Return the methods of a track's tables, the best mean place first, and the references after them."""
    rows: dict[tuple[bool, str], dict[str, Row]] = {}
    places: dict[tuple[bool, str], list[int]] = {}
    for table in tables:
        for place, row in enumerate(table.rows):
            key = _key(row)
            rows.setdefault(key, {})[table.object] = row
            places.setdefault(key, []).append(place)
    in_order = sorted(rows, key=lambda key: (key[0], sum(places[key]) / len(places[key]), key[1]))
    metric = tables[0].metrics[0].name
    return tuple(
        Series(
            label=_label(rows[key]),
            is_reference=key[0],
            style=styles[key],
            points=_points(rows[key], metric),
        )
        for key in in_order
    )


def _key(row: Row) -> tuple[bool, str]:
    return row.is_reference, row.name


def _label(rows: Mapping[str, Row]) -> str:
    first = next(iter(rows.values()))
    title = "".join(c for c in " ".join(first.title.split()) if c.isprintable())
    title = title if len(title) <= _LONGEST_LABEL else f"{title[:_LONGEST_LABEL]}.."
    counts = sorted({row.facts[COUNT] for row in rows.values() if COUNT in row.facts})
    sign = f"{Mark.EXACT.value} " if any(Mark.EXACT in row.marks for row in rows.values()) else ""
    if not counts:
        return f"{sign}{title}"
    listed = ", ".join(map(str, counts)) if len(counts) < _MANY_COUNTS else f"{counts[0]} to {counts[-1]}"
    return f"{sign}{title} (M = {listed})"


def _points(rows: Mapping[str, Row], metric: str) -> tuple[Point, ...]:
    found = ((name, row.figures[metric]) for name, row in rows.items())
    return tuple(
        Point(object=name, value=f.value, low=f.low, high=f.high) for name, f in found if not math.isnan(f.value)
    )


def draw(picture: Picture, folder: Path) -> None:
    """Write a picture into a folder, as SVG: objects from the top down, methods below each other, the legend outside.

    Raises:
        OutputError: it cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    lines, ends = _lines(picture)
    height = _MARGIN_INCHES + ends[-1] * _ROW_INCHES + len(picture.series) * _LEGEND_INCHES
    figure = new_figure(figsize=(_WIDTH_INCHES, height), layout="constrained")
    axes = figure.add_subplot()
    for number, series in enumerate(picture.series):
        values = [point.value for point in series.points]
        rows = [lines[point.object, number] for point in series.points]
        below = [point.value - point.low for point in series.points]
        above = [point.high - point.value for point in series.points]
        label = label_text(series.label)
        axes.errorbar(values, rows, xerr=[below, above], linestyle="none", label=label, **_style(series))
    middles = [(start + end) / 2 - 1 for start, end in pairwise([0, *ends])]
    axes.set(xlabel=picture.axis, ylim=(ends[-1] - 1, -1))
    axes.set_yticks(middles, [label_text(name) for name in picture.objects])
    axes.tick_params(axis="y", length=0)
    axes.grid(visible=True, axis="x", color="0.9", linewidth=0.6)
    for end in ends[:-1]:
        axes.axhline(end - 1, color="0.8", linewidth=0.6)
    axes.set_axisbelow(True)
    axes.spines[["top", "right", "left"]].set_visible(False)
    figure.legend(loc="outside lower left", fontsize=9, frameon=False, ncols=1, handletextpad=0.4, borderpad=0.1)
    write_figure(figure, folder / picture.name, description=f"shows {picture.digest}")


def _lines(picture: Picture) -> tuple[dict[tuple[str, int], int], list[int]]:
    """Return the line of each point, by its object and its series' number, and where each object's lines end.

    An object has as many lines as methods that say something of it, and an empty one below.
    """
    lines: dict[tuple[str, int], int] = {}
    ends: list[int] = []
    for name in picture.objects:
        start = ends[-1] if ends else 0
        shown = [number for number, one in enumerate(picture.series) if any(p.object == name for p in one.points)]
        lines |= {(name, number): start + place for place, number in enumerate(shown)}
        ends.append(start + len(shown) + 1)
    return lines, ends


def _style(series: Series) -> dict[str, Any]:
    """Return how a method is drawn: results in colours, references in grey, the same in all pictures of a set."""
    marker = _MARKERS[(series.style + 3 * (series.style // len(SERIES))) % len(_MARKERS)]  # 63 pairs with a colour
    colour = _GREY if series.is_reference else SERIES[series.style % len(SERIES)]
    drawn = {"markersize": 5, "elinewidth": 1.2, "capsize": 0, "color": colour, "marker": marker}
    return {**drawn, "mfc": "white"} if series.is_reference else drawn


def faults_of_picture(picture: Picture, folder: Path) -> Iterator[str]:
    """Say why a picture's file does not show what it should; how a library drew it does not matter."""
    path = folder / picture.name
    if not path.is_file():
        yield f"{path}: is missing"
    elif f"shows {picture.digest}" not in path.read_text(encoding="utf-8", errors="replace"):
        yield f"{path}: shows other figures than the files give"
