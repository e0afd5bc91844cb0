"""`symsol-annot import-bop`: images with known poses of a BOP dataset as a set of this package."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import SIZE, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.bop.importing import LEAST_VISIBLE, Choice, ImportedObject
from symsol_annot.bop.importing import import_bop as imported
from symsol_annot.bop.reading.json_files import MAX_ID
from symsol_annot.sets.manifest import Manifest
from symsol_annot.system.machine import cores


@click.command(
    "import-bop",
    epilog=example(
        "symsol-annot import-bop tless --id 5 --out bop",
        "symsol-annot import-bop ycbv --id 13 --split train_pbr --name bowl --out bop",
    ),
)
@click.argument("path", metavar="BOP_FOLDER", type=click.Path(path_type=Path))
@click.option("--id", "obj_id", type=click.IntRange(0, MAX_ID), required=True, help="Id of the object in the dataset.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="The folder of the sets.")
@click.option(
    "--name", default="", help="Name of the object and of its set's folder.  [default: obj_000005 for the id 5]"
)
@click.option(
    "--split",
    default="test",
    show_default=True,
    help="Folder of the scenes: train, val or test, or one like train_pbr. A folder of val becomes a test split.",
)
@SIZE
@click.option(
    "--least-visible",
    type=click.FloatRange(0.0, 1.0),
    default=LEAST_VISIBLE,
    show_default=True,
    help="The least visible part (visib_fract) of an instance that is imported.",
)
@click.option("--diameter-mm", type=float, help="Diameter of the object, where the folder models does not say it.")
@click.option("--workers", type=click.IntRange(min=1), help="Number of threads.  [default: all cores]")
def import_bop(
    path: Path,
    obj_id: int,
    out: Path,
    name: str,
    split: str,
    size: int,
    least_visible: float,
    diameter_mm: float | None,
    workers: int | None,
) -> None:
    """Import the images that show an object of a BOP dataset, with its poses and symmetries.

    Each instance that is visible enough becomes an image of the set OUT/NAME: the camera is turned about its own centre
    to look at the object's, and its rotation with it. The sets are those of models_info.json, the same for every image,
    whatever it hides. Re-running the command leaves a complete set as it is.
    """
    choice = Choice(obj_id, split, name, size, least_visible, diameter_mm)
    with progress_bar(None, "image") as bar:

        def begin(manifest: Manifest) -> None:
            bar.reset(total=sum(entry.images for entry in manifest.shards))

        made = imported(path, out, choice, workers=workers or cores(), on_begin=begin, on_images=bar.update)
    say(_line(made))


def _line(made: ImportedObject) -> str:
    hidden = f", {made.hidden} too hidden ones left out" if made.hidden else ""
    rotations = "1 rotation" if made.members == 1 else f"{made.members} rotations"
    what = f"{made.folder}: {made.manifest.images(made.split)} {made.split} images{hidden}, sets of {rotations}"
    return f"{what}; " + ("was there already" if made.was_there else f"poses off SO(3) by at most {made.off_so3:.1e}")
