"""The leaderboard as a page of Markdown."""

import math
import re
from collections.abc import Iterator, Sequence
from typing import Any

from symsol_annot.bench.leaderboard.accounts import accounts
from symsol_annot.bench.leaderboard.agreement import Agreement, agreements
from symsol_annot.bench.leaderboard.entries import Leaderboard
from symsol_annot.bench.leaderboard.picture import PICTURES, picture_name
from symsol_annot.bench.leaderboard.results import REFERENCE
from symsol_annot.bench.leaderboard.rows import COUNT, Mark, Row, Table, tables_of
from symsol_annot.bench.leaderboard.thesis_tables import beside_the_thesis
from symsol_annot.bench.scoring.metric import LEAST_DECIMALS, Metric
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of
from symsol_annot.system.text.markdown import escaped, fenced, linked, tabled

_HEAD = """\
# Leaderboard

<!-- Built from {folder} by `symsol-annot leaderboard`: change those files, not this one. -->

**What ranks**, separately for each track and object:

- *Hypotheses* rank by the F-measure at 5 degrees. For each image it is the harmonic mean of coverage (recall) and
  accuracy (precision), with all its hypotheses counted alike. M is their number per image. Listing everything does not
  help, since each wrong hypothesis lowers the accuracy of its image ([metrics.md](metrics.md#what-ranks)).
- *Classifiers* rank by the F-measure (7.8). Read the hard negative rate beside it, which is 1 for a method that is
  blind to the marking.
- *Densities* rank by the log-likelihood. Its ceiling is that of the best density on the grid.

The best row is first and bold, with its 95% interval over images. References are in italics and have no rank.
[How to read a row](#how-to-read-a-row), [send in a result](#send-in-a-result).
"""
_HOW_TO_READ = """\
## How to read a row

The best figure of the column that ranks is bold. Other columns have no best figure: coverage alone would be won by
listing everything. M is the number of hypotheses per image, of lists of several lengths that of the longest; "px" is
the side of the image that the network reads. Brackets hold 95% bootstrap intervals over images; they do not cover the
variation between trainings. A method that was trained with several seeds is one row: the mean, its interval over
images, and the range of the seeds.

- {may_be_best} *may be the best.* With 95% confidence, the truly best of a table's ranked rows is among those with this
  sign. All are compared with each other at once, paired by image, so that many rows make no winner by chance
  ([metrics.md](metrics.md#which-rows-may-be-the-best)).
- {many} *many hypotheses.* The row has more hypotheses per image than the thesis, which has 30 (75 for the
  icosahedron). Coverage is easy to get that way: compare with the row of the body's group.
- {exact} *as exact as the labels.* The row is closer to the labels, in recall or in precision, than pixels can tell
  ([metrics.md](metrics.md#what-ranks)). Such a row has no rank.
- *told group, sets.* The method knew the body's symmetry group, or learnt from symmetry sets instead of one rotation
  per image.
- *Rows in italics* are references, made from the labels: the truth, the best that 30 hypotheses can do, one true
  rotation, a method that is blind to the marking, and chance. They have no rank.

Scores come from files that `symsol-annot score` wrote, to which [each result](#how-the-results-were-made) links. What
is said about a result and its training is what its authors state. `symsol-annot compare` compares two rows in detail.
"""
_TAIL = """\
## Send in a result

1. Make a set that is listed above, and write predictions: [submission.md](submission.md).
2. `symsol-annot score preds.h5 --json NAME.json.gz --decimals {decimals}`. Several objects by one method go into one
   file of scores. An unpacked NAME.json with all digits is accepted, too, but it is larger.
3. Write NAME.toml, as below: `commands`, `code`, or both.
4. Put both into the set's folder in [{folder}]({link}). Then run `symsol-annot leaderboard {folder} --out {page}`,
   which checks all files, builds this page and draws its pictures. Send the changed files as a pull request.
5. Keep the predictions: their SHA-256 is in the scores. `symsol-annot leaderboard {folder} --rescore preds.h5`
   scores them again and shows each figure that differs from the row.

```toml
title = "What the row is called"
by = "who sends it in"
date = 2026-01-31
hardware = "1 GPU of this kind"
code = "https://example.org/code"  # where the method is, or is described
commands = ["./train.sh cylO", "./predict.sh cylO"]  # from the set to the scores
input_px = 224  # optional: the side of the image that the network reads
given_group = false  # optional: was it told the body's symmetry group?
given_sets = false  # optional: did it learn from symmetry sets, or from rejected candidates?
method = "mine"  # optional: results that share it differ in their seed alone, and are one row
notes = "more in words"  # optional

[objects.cylO]  # one table per object
seed = 0
minutes = 95  # of training
predict_minutes = 4  # optional
predictions_sha256 = ""  # optional; as in the scores
```

A result is refused if its scores do not rank (`score` warns why), are about other images, or lack a figure of the
tables; if its figures do not follow from those of its images; if the same predictions are there already; and if it
states neither `code` nor `commands`.
"""
_ABOUT_AGREEMENT = """\
Papers order methods by the log-likelihood at R_gt, the one rotation that an image was drawn at. The table has
Kendall's tau between that order and the order by each figure of the whole set: it is 1 if no two methods change places,
and -1 if all do. Brackets hold its 95% interval over images. Below the table are the pairs that change places, in both
orders by more than chance, and the images that contribute most to it."""
_NONE = "-"
_LEGEND = {
    Mark.MANY: "{sign} More than {usual} hypotheses per image.",
    Mark.EXACT: "{sign} As exact as the labels: no rank.",
    Mark.MAY_BE_BEST: "{sign} With 95% confidence the best of these {count} is among the {marked} with this sign.",
}


def to_markdown(board: Leaderboard, folder: str, link: str, page: str) -> str:
    """Return the leaderboard's page, in Markdown.

    Args:
        board: what it shows.
        folder: of the leaderboard's files, as a person would type it.
        link: from the page to it.
        page: the page's own path.
    """
    signs = {mark.name.lower(): mark.value for mark in Mark}
    tables = {name: tables_of(board, name) for name in board.sets}
    parts = [_HEAD.format(folder=folder)]
    for name in board.sets:
        parts += _of_set(board, name, tables[name], link)
    parts += [_HOW_TO_READ.format(**signs), *beside_the_thesis(board, tables)]
    parts += [
        "## How the results were made",
        *accounts(board, link),
        _TAIL.format(folder=folder, link=link, page=page, decimals=LEAST_DECIMALS),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _of_set(board: Leaderboard, folder: str, tables: Sequence[Table], link: str) -> Iterator[str]:
    """Yield a set's section: what it is, and of each track a picture and a table for each object, the best first."""
    image_set = board.sets[folder]
    yield f"## {escaped(image_set.title)}"
    yield f"{image_set.images:,} images per object, of the {image_set.split} split. {escaped(image_set.notes)}".strip()
    yield fenced("\n".join(image_set.commands), "sh")
    if not board.results[folder]:
        yield "Nobody has sent in a result on this set yet; the rows are references."
    for track in dict.fromkeys(table.track for table in tables):
        alike = [table for table in tables if table.track == track]
        if any(table.has_results for table in alike):
            metric = alike[0].metrics[0]
            yield f"### {escaped(folder)}, {track}"
            yield f"![{metric.words} of each method by object]({PICTURES}/{picture_name(folder, track)})"
        for table in alike:
            yield f"### {escaped(table.object)}, {track}"
            yield tabled(_rows(table, folder, f"{link}/{folder}"))
            if legend := " ".join(_legend(table)):
                yield legend
    yield from _of_agreement(board, folder)


def _of_agreement(board: Leaderboard, folder: str) -> Iterator[str]:
    """Yield whether methods come in the same order by one rotation and by the whole set; nothing of too few."""
    found = list(agreements(board, folder))
    if not found:
        return
    yield f"### {escaped(folder)}, one rotation or the whole set"
    yield _ABOUT_AGREEMENT
    yield tabled(_agreement_rows(found))
    for one in found:
        for inversion in one.inversions:
            images, words = ", ".join(map(str, inversion.images)), metric_of(one.track, one.metric).words
            yield (
                f"- {escaped(one.object)}: *{escaped(inversion.first)}* is ahead of *{escaped(inversion.second)}* at "
                f"R_gt, and behind it by {words} of {one.track}; most in images {images}"
            )


def _agreement_rows(found: Sequence[Agreement]) -> Iterator[Sequence[str]]:
    columns = list(dict.fromkeys((one.track, one.metric) for one in found))
    yield ["", *(f"{metric_of(track, metric).words}, {track}" for track, metric in columns)]
    for name in dict.fromkeys(one.object for one in found):
        cells = {(one.track, one.metric): one for one in found if one.object == name}
        yield [escaped(name), *(_tau(cells[column]) if column in cells else _NONE for column in columns)]


def _tau(one: Agreement) -> str:
    return f"{one.tau:.2f}<br>[{one.low:.2f}, {one.high:.2f}]<br>{one.methods} methods"


def _rows(table: Table, folder: str, link: str) -> Iterator[Sequence[str]]:
    """Yield the head of a table and its rows; a column of which nothing is known is left out."""
    facts = list(SCORINGS[table.track].shown_facts)
    known = [m for m in table.metrics if any(not math.isnan(row.figures[m.name].value) for row in table.rows)]
    size = ["px"] if table.has_results else []
    yield [
        "",
        *facts,
        *size,
        *((metric.title + metric.arrow).replace(" ↑", "&nbsp;↑").replace(" ↓", "&nbsp;↓") for metric in known),
    ]
    for row in table.rows:
        cells = [
            *(_fact(row, fact) for fact in facts),
            *("" if row.is_reference else str(row.input_px or _NONE) for _ in size),
            *(_figure(table, row, metric) for metric in known),
        ]
        if row.is_reference:
            about = linked(row.title, f"{link}/{REFERENCE}/{row.files[0]}")
            yield [f"*{cell}*" if cell else "" for cell in (about, *cells)]
        else:
            yield [_about(row, folder), *cells]


def _about(row: Row, folder: str) -> str:
    """Return the first cell of a result: its place, its title, who sent it in, its seeds, what it was told."""
    place = f"{row.place}. " if row.place is not None else f"{Mark.EXACT.value} "
    first, *others = (_anchor(f"{folder}/{name}") for name in row.names)
    lines = [f"{place}{linked(row.title, first)}", escaped(row.by)]
    if others:
        links = ", ".join(linked(str(number), anchor) for number, anchor in enumerate((first, *others), 1))
        lines.append(f"{len(row.names)} seeds: {links}")
    if row.told:
        lines.append(f"told {', '.join(row.told)}")
    return "<br>".join(lines)


def _fact(row: Row, fact: str) -> str:
    is_many = fact == COUNT and Mark.MANY in row.marks
    return f"{row.facts[fact]}&nbsp;{Mark.MANY.value}" if is_many else str(row.facts[fact])


def _figure(table: Table, row: Row, metric: Metric[Any]) -> str:
    """Return a figure; what ranks is bold in the first place, and has its interval and the range of the seeds below."""
    figure = row.figures[metric.name]
    if math.isnan(figure.value):
        return _NONE
    value = f"{figure.value:.3f}"
    if metric is not table.metrics[0]:
        return value
    value = f"**{value}**" if row.place == 1 else value
    lines = [f"{value}&nbsp;{Mark.MAY_BE_BEST.value}" if Mark.MAY_BE_BEST in row.marks else value]
    if not math.isnan(figure.low):
        lines.append(f"[{figure.low:.3f},&nbsp;{figure.high:.3f}]")
    if row.seed_range is not None:
        lines.append(f"seeds {row.seed_range[0]:.3f} to&nbsp;{row.seed_range[1]:.3f}")
    return "<br>".join(lines)


def _legend(table: Table) -> Iterator[str]:
    """Yield what the signs in a table mean."""
    count, marked = len(table.ranked), sum(Mark.MAY_BE_BEST in row.marks for row in table.rows)
    for mark in (mark for mark in Mark if mark in table.marks):
        yield _LEGEND[mark].format(sign=mark.value, usual=table.usual_count, count=count, marked=marked)
    if table.is_tested and not marked:
        yield f"With 95% confidence the first is the best of these {count}."


def _anchor(heading: str) -> str:
    """Return the link to a heading on this page, as code host and site make it."""
    return "#" + re.sub(r"[^a-z0-9_-]", "", heading.lower())
