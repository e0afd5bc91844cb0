"""`symsol-annot export-bop`: sets as a BOP dataset."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import SPLIT, ObjectType, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.bop.export import DEFAULT_RADIUS_MM, Symmetries, objects_in
from symsol_annot.bop.export import export_bop as exported
from symsol_annot.objects.spec import ObjectSpec


@click.command("export-bop", epilog=example("symsol-annot export-bop data/cylO --out bop/cylO --count 100"))
@click.argument("folders", metavar="SET...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    required=True,
    help="Folder of the BOP dataset, missing or empty.",
)
@SPLIT
@click.option(
    "--count", type=click.IntRange(min=1), help="Number of images per set, from the first on.  [default: all]"
)
@click.option(
    "--radius-mm",
    type=float,
    default=DEFAULT_RADIUS_MM,
    show_default=True,
    help="Radius of the bounding sphere of each object, in millimetres.",
)
@click.option(
    "--symmetries",
    type=click.Choice(["object", "body"]),
    default="object",
    show_default=True,
    help="Symmetries that models_info.json lists: those of the object with its marking, or of the body without it.",
)
@click.option(
    "--object",
    "given",
    type=ObjectType(),
    multiple=True,
    help="Folder of an object that is not built in; may be given several times.",
)
def export_bop(
    folders: tuple[Path, ...],
    out: Path,
    split: str,
    count: int | None,
    radius_mm: float,
    symmetries: Symmetries,
    given: tuple[ObjectSpec, ...],
) -> None:
    """Write sets in the format of BOP, the benchmark of object poses, for the scripts of bop_toolkit.

    Each SET, like data/cylO, becomes one object; the first has the id 1. Images, masks, depth where the set has it,
    poses in millimetres, models with their symmetries, and the symmetry set of each image are written.
    """
    objects = objects_in(folders, split, count, {spec.name: spec for spec in given})
    images = sum(len(one.dataset) for one in objects)
    with progress_bar(images, "image") as bar:
        exported(objects, out, radius_mm=radius_mm, symmetries=symmetries, on_image=bar.update)
    names = ", ".join(f"{one.spec.name} (object {one.obj_id})" for one in objects)
    say(f"{out}: {names}: {images} {split} images; a bounding sphere has a radius of {radius_mm:g} mm")
