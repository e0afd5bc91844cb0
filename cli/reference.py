"""`symsol-annot reference`: score methods that know the answer, half of it, or nothing."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import DECIMALS, SPLIT, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.bench.scoring.reference import ROWS, score_row
from symsol_annot.bench.scoring.reports import tables
from symsol_annot.bench.scoring.reports.scores_file import write_scores
from symsol_annot.sets import dataset
from symsol_annot.system.files import make_folder
from symsol_annot.system.scratch import Scratch, sweep, temporary_errors


@click.command(epilog=example("symsol-annot reference data/cylO data/tetX --row evenly-placed"))
@click.argument("folders", metavar="DATA...", nargs=-1, required=True, type=click.Path(path_type=Path))
@SPLIT
@click.option(
    "--row", "rows", type=click.Choice(list(ROWS)), multiple=True, help="One row; may be repeated.  [default: all]"
)
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("reference"),
    show_default=True,
    help="The folder of the scores.",
)
@DECIMALS
@click.option("--gzip", "is_packed", is_flag=True, help="Write ROW.json.gz instead of ROW.json.")
def reference(
    folders: tuple[Path, ...], split: str, rows: tuple[str, ...], out: Path, decimals: int | None, *, is_packed: bool
) -> None:
    """Score reference rows on sets, one per object: the truth, a blind method, random rotations and others.

    Writes a scores.json per row, to compare one's own with.
    """
    datasets = [dataset.load(folder, split) for folder in folders]
    make_folder(out)
    sweep()
    chosen = rows or tuple(ROWS)
    with progress_bar(len(chosen), "row") as bar:
        for name in chosen:
            bar.set_description(name)
            with temporary_errors(), Scratch() as workplace:
                document = score_row(name, datasets, workplace.path, decimals=decimals)
            write_scores(out / f"{name}.json{'.gz' if is_packed else ''}", document)
            say(f"\n{tables.tables(document, width=tables.room())}")
            bar.update()
