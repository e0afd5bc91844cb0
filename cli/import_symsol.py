"""`symsol-annot import-symsol`: the original SYMSOL as sets of this package."""

import sys
from pathlib import Path

import click
from symsol_annot_cli.parameters import NearChoice, example, progress_bar
from symsol_annot_cli.terminal import say
from tqdm import tqdm

from symsol_annot.sets.manifest import Manifest
from symsol_annot.symsol.importing import ImportedSet
from symsol_annot.symsol.importing import import_symsol as imported_sets
from symsol_annot.symsol.zip_reader import OBJECTS
from symsol_annot.system.machine import cores
from symsol_annot.system.text.names import SPLITS


@click.command("import-symsol", epilog=example("symsol-annot import-symsol symsol_dataset.zip --out symsol"))
@click.argument("path", metavar="ZIP", type=click.Path(path_type=Path))
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="symsol",
    show_default=True,
    help="The folder of the sets.",
)
@click.option(
    "--object",
    "objects",
    multiple=True,
    type=NearChoice(OBJECTS),
    help="Object to import; may be repeated.  [default: all]",
)
@click.option("--workers", type=click.IntRange(min=1), help="Number of threads.  [default: all cores]")
def import_symsol(path: Path, out: Path, objects: tuple[str, ...], workers: int | None) -> None:
    """Import the zip of the original SYMSOL: its images, rotations and symmetry sets.

    Each object becomes a set, OUT/OBJECT, once it is complete; a complete set that is there already stays. What the
    source does not say stays unknown: camera, segmentation, the convention of its rotations, and the sets of tetX,
    cylO and sphereX.
    """
    with progress_bar(None, "image") as bar:

        def begin(manifest: Manifest) -> None:
            bar.reset(total=sum(manifest.images(split) for split in SPLITS))
            bar.set_description(manifest.settings.object)

        options = {"workers": workers or cores(), "on_begin": begin, "on_images": bar.update}
        for made in imported_sets(path, out, objects, **options):
            with tqdm.external_write_mode(file=sys.stdout):  # above the bar
                say(_line(made))


def _line(made: ImportedSet) -> str:
    images = ", ".join(f"{made.manifest.images(split)} {split}" for split in SPLITS)
    source = made.manifest.imported.source
    if made.members is None:
        sets = "no symmetry sets are known"
    else:
        listed, twice = source.rotations_listed, source.duplicates_removed
        sets = f"sets of {made.members} rotations" + (f" ({listed} listed, {twice} of them twice)" if twice else "")
    if made.was_there:
        return f"{made.folder}: {images} images, {sets}; was there already"
    off = f"rotations off SO(3) by at most {made.off_so3:.1e}"
    if made.members is not None:
        off += f", listed ones off R g by at most {made.off_sets_rad:.1e} rad"
    return f"{made.folder}: {images} images, {sets}; {off}"
