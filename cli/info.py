"""`symsol-annot info`: say what a set holds."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import SET_FOLDER

from symsol_annot.manifest import SPLITS, read_manifest
from symsol_annot.statistics import SplitStatistics, split_statistics


@click.command()
@SET_FOLDER
def info(folder: Path) -> None:
    """Say what a set holds: counts, how often the marking shows, the sizes of the symmetry sets."""
    manifest = read_manifest(folder)
    recipe = manifest.recipe
    camera, render = recipe["camera"], recipe["render"]
    click.echo(f"object       {recipe['object']} ({recipe['object_sha256'][:16]})")
    click.echo(f"images       {camera['width']}x{camera['height']}, engine {render['engine']}, seed {recipe['seed']}")
    click.echo(f"camera       distance {camera['distance']:g}, focal length {camera['focal_px']:.2f} px")
    click.echo(f"fingerprint  {manifest.fingerprint or 'none yet: the set is not finished'}")
    for split in SPLITS:
        if manifest.images(split):
            finished = sum(entry.is_finished for entry in manifest.of_split(split))
            shards = f"{finished} of {len(manifest.of_split(split))} shards"
            click.echo(f"\n{split}: {manifest.images(split)} images, {shards}")
            _print_statistics(split_statistics(folder, manifest, split))


def _print_statistics(statistics: SplitStatistics) -> None:
    images = statistics.images
    if not images:
        return
    if statistics.has_marking:
        shown = statistics.shown
        click.echo(f"  marking shows in {shown} of {images} ({100 * shown / images:.1f}%)")
    if not statistics.is_annotated:
        click.echo("  without symmetry sets")
        return
    sizes = statistics.set_sizes
    if len(sizes) <= 12:
        click.echo("  |S|: " + ", ".join(f"{size} in {count}" for size, count in sorted(sizes.items())))
    else:
        several = sorted(size for size, count in sizes.items() for _ in range(count) if size > 1)
        click.echo(
            f"  |S|: 1 in {sizes.get(1, 0)}, else {several[0]} to {several[-1]}, median {several[len(several) // 2]}"
        )
    if statistics.has_marking:
        click.echo(
            f"  of {statistics.candidates_drawn} candidates, {statistics.candidates_within_tolerance} show the marking "
            "by less than the tolerance"
        )
