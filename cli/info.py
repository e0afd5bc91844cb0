"""`symsol-annot info`: say what a set holds."""

from pathlib import Path
from typing import Any

import click
from symsol_annot_cli.parameters import SET_FOLDER, example

from symsol_annot.manifest import SPLITS, read_manifest
from symsol_annot.statistics import SplitStatistics, sizes_in_words, split_statistics


@click.command(epilog=example("symsol-annot info data/cylO"))
@SET_FOLDER
def info(folder: Path) -> None:
    """Say what a set holds: counts, how often the marking shows, the sizes of the symmetry sets."""
    manifest = read_manifest(folder)
    recipe = manifest.recipe
    camera, render = recipe["camera"], recipe["render"]
    if manifest.is_imported:
        _print_source(recipe)
    else:
        click.echo(f"object       {recipe['object']} ({recipe['object_sha256'][:16]})")
        click.echo(
            f"images       {camera['width']}x{camera['height']}, engine {render['engine']}, seed {recipe['seed']}"
        )
        click.echo(f"camera       distance {camera['distance']:g}, focal length {camera['focal_px']:.2f} px")
    click.echo(f"fingerprint  {manifest.fingerprint or 'none yet: the set is not finished'}")
    for split in SPLITS:
        if manifest.images(split):
            finished = sum(entry.is_finished for entry in manifest.of_split(split))
            shards = f"{finished} of {len(manifest.of_split(split))} shards"
            click.echo(f"\n{split}: {manifest.images(split)} images, {shards}")
            _print_statistics(split_statistics(folder, manifest, split))


def _print_source(recipe: dict[str, Any]) -> None:
    """Say where an imported set is from, and that the rest is not known."""
    source, camera = recipe["source"], recipe["camera"]
    click.echo(f"object       {recipe['object']}")
    click.echo(f"source       {source['name']}, SHA-256 {source['sha256'][:16]}; convention {source['convention']}")
    click.echo(f"images       {camera['width']}x{camera['height']}; camera, seed, segmentation and marking unknown")


def _print_statistics(statistics: SplitStatistics) -> None:
    images = statistics.images
    if not images:
        return
    if statistics.has_marking:
        shown = statistics.shown
        click.echo(f"  marking shows in {shown} of {images} ({100 * shown / images:.1f}%)")
    if not statistics.is_annotated:
        click.echo("  without symmetry sets" + (": none are known" if statistics.is_imported else ""))
        return
    click.echo(f"  |S|: {sizes_in_words(statistics.set_sizes)}")
    if statistics.has_marking:
        click.echo(
            f"  of {statistics.candidates_drawn} candidates, {statistics.candidates_within_tolerance} show the marking "
            "by less than the tolerance"
        )
