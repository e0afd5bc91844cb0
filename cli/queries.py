"""`symsol-annot queries`: write the rotations at which a classifier is asked."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import SET_FOLDER, SPLIT, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.bench.predictions.writing.query_file import write_queries
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets import dataset
from symsol_annot.system.files import make_folder


@click.command(epilog=example("symsol-annot queries data/cylO --out queries.h5"))
@SET_FOLDER
@SPLIT
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("queries.h5"),
    show_default=True,
    help="The file of the queries.",
)
@click.option(
    "--level", type=click.IntRange(0, 5), default=STANDARD_LEVEL, show_default=True, help="Level of the grid."
)
def queries(folder: Path, split: str, out: Path, level: int) -> None:
    """Write the rotations at which a classifier is asked about each image, and the grid, for other languages."""
    make_folder(out.parent)
    with dataset.load(folder, split) as about, progress_bar(len(about), "image") as bar:
        write_queries(out, about, level, bar.update)
    say(out)
