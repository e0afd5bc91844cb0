"""`symsol-annot gallery`: a folder of pages to look at sets and predictions in a browser."""

from functools import partial
from pathlib import Path

import click
from symsol_annot_cli.parameters import SET_FOLDER, SHOWN_PREDICTIONS, SHOWN_SPLITS, ObjectType, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.system.machine import check_extra


@click.command(
    epilog=example("symsol-annot gallery data", "symsol-annot gallery data/cylO --predictions preds.h5 --out gallery")
)
@SET_FOLDER
@SHOWN_PREDICTIONS
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default=Path("gallery"),
    show_default=True,
    help="The folder of the pages.",
)
@SHOWN_SPLITS
@click.option(
    "--limit", metavar="N", type=click.IntRange(min=1), help="Only the first N images of a split.  [default: all]"
)
@click.option(
    "--redrawn",
    metavar="N",
    type=click.IntRange(min=0),
    default=24,
    show_default=True,
    help="Draw candidates of N images per split again (needs Blender).",
)
@click.option(
    "--object", "spec", type=ObjectType(), help="The object to draw, where the set's object is a folder of your own."
)
def gallery(
    folder: Path,
    paths: tuple[Path, ...],
    out: Path,
    splits: tuple[str, ...],
    limit: int | None,
    redrawn: int,
    spec: ObjectSpec | None,
) -> None:
    """Write a page that shows images, their symmetry sets, and predictions over them.

    DATA is a set like data/cylO, or a folder of sets like data. Open index.html of the folder in a browser; it needs
    no network.
    """
    check_extra("gallery", "the gallery")
    sources = open_sources(folder, splits, limit)
    with progress_bar(None, "row") as bar:
        runs = read_runs(paths, folder, sources, bar.update)
    images = sum(len(source.dataset) for source in sources)
    with progress_bar(images, "image") as bar:
        write_gallery(out, sources, runs, partial(Redrawer, count=redrawn, given=spec), bar.update)
    say(f"{out / 'index.html'}: {images} images" + (f", {len(runs)} runs" if runs else ""))
