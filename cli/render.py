"""`symsol-annot render`: make an object's image set."""

from functools import partial
from pathlib import Path
from shlex import quote

import click
from symsol_annot_cli.parameters import Crashes, ObjectType, cores, progress_bar

from symsol_annot.generate import ANNOTATE_CHOICES, MAX_SEED, SetPlan, generate
from symsol_annot.manifest import SPLITS, Manifest
from symsol_annot.object_check import check_object
from symsol_annot.objects import ObjectSpec
from symsol_annot.render_process import RenderProcess, check_blender_installed
from symsol_annot.scene import DEFAULT_SIZE, ENGINES, SIZE_RANGE, Camera, RenderSettings


@click.command()
@click.option("--object", "spec", type=ObjectType(), required=True, help="A built-in object, or a folder of your own.")
@click.option("--out", type=click.Path(path_type=Path), default=Path("data"), show_default=True, help="Holds the sets.")
@click.option("--train", type=click.IntRange(min=0), default=45000, show_default=True, help="Images to train on.")
@click.option("--test", type=click.IntRange(min=0), default=5000, show_default=True, help="Images to test on.")
@click.option("--seed", type=click.IntRange(0, MAX_SEED), default=0, show_default=True, help="Of the random rotations.")
@click.option("--size", type=click.IntRange(*SIZE_RANGE), default=DEFAULT_SIZE, show_default=True, help="In pixels.")
@click.option("--engine", type=click.Choice(ENGINES), default=ENGINES[0], show_default=True, help="Blender's engine.")
@click.option(
    "--annotate",
    type=click.Choice(ANNOTATE_CHOICES),
    default=ANNOTATE_CHOICES[0],
    show_default=True,
    help="Which splits get symmetry sets.",
)
@click.option(
    "--annotate-method",
    type=click.Choice(["auto", "exhaustive"]),
    default="auto",
    show_default=True,
    help="auto: geometry decides where it can, on convex bodies. exhaustive: draw every candidate. Same bytes.",
)
@click.option("--workers", type=click.IntRange(min=1), default=None, help="Blender processes.  [default: all cores]")
def render(
    spec: ObjectSpec,
    out: Path,
    train: int,
    test: int,
    seed: int,
    size: int,
    engine: str,
    annotate: str,
    annotate_method: str,
    workers: int | None,
) -> None:
    """Make an object's image set: RGB, segmentation and symmetry sets, in HDF5 shards.

    With nothing but --object it makes the published set. The same command again goes on where it stopped.
    """
    if train == test == 0:
        raise click.UsageError("--train and --test are both 0, which makes no set; --train 0 alone is fine")
    check_blender_installed()
    check_object(spec)
    camera, settings = Camera.filling(size), RenderSettings(engine)
    plan = SetPlan(spec, {"train": train, "test": test}, seed, camera, settings, annotate)
    folder, begun_again = out / spec.name, Crashes()
    with progress_bar(train + test, "image") as bar:
        bar.set_description(spec.name)
        try:
            manifest = generate(
                plan,
                folder,
                partial(RenderProcess, spec, camera, settings),
                workers or cores(),
                bar.update,
                exhaustive=annotate_method == "exhaustive",
                on_crash=begun_again,
            )
        except KeyboardInterrupt:
            bar.close()
            click.echo(f"Finished shards in {folder} are kept; the same command goes on.", err=True)
            raise
    _summarise(folder, manifest, begun_again)


def _summarise(folder: Path, manifest: Manifest, begun_again: Crashes) -> None:
    click.echo(f"{folder}: {manifest.recipe['object']}, fingerprint {manifest.fingerprint}")
    for split in SPLITS:
        entries = manifest.of_split(split)
        if entries:
            mebibytes = sum(entry.bytes or 0 for entry in entries) / 2**20
            sets = "with symmetry sets" if manifest.is_annotated(split) else "without symmetry sets"
            click.echo(f"  {split}: {manifest.images(split)} images {sets}, {len(entries)} shards, {mebibytes:.1f} MiB")
    if begun_again.shards:
        click.echo(f"  begun again after a crash of Blender: {', '.join(begun_again.shards)}")
    split = "test" if manifest.images("test") else "train"
    path, code = quote(str(folder)), f"import symsol_annot; print(symsol_annot.load({str(folder)!r}, {split!r})[0])"
    click.echo(
        f"Next:\n  symsol-annot verify {path}\n  symsol-annot plot {path} --split {split}\n  python -c {quote(code)}"
    )
