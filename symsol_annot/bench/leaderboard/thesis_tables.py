"""The thesis's tables in Markdown, with what was measured here below the row that it stands for."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from symsol_annot.bench.leaderboard.entries import Leaderboard, Result, ThesisTable
from symsol_annot.bench.leaderboard.rows import COUNT, Row, Table
from symsol_annot.bench.models.methods.hypotheses.recipe import HypothesisRecipe
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.system.text.markdown import escaped, tabled

_ABOUT_FIRST_ROWS = """\
A table's last rows have this figure of what ranks first above, object by object, whatever it was told."""


def beside_the_thesis(board: Leaderboard, tables: Mapping[str, Sequence[Table]]) -> Iterator[str]:
    """Yield the thesis's tables, with what was measured here below the row it stands for, and the first of each object.

    Args:
        board: what it shows.
        tables: the tables of each set's folder.
    """
    yield "## Beside the thesis"
    yield board.thesis.notes.strip()
    if any(table.ranked for of_set in tables.values() for table in of_set):
        yield _ABOUT_FIRST_ROWS
    for title, table in board.thesis.tables.items():
        runs = {recipe: _standing_for(recipe, board) for recipe in table.rows}
        yield f"### {escaped(title)}"
        yield tabled([*_thesis_rows(table, runs), *_first_rows(board, tables, table)])
        absent = [f"`{recipe}`" for recipe, found in runs.items() if not found]
        if absent:
            yield f"Not run here: {', '.join(absent) if len(absent) < len(runs) else 'all of these'}."


def _standing_for(recipe: str, board: Leaderboard) -> list[tuple[str, Result]]:
    """Return the results by a recipe, or by a smaller one that stands for it, with their sets' folders."""
    names = {recipe, f"reduced-{recipe}", board.thesis.small.get(recipe, recipe)}
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
            named = f": {result.name}" if result.name != result.account.recipe else ""
            here = f"here, {escaped(folder + named)}{_counts(result, table)}"
            yield [f"`{result.account.recipe}`", here, *(_measured(result, o, table) for o in table.objects)]


def _first_rows(
    board: Leaderboard, tables: Mapping[str, Sequence[Table]], of_thesis: ThesisTable
) -> Iterator[Sequence[str]]:
    """Yield, of each set, a row for each method that ranks first of some object: its figures of these in the table."""
    for folder, of_set in tables.items():
        first = {table.object: table.ranked[0] for table in of_set if table.track == of_thesis.track and table.ranked}
        shown = [name for name in of_thesis.objects if name in first]
        for method in dict.fromkeys(first[name].name for name in shown):
            cells = (
                _of_first(first[name], name, board.results[folder], of_thesis)
                if name in first and first[name].name == method
                else ""
                for name in of_thesis.objects
            )
            yield [f"<code>{escaped(method)}</code>", f"first in rank, {escaped(folder)}", *cells]


def _of_first(row: Row, name: str, results: Sequence[Result], table: ThesisTable) -> str:
    """Return a row's figure of an object, the mean over its seeds."""
    scores = (result.scores[name][table.track] for result in results if result.name in row.names)
    every = [of_seed["all"][table.metric]["value"] for of_seed in scores]
    known = [value for value in every if value is not None]
    return f"**{sum(known) / len(known):.3f}**" if known else ""


def _counts(result: Result, table: ThesisTable) -> str:
    """Return the M of a result, or several where it differs from object to object; nothing of other tracks."""
    scores = (result.scores.get(name, {}).get(table.track, {}) for name in table.objects)
    return _counts_in_words(found[COUNT] for found in scores if COUNT in found)


def _counts_of_recipe(recipe: str, table: ThesisTable) -> str:
    """Return the M by which the thesis has its values of a row; nothing of other tracks."""
    if COUNT not in SCORINGS[table.track].shown_facts:
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
