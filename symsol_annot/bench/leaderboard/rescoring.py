"""A row's predictions scored again: each figure that differs from the row's file."""

import json
import os
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from symsol_annot.bench.leaderboard.entries import Leaderboard, Reference, Result
from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.reports.scores_file import is_same_figure, rounding_of
from symsol_annot.bench.scoring.scoring import ObjectScores, score
from symsol_annot.errors import ScoresError, first_of

_SHOWN_ROWS = 10
_OF_THE_FILE = "predictions"  # its name and its SHA-256, by which the row was found
_OF_IMAGES = "per_image"
_NO_FIGURES = (_OF_THE_FILE, f"{_OF_IMAGES}.{report.DECIMALS}")
_ABSENT = "nothing"


@dataclass(frozen=True)
class Rescored:
    """What came of scoring a row's predictions again.

    Attributes:
        row: SET/NAME of the row.
        file: SET/FILE of its scores.
        object: the predictions are about.
        is_same_file: whether they are those that the row was scored from, by their SHA-256.
        figures: how many figures were compared.
        diff: lines of the figures that differ, the row's with "-" and the new ones with "+".
    """

    row: str
    file: str
    object: str
    is_same_file: bool
    figures: int
    diff: tuple[str, ...]


def rescore(
    board: Leaderboard,
    predictions: str | os.PathLike[str],
    data: str | os.PathLike[str],
    row: str = "",
    on_rows: Callable[[int], object] | None = None,
) -> Rescored:
    """Score a predictions file again, and compare all figures with those of its row.

    Args:
        board: which has the row.
        predictions: the file.
        data: a set, or the folder of the sets.
        row: SET/NAME of the row; the one of the file's SHA-256 where empty.
        on_rows: is told how many rows of the file were scored since the last call.

    Raises:
        ScoresError: there is no such row, or it says nothing of the object.
        PredictionsError: the file is broken, or about another set.
    """
    with open_predictions(predictions, data) as opened:
        scores = score(opened, on_rows or (lambda _: None))
    name = scores.truth.object
    there = {path: of_path for path, of_path in _rows(board) if name in of_path.scores}
    rows = {path: of_path.scores[name] for path, of_path in there.items()}
    if row and row not in rows:
        raise ScoresError(f"--row {shown(row)}: there is no such row about {name}; {_there(rows)}")
    found = [path for path, of_row in rows.items() if of_row[_OF_THE_FILE]["sha256"] == scores.sha256]
    if not row and not found:
        raise ScoresError(
            f"{predictions}: no row is of these predictions (about {name}, SHA-256 {scores.sha256}); "
            f"--row compares with one all the same; {_there(rows)}"
        )
    chosen = row or found[0]
    old, new = (dict(_flat(side)) for side in (rows[chosen], _entry_of(scores)))
    rounding = rounding_of(rows[chosen])
    diff = tuple(line for where in dict.fromkeys([*old, *new]) for line in _differences(where, old, new, rounding))
    file = f"{chosen.partition('/')[0]}/{there[chosen].scores_file}"
    return Rescored(chosen, file, name, chosen in found, len(new), diff)


def _entry_of(scores: ObjectScores) -> dict[str, Any]:
    """Return what scores.json would say of an object."""
    document: dict[str, Any] = json.loads(report.to_json(report.to_document([scores])))
    entry: dict[str, Any] = document["objects"][scores.truth.object]
    return entry


def _rows(board: Leaderboard) -> Iterator[tuple[str, Result | Reference]]:
    """Yield SET/NAME of each row and the row, results before references."""
    for folder, results in board.results.items():
        yield from ((f"{folder}/{result.name}", result) for result in results)
    for folder, references in board.references.items():
        yield from ((f"{folder}/{reference.name}", reference) for reference in references)


def _there(rows: Mapping[str, Any]) -> str:
    return f"there are {first_of(list(rows), _SHOWN_ROWS)}" if rows else "there are none about that object"


def _flat(entry: Any, where: str = "") -> Iterator[tuple[str, Any]]:
    """Yield each value of an object's scores by its path; a list, such as the figures of the images, is one value."""
    if not isinstance(entry, dict):
        yield where, entry
        return
    for key, value in entry.items():
        if (path := f"{where}.{key}" if where else key) not in _NO_FIGURES:
            yield from _flat(value, path)


def _differences(
    where: str, old: Mapping[str, Any], new: Mapping[str, Any], rounding_of_images: float = 0.0
) -> Iterator[str]:
    """Yield two lines if a value differs; by how much those of images were rounded is no difference."""
    rounding = rounding_of_images if where.startswith(_OF_IMAGES) else 0.0
    if where in old and where in new and _is_same(old[where], new[where], rounding):
        return
    before, after = ([side[where]] if where in side else [] for side in (old, new))
    if before and after and all(isinstance(value, list) for value in (*before, *after)):
        yield from _differences_of_lists(where, before[0], after[0], rounding)
        return
    for sign, found in (("-", before), ("+", after)):
        yield f"{sign}{where}: {shown(found[0]) if found else _ABSENT}"


def _differences_of_lists(where: str, old: list[Any], new: list[Any], rounding: float) -> Iterator[str]:
    """Yield the first place at which two lists differ, and at how many they do."""
    if len(old) != len(new):
        yield f"-{where}: {len(old)} values"
        yield f"+{where}: {len(new)} values"
        return
    places = [i for i, pair in enumerate(zip(old, new, strict=True)) if not _is_same(*pair, rounding)]
    yield f"-{where}[{places[0]}]: {shown(old[places[0]])}"
    yield f"+{where}[{places[0]}]: {shown(new[places[0]])}  ({len(places)} of {len(old)} differ)"


def _is_same(old: Any, new: Any, rounding: float) -> bool:
    if isinstance(old, list) and isinstance(new, list):
        return len(old) == len(new) and all(_is_same(*pair, rounding) for pair in zip(old, new, strict=True))
    if any(isinstance(value, bool) for value in (old, new)):
        return old is new
    if all(value is None or isinstance(value, int | float) for value in (old, new)):
        return is_same_figure(old, new, rounding)
    return bool(old == new)
