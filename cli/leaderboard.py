"""`symsol-annot leaderboard`: check results, and build the page that shows them."""

import difflib
import os
from pathlib import Path

import click
from symsol_annot_cli.parameters import DATA, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot import __version__
from symsol_annot.bench.leaderboard.entries import Leaderboard
from symsol_annot.bench.leaderboard.page import to_markdown
from symsol_annot.bench.leaderboard.picture import PICTURES, draw, faults_of_picture, pictures_of
from symsol_annot.bench.leaderboard.rescoring import rescore
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.errors import ScoresError
from symsol_annot.system.files import make_folder, write_atomically

_SHOWN_LINES = 40  # of a difference


@click.command(
    epilog=example(
        "symsol-annot leaderboard docs/results/leaderboard --out docs/leaderboard.md",
        "symsol-annot leaderboard docs/results/leaderboard --rescore preds.h5",
    )
)
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    help="The page, in Markdown; its pictures go to the folder images beside it.",
)
@click.option("--check", is_flag=True, help="Write nothing; show where the page is not what the files give, and fail.")
@click.option(
    "--rescore",
    "predictions",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Score these predictions again; show each figure that differs from their row, and fail if any does.",
)
@click.option("--row", default="", help="With --rescore: SET/NAME of the row.  [default: by the file's SHA-256]")
@DATA
def leaderboard(folder: Path, out: Path | None, predictions: Path | None, row: str, data: Path, *, check: bool) -> None:
    """Check the results in a folder, and build the leaderboard's page from them or score a row's predictions again."""
    if (out is None) == (predictions is None):
        raise click.UsageError("give either --out, which builds the page, or --rescore")
    if (check and out is None) or (row and predictions is None):
        raise click.UsageError("--check goes with --out, --row with --rescore")
    board = read_leaderboard(folder)
    if predictions is not None:
        _rescore(board, predictions, data, row)
    elif out is not None:
        _build(board, folder, out, check=check)


def _build(board: Leaderboard, folder: Path, out: Path, *, check: bool) -> None:
    """Write the page and its pictures, or compare what is there with them."""
    link = Path(os.path.relpath(folder, out.parent)).as_posix()
    page = to_markdown(board, folder.as_posix(), link, out.as_posix())
    pictures, place = pictures_of(board), out.parent / PICTURES
    if check:
        _refuse_differences(folder, out, page, [f for picture in pictures for f in faults_of_picture(picture, place)])
    else:
        if pictures:
            make_folder(place)
        for picture in pictures:
            draw(picture, place)
        write_atomically(out, page.encode())
    count = sum(len(results) for results in board.results.values())
    say(f"{out}: {_many(count, 'result')} on {_many(len(board.sets), 'set')}")


def _many(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"


def _refuse_differences(folder: Path, out: Path, page: str, of_pictures: list[str]) -> None:
    """Raise a ScoresError with what has to change where the page or a picture is not what the files give."""
    there = out.read_bytes().decode(errors="replace") if out.is_file() else ""
    names = {"fromfile": f"{out}, as it is", "tofile": f"{out}, as {folder} gives it"}
    lines = list(difflib.unified_diff(there.splitlines(), page.splitlines(), **names, lineterm="", n=1))
    lines = [*_first(lines), *_first(of_pictures)]
    if there != page or of_pictures:
        shown = "\n".join(lines)
        raise ScoresError(f"{out}: is not what {folder} gives; the same command without --check builds it:\n{shown}")


def _first(lines: list[str]) -> list[str]:
    """Return the first lines, and how many more there are."""
    more = len(lines) - _SHOWN_LINES
    return [*lines[:_SHOWN_LINES], f"... {more} lines more"] if more > 0 else lines


def _rescore(board: Leaderboard, predictions: Path, data: Path, row: str) -> None:
    """Say whether predictions give the figures of their row, and which not."""
    with progress_bar(None, "row") as bar:
        found = rescore(board, predictions, data, row, bar.update)
    if found.diff:
        head = [f"--- {found.file}, {found.object}", f"+++ {predictions}, scored by symsol-annot {__version__}"]
        count = sum(line.startswith("+") for line in found.diff)
        lines = "\n".join([*head, *_first(list(found.diff))])
        raise ScoresError(f"{predictions}: {count} of {found.figures} figures differ from {found.row}:\n{lines}")
    other = "" if found.is_same_file else ", though it is another file (another SHA-256)"
    say(f"{predictions}: equal to {found.row} in all {found.figures} figures of {found.object}{other}")
