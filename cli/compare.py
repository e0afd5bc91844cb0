"""`symsol-annot compare`: put methods side by side."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import say

from symsol_annot.bench.scoring.reports import comparison


@click.command(epilog=example("symsol-annot compare ours.json reference/truth.json"))
@click.argument("paths", metavar="SCORES.JSON...", nargs=-1, required=True, type=click.Path(path_type=Path))
def compare(paths: tuple[Path, ...]) -> None:
    """Put the scores of several methods side by side, with paired bootstrap differences from the first."""
    if len(paths) < 2:
        raise click.UsageError("compare takes two scores files or more; `score --json` writes them")
    say(comparison.compare(paths))
