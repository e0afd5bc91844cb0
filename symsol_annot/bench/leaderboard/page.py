"""The leaderboard as a page of Markdown."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from symsol_annot.bench.leaderboard.entries import ImageSet, Leaderboard, Reference, Result, ThesisTable
from symsol_annot.bench.leaderboard.results import REFERENCE
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.metric import HIGHER, Place
from symsol_annot.bench.scoring.report import cell
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metric_of, metrics_shown
from symsol_annot.system.text.markdown import escaped, fenced

_HEAD = """\
# Leaderboard

<!-- Built from {folder} by `symsol-annot leaderboard`: change those files, not this one. -->

Scores come from files that `symsol-annot score` wrote, which the rows link to. The thesis's tables, and what is said
of a result and its training, are what their authors state. Brackets hold 95% intervals over images. What the figures
mean: [metrics.md](metrics.md). Two rows in detail: `symsol-annot compare`.

**How results rank.** Hypotheses by the F-measure at 5 degrees: of each image, the harmonic mean of coverage and
accuracy, with all its hypotheses counted alike. M is the number of hypotheses per image. More of them cover more of a
set, but each one that is wrong lowers the accuracy, so that nobody wins by listing everything
([metrics.md](metrics.md#what-ranks)). Classifiers rank by the F-measure (7.8), densities by the log-likelihood. Rows in
italics are references, made from the labels: they show what a perfect, a blind and an ignorant method get, and have no
rank.
"""
_TAIL = """\
## Send in a result

1. Make a set that is listed above, and write predictions: [submission.md](submission.md).
2. `symsol-annot score preds.h5 --json NAME.json`. Several objects by one method go into one file of scores.
3. Write NAME.toml, as those in [{folder}]({link}): `title`, `by`, `date`, `hardware`, `commands` or `code`, and of each
   object's training `seed` and `minutes`. `code` says where the method is; with it, `commands` may be left out.
4. Put both into the set's folder. `symsol-annot leaderboard {folder} --out {page}`
   checks all files and builds this page. Open a pull request with the three files. Keep the predictions: their SHA-256
   is in the scores.

Refused are scores that do not rank (`score` warns why), that are about other images, that lack a figure of the tables,
or whose figures do not follow from those of their images; and the same predictions twice.
"""


def to_markdown(board: Leaderboard, folder: str, link: str, page: str) -> str:
    """Return the leaderboard's page, in Markdown.

    Args:
        board: what it shows.
        folder: of the leaderboard's files, as a person would type it.
        link: from the page to it.
        page: the page's own path.
    """
    parts = [_HEAD.format(folder=folder)]
    for name, image_set in board.sets.items():
        parts += _of_set(image_set, board.results[name], board.references[name], f"{link}/{name}")
    parts += _beside_the_thesis(board)
    parts += [
        "## How the results were made",
        *_accounts(board, link),
        _TAIL.format(folder=folder, link=link, page=page),
    ]
    return "\n\n".join(part.strip("\n") for part in parts) + "\n"


def _of_set(
    image_set: ImageSet, results: Sequence[Result], references: Sequence[Reference], link: str
) -> Iterator[str]:
    """Yield a set's section: what it is, and a table for each object and track, the best first."""
    yield f"## {escaped(image_set.title)}"
    yield f"{image_set.images:,} images per object, of the {image_set.split} split. {escaped(image_set.notes)}".strip()
    yield fenced("\n".join(image_set.commands), "sh")
    if not results:
        yield "No results yet."
    for name in image_set.fingerprints:
        for track in TRACKS:
            rows = [result for result in results if track in result.scores.get(name, {})]
            beside = [row for row in references if track in row.scores.get(name, {})]
            if rows:
                yield f"### {escaped(name)}, {track}"
                yield _table([*_ranked_rows(rows, name, track, link), *_reference_rows(beside, name, track, link)])


def _ranked_rows(results: Sequence[Result], name: str, track: str, link: str) -> Iterator[Sequence[str]]:
    is_higher_better = metric_of(track, TRACKS[track].ranked_by).better == HIGHER

    def rank(result: Result) -> float:
        value = _ranked_figure(track, result.scores[name][track]["all"])["value"]
        return math.inf if value is None else -value if is_higher_better else value

    titles = [metric.title + metric.arrow for metric in metrics_shown(track, Place.LEADERBOARD)]
    yield ["", "by", *SCORINGS[track].shown_facts, *titles, "scores"]
    for result in sorted(results, key=rank):
        about = [escaped(result.account.title), escaped(result.account.by)]
        yield [*about, *_figures(track, result.scores[name][track]), _link(result.name, f"{link}/{result.name}.json")]


def _reference_rows(rows: Sequence[Reference], name: str, track: str, link: str) -> Iterator[Sequence[str]]:
    for row in rows:
        scores = _link(row.name, f"{link}/{REFERENCE}/{row.name}.json")
        yield [f"*{escaped(row.method)}*", "reference", *_figures(track, row.scores[name][track]), scores]


def _figures(track: str, scores: Mapping[str, Any]) -> list[str]:
    """Return the cells of a row: facts such as M, and the figures of all images."""
    columns, figures = metrics_shown(track, Place.LEADERBOARD), scores["all"]
    shown = {**figures, TRACKS[track].ranked_by: _ranked_figure(track, figures)}
    facts = [str(scores[fact]) for fact in SCORINGS[track].shown_facts]
    return [*facts, *(cell(shown[metric.name]) for metric in columns)]


def _ranked_figure(track: str, figures: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return what a result ranks by; of hypotheses with weights, the figure that counts them all alike."""
    found: Mapping[str, Any] = figures[TRACKS[track].ranked_by]
    return figures.get(TRACKS[track].ranked_by_if_there, found)


def _link(name: str, target: str) -> str:
    return f"[{escaped(name)}]({target})"


def _beside_the_thesis(board: Leaderboard) -> Iterator[str]:
    """Yield the thesis's tables, with what was measured here below the row it stands for."""
    yield "## Beside the thesis"
    yield board.thesis.notes.strip()
    for title, table in board.thesis.tables.items():
        runs = {recipe: _standing_for(recipe, board) for recipe in table.rows}
        yield f"### {escaped(title)}"
        yield _table(_thesis_rows(table, runs))
        absent = [f"`{recipe}`" for recipe, found in runs.items() if not found]
        yield f"Not run here: {', '.join(absent) or 'none'}."


def _standing_for(recipe: str, board: Leaderboard) -> list[tuple[str, Result]]:
    """Return the results by a recipe, or by the one of the small tier that stands for it, with their sets' folders."""
    names = {recipe, board.thesis.small.get(recipe, recipe)}
    return [
        (folder, result)
        for folder, of_set in board.results.items()
        for result in of_set
        if result.account.recipe in names
    ]


def _thesis_rows(table: ThesisTable, runs: Mapping[str, Sequence[tuple[str, Result]]]) -> Iterator[Sequence[str]]:
    yield ["", "", *(escaped(name) for name in table.objects)]
    for recipe, values in table.rows.items():
        yield [
            f"`{recipe}`",
            f"thesis{_counts_of_recipe(recipe, table)}",
            *("" if math.isnan(value) else f"{value:.3f}" for value in values),
        ]
        for folder, result in runs[recipe]:
            here = f"here, {escaped(f'{folder}/{result.name}')}{_counts(result, table)}"
            yield [f"`{result.account.recipe}`", here, *(_measured(result, o, table) for o in table.objects)]


def _counts(result: Result, table: ThesisTable) -> str:
    """Return the M of a result, or several where it differs from object to object; nothing of other tracks."""
    scores = (result.scores.get(name, {}).get(table.track, {}) for name in table.objects)
    return _counts_in_words(found["M"] for found in scores if "M" in found)


def _counts_of_recipe(recipe: str, table: ThesisTable) -> str:
    """Return the M by which the thesis has its values of a row; nothing of other tracks."""
    if "M" not in SCORINGS[table.track].shown_facts:
        return ""
    file = load_recipe(recipe)
    known = [name for name, value in zip(table.objects, table.rows[recipe], strict=True) if not math.isnan(value)]
    made = (file.for_object(name, has_marking=False) for name in known)
    return _counts_in_words(one.hypotheses for one in made if isinstance(one, HypothesisRecipe))


def _counts_in_words(counts: Iterable[int]) -> str:
    """Return one M, or all there are where it differs from object to object."""
    shown = ", ".join(str(count) for count in sorted(set(counts)))
    return f", M = {shown}" if shown else ""


def _measured(result: Result, name: str, table: ThesisTable) -> str:
    scores = result.scores.get(name, {}).get(table.track)
    value = None if scores is None else scores["all"][table.metric]["value"]
    return "" if value is None else f"**{value:.3f}**"


def _accounts(board: Leaderboard, link: str) -> Iterator[str]:
    for folder, results in board.results.items():
        for result in results:
            account = result.account
            yield f"### {escaped(f'{folder}/{result.name}')}"
            facts = [f"{escaped(account.title)}, by {escaped(account.by)}, {account.date}", escaped(account.hardware)]
            facts += [f"recipe `{account.recipe}`"] if account.recipe else []
            facts += [escaped(account.code)] if account.code else []
            facts += [escaped(account.notes).rstrip(".")] if account.notes else []
            yield f"{'. '.join(facts)}. {_link(f'{result.name}.toml', f'{link}/{folder}/{result.name}.toml')}"
            if account.commands:
                yield fenced("\n".join(account.commands), "sh")
            yield _table(_training_rows(result))


def _training_rows(result: Result) -> Iterator[Sequence[str]]:
    yield ["", "seed", "training, minutes", "of processor", "began with", "SHA-256 of the predictions"]
    for name, training in result.account.objects.items():
        used = "" if training.processor_minutes is None else f"{training.processor_minutes:.1f}"
        sha256 = result.scores[name]["predictions"]["sha256"]
        yield [
            *(escaped(name), str(training.seed), f"{training.minutes:.1f}", used, escaped(training.first_stage)),
            f"`{sha256}`",
        ]


def _table(rows: Iterable[Sequence[str]]) -> str:
    head, *body = rows
    return "\n".join(f"| {' | '.join(row)} |" for row in (head, ["---"] * len(head), *body))
