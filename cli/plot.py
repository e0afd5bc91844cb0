"""`symsol-annot plot`: draw images with their segmentations and symmetry sets."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import SET_FOLDER, SPLIT

from symsol_annot import dataset
from symsol_annot.plots import contact_sheet


@click.command()
@SET_FOLDER
@SPLIT
@click.option("--start", type=click.IntRange(min=0), default=0, show_default=True, help="Index of the first image.")
@click.option("--count", type=click.IntRange(min=1, max=200), default=16, show_default=True, help="How many images.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The PNG.  [default: DATA-SPLIT.png]")
def plot(folder: Path, split: str, start: int, count: int, out: Path | None) -> None:
    """Draw images with their segmentation and their symmetry set in the pi-ball, to a PNG."""
    samples = dataset.load(folder, split)
    if start >= len(samples):
        raise click.UsageError(f"--start {start}: the split has {len(samples)} images, from 0")
    path = out or folder.parent / f"{folder.resolve().name}-{split}.png"
    has_marking = samples.manifest.recipe["tolerance_px"] is not None
    contact_sheet(samples[start : start + count], path, has_marking=has_marking)
    click.echo(path)
