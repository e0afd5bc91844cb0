"""The leaderboard as a page of Markdown."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from symsol_annot.bench.leaderboard import ImageSet, Leaderboard, Result, ThesisTable
from symsol_annot.bench.metric_table import HIGHER, METRICS, RANKED_BY, Place, metric_of, metrics_shown
from symsol_annot.bench.report import cell

_ESCAPED = str.maketrans({character: f"\\{character}" for character in "\\`*_{}[]<>|#"})

_HEAD = """\
# Leaderboard

<!-- Built from {folder} by `symsol-annot leaderboard`: change those files, not this one. -->

Scores come from files that `symsol-annot score` wrote, which the rows link to; the thesis's tables, and what is said
of a result and its training, are as somebody wrote them down. Brackets hold 95% intervals over images. What the figures
mean: [metrics.md](metrics.md). Two rows in detail: `symsol-annot compare`.
"""
_TAIL = """\
## Send in a result

1. Make a set that is listed above, and write predictions: [submission.md](submission.md).
2. `symsol-annot score preds.h5 --json NAME.json`. Several objects by one method go into one file of scores.
3. Write NAME.toml, as those in [{folder}]({link}): `title`, `by`, `date`, `hardware`, `commands` or `code`, and of each
   object's training `seed` and `minutes`.
4. Put both into the set's folder. `symsol-annot leaderboard {folder} --out {page}`
   checks all files and builds this page. Open a pull request with the three files. Keep the predictions: their SHA-256
   is in the scores.

Refused are scores that do not rank (`score` warns why), that are about other images, that lack a figure of the tables,
or whose figures do not follow from those of their images; and the same predictions twice.
"""


def to_markdown(board: Leaderboard, folder: str, link: str, page: str) -> str:
    """Return the page.

    Args:
        board: what it shows.
        folder: of the leaderboard's files, as a person would type it.
        link: from the page to it.
        page: the page's own path.
    """
    parts = [_HEAD.format(folder=folder)]
    for name, image_set in board.sets.items():
        parts += _of_set(image_set, board.results[name], f"{link}/{name}")
    parts += _beside_the_thesis(board)
    parts += ["## How the results were made", *_runs(board, link), _TAIL.format(folder=folder, link=link, page=page)]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _of_set(image_set: ImageSet, results: Sequence[Result], link: str) -> Iterator[str]:
    """Yield a set's section: what it is, and a table for each object and track, the best first."""
    yield f"## {_text(image_set.title)}"
    yield f"{image_set.images:,} images an object, of the {image_set.split} split. {_text(image_set.notes)}".strip()
    yield _commands(image_set.commands)
    if not results:
        yield "No results yet."
    for name in image_set.fingerprints:
        for track in METRICS:
            rows = [result for result in results if track in result.scores.get(name, {})]
            if rows:
                yield f"### {name}, {track}"
                yield _table(_ranked_rows(rows, name, track, link))


def _ranked_rows(results: Sequence[Result], name: str, track: str, link: str) -> Iterator[Sequence[str]]:
    columns, by = metrics_shown(track, Place.LEADERBOARD), metric_of(track, RANKED_BY[track])
    yield ["", "by", *(metric.title + metric.arrow for metric in columns), "scores"]

    def rank(result: Result) -> float:
        value = result.scores[name][track]["all"][by.name]["value"]
        return math.inf if value is None else -value if by.better == HIGHER else value

    for result in sorted(results, key=rank):
        figures = result.scores[name][track]["all"]
        cells = [cell(figures[metric.name]) for metric in columns]
        yield [_text(result.run.title), _text(result.run.by), *cells, f"[{result.name}]({link}/{result.name}.json)"]


def _beside_the_thesis(board: Leaderboard) -> Iterator[str]:
    """Yield the thesis's tables, with what was measured here below the row it stands for."""
    yield "## Beside the thesis"
    yield board.thesis.notes.strip()
    for title, table in board.thesis.tables.items():
        runs = {recipe: _standing_for(recipe, board) for recipe in table.rows}
        yield f"### {_text(title)}"
        yield _table(_thesis_rows(table, runs))
        absent = [f"`{recipe}`" for recipe, found in runs.items() if not found]
        yield f"Not run here: {', '.join(absent) or 'none'}."


def _standing_for(recipe: str, board: Leaderboard) -> list[tuple[str, Result]]:
    """Return the results by a recipe, or by the one of the small tier that stands for it, with their sets' folders."""
    names = {recipe, board.thesis.small.get(recipe, recipe)}
    return [
        (folder, result) for folder, of_set in board.results.items() for result in of_set if result.run.recipe in names
    ]


def _thesis_rows(table: ThesisTable, runs: Mapping[str, Sequence[tuple[str, Result]]]) -> Iterator[Sequence[str]]:
    yield ["", "", *table.objects]
    for recipe, values in table.rows.items():
        yield [f"`{recipe}`", "thesis", *("" if math.isnan(value) else f"{value:.3f}" for value in values)]
        for folder, result in runs[recipe]:
            here = f"here, {folder}/{result.name}"
            yield [f"`{result.run.recipe}`", here, *(_measured(result, o, table) for o in table.objects)]


def _measured(result: Result, name: str, table: ThesisTable) -> str:
    scores = result.scores.get(name, {}).get(table.track)
    value = None if scores is None else scores["all"][table.metric]["value"]
    return "" if value is None else f"**{value:.3f}**"


def _runs(board: Leaderboard, link: str) -> Iterator[str]:
    for folder, results in board.results.items():
        for result in results:
            run = result.run
            yield f"### {folder}/{result.name}"
            facts = [f"{_text(run.title)}, by {_text(run.by)}, {run.date}", _text(run.hardware)]
            facts += [f"recipe `{run.recipe}`"] if run.recipe else []
            facts += [_text(run.code)] if run.code else []
            facts += [_text(run.notes).rstrip(".")] if run.notes else []
            yield f"{'. '.join(facts)}. [{result.name}.toml]({link}/{folder}/{result.name}.toml)"
            if run.commands:
                yield _commands(run.commands)
            yield _table(_training_rows(result))


def _training_rows(result: Result) -> Iterator[Sequence[str]]:
    yield ["", "seed", "training, minutes", "of processor", "began with", "SHA-256 of the predictions"]
    for name, training in result.run.objects.items():
        used = "" if training.processor_minutes is None else f"{training.processor_minutes:.1f}"
        sha256 = result.scores[name]["predictions"]["sha256"]
        yield [
            *(name, str(training.seed), f"{training.minutes:.1f}", used, _text(training.first_stage)),
            f"`{sha256}`",
        ]


def _table(rows: Iterable[Sequence[str]]) -> str:
    head, *body = rows
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body))


def _commands(commands: Sequence[str]) -> str:
    lines = "\n".join(commands).replace("`", "'")
    return f"```sh\n{lines}\n```"


def _text(words: Any) -> str:
    """Return a stranger's words on one line, so that they are text and nothing else in Markdown."""
    line = " ".join(str(words).split())
    return "".join(character for character in line if character.isprintable()).translate(_ESCAPED)
