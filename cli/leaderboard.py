"""`symsol-annot leaderboard`: check results, and build the page that shows them."""

import os
from pathlib import Path

import click
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import say

from symsol_annot.bench.leaderboard.page import to_markdown
from symsol_annot.bench.leaderboard.results import read_leaderboard
from symsol_annot.errors import ScoresError
from symsol_annot.system.files import write_atomically


@click.command(epilog=example("symsol-annot leaderboard docs/results/leaderboard --out docs/leaderboard.md"))
@click.argument("folder", type=click.Path(path_type=Path, file_okay=False))
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The page, in Markdown.")
@click.option("--check", is_flag=True, help="Write nothing, and fail where the page is not what the files give.")
def leaderboard(folder: Path, out: Path, *, check: bool) -> None:
    """Check the results in a folder and build the leaderboard's page from them."""
    board = read_leaderboard(folder)
    link = Path(os.path.relpath(folder, out.parent)).as_posix()
    page = to_markdown(board, folder.as_posix(), link, out.as_posix()).encode()
    if not check:
        write_atomically(out, page)
    elif not out.is_file() or out.read_bytes() != page:
        raise ScoresError(f"{out}: is not what {folder} gives; the same command without --check builds it")
    count = sum(len(results) for results in board.results.values())
    say(f"{out}: {count} results on {len(board.sets)} sets")
