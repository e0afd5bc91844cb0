"""`symsol-annot train`: train a reference model by a recipe."""

import sys
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import click
from symsol_annot_cli.parameters import DATA, example, progress_bar
from tqdm import tqdm

from symsol_annot import dataset
from symsol_annot.bench.recipe import builtin_recipes, load_recipe
from symsol_annot.bench.truth import find_set
from symsol_annot.errors import DataError, SymsolError
from symsol_annot.manifest import MANIFEST_NAME

if TYPE_CHECKING:
    from symsol_annot.bench.checkpoints import About


def _list(context: click.Context, _: click.Parameter, is_asked: bool) -> None:  # noqa: FBT001 - as click calls it
    if is_asked and not context.resilient_parsing:
        for name in builtin_recipes():
            click.echo(f"{name:<34}{load_recipe(name).title}")
        context.exit()


@click.command(epilog=example("symsol-annot train small-ewta --data data/tetX"))
@click.argument("recipe")
@click.option("--list", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="List the recipes.")
@DATA
@click.option("--object", "object_name", metavar="NAME", help="Which, where --data holds sets of several objects.")
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), help="[default: runs/OBJECT-RECIPE]")
@click.option("--device", default="auto", show_default=True, help="auto, cpu, cuda, cuda:1 ..")
@click.option("--epochs", type=click.IntRange(min=1), help="More or fewer; the schedule is stretched.")
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True)
@click.option("--held-out", type=click.IntRange(min=0), help="How many train images are evaluated, not learnt.")
@click.option(
    "--pretrained",
    type=click.Path(path_type=Path),
    multiple=True,
    help="Checkpoint to choose a classifier's first stage from; may be repeated.  [default: all beside --out]",
)
@click.option("--compile", "is_compiled", is_flag=True, help="Use torch.compile.")
def train(
    recipe: str,
    data: Path,
    object_name: str | None,
    out: Path | None,
    device: str,
    epochs: int | None,
    seed: int,
    held_out: int | None,
    pretrained: tuple[Path, ...],
    *,
    is_compiled: bool,
) -> None:
    """Train a reference model on the train split of a set.

    RECIPE is a built-in one (--list) or a TOML file. The same command again goes on where it stopped.
    """
    file = load_recipe(recipe)
    with dataset.load(_set_in(data, object_name), "train") as images:
        if object_name not in (None, images.object):
            raise DataError(f"{images.folder}: is a set of {images.object}, not of {object_name}")
        wanted = file.for_object(images.object, has_marking=images.has_marking)
        if held_out is not None:
            wanted = replace(wanted, held_out=held_out)
        place = out or Path("runs") / f"{images.object}-{file.name}"
        try:
            from symsol_annot.bench import training  # noqa: PLC0415 - slow to import
        except ImportError:
            raise SymsolError("training needs torch: `pip install 'symsol-annot[bench]'`") from None
        options = training.Options(epochs, seed, device, pretrained, is_compiled)
        with _Progress(place) as progress:
            about = training.train(
                wanted,
                images,
                place,
                options,
                name=file.name,
                on_start=progress.begin,
                on_images=progress.advance,
                on_epoch=progress.tell,
            )
    click.echo(
        f"{place}: {about.epochs_done} epochs of {about.epochs}\nNext:\n  symsol-annot predict {place} --data {data}"
    )


def _set_in(data: Path, object_name: str | None) -> Path:
    """Return the folder of the set that is meant: of an object, or the only one there is."""
    if object_name:
        return find_set(data, object_name)
    if (data / MANIFEST_NAME).is_file():
        return data
    there = sorted(path.parent for path in data.glob(f"*/{MANIFEST_NAME}"))
    if len(there) != 1:
        found = f"several: {', '.join(path.name for path in there)}; --object names one" if there else "none"
        raise DataError(f"{data}: expected a set to train on, found {found}")
    return there[0]


class _Progress:
    """A bar over all epochs, a line an epoch, and where it is kept if it is interrupted."""

    def __init__(self, place: Path) -> None:
        self._place = place
        self._bar: tqdm[None] | None = None

    def begin(self, about: "About", images_an_epoch: int) -> None:
        """Show what is there already."""
        self._bar = progress_bar(about.epochs * images_an_epoch, "image", done=about.epochs_done * images_an_epoch)
        self._bar.set_description(self._place.name)
        if about.epochs_done:
            _say(f"goes on after epoch {about.epochs_done} of {about.epochs}")

    def advance(self, images: int) -> None:
        """Count images."""
        if self._bar:
            self._bar.update(images)

    def tell(self, about: "About") -> None:
        """Show the epoch that is finished."""
        row = dict(about.rows[-1])
        epoch = int(row.pop("epoch"))
        figures = ", ".join(f"{name} {value:.4g}" for name, value in row.items())
        _say(f"epoch {epoch}/{about.epochs}: {figures}")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.close()
        if isinstance(error, KeyboardInterrupt):
            click.echo(f"Finished epochs are kept in {self._place}; the same command goes on.", err=True)


def _say(line: str) -> None:
    with tqdm.external_write_mode(file=sys.stdout):  # above the bar
        click.echo(line)
