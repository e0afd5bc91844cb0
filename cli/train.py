"""`symsol-annot train`: train a reference model by a recipe."""

import sys
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Self

import click
from symsol_annot_cli.epoch_table import EpochTable
from symsol_annot_cli.parameters import DATA, example, progress_bar
from symsol_annot_cli.terminal import say
from tqdm import tqdm

from symsol_annot.bench.models.kinds import Recipe
from symsol_annot.bench.models.recipe import RecipeFile, builtin_recipes, load_recipe
from symsol_annot.bench.predictions.truth import find_set
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.sets import dataset
from symsol_annot.sets.folders import set_folders
from symsol_annot.system.cache import Cache, user_cache_folder
from symsol_annot.system.machine import check_extra

if TYPE_CHECKING:
    from symsol_annot.bench.models.training.record import TrainingRecord

_MAX_WORKERS = 256


def _list(context: click.Context, _: click.Parameter, is_asked: bool) -> None:  # noqa: FBT001 - as click calls it
    if is_asked and not context.resilient_parsing:
        for name in builtin_recipes():
            say(f"{name:<34}{load_recipe(name).title}")
        context.exit()


@click.command(epilog=example("symsol-annot train small-ewta --data data/tetX"))
@click.argument("recipe")
@click.option("--list", is_flag=True, is_eager=True, expose_value=False, callback=_list, help="List the recipes.")
@DATA
@click.option("--object", "object_name", metavar="NAME", help="The object, where --data holds sets of several.")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of the training.  [default: runs/OBJECT-RECIPE]",
)
@click.option(
    "--device", default="auto", show_default=True, help="What the network runs on: auto, cpu, cuda or cuda:N."
)
@click.option(
    "--epochs",
    type=click.IntRange(min=1),
    help="Number of epochs; the schedule is stretched to it. A higher one than before extends a training.  "
    "[default: the recipe's]",
)
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Seed of the random numbers."
)
@click.option("--batch-size", type=click.IntRange(min=2), help="Number of images per step.  [default: the recipe's]")
@click.option(
    "--learning-rate",
    type=click.FloatRange(min=0.0, min_open=True),
    help="The first learning rate; later ones keep their ratio to it.  [default: the recipe's]",
)
@click.option(
    "--validation-images", type=click.IntRange(min=0), help="Number of train images that are kept for evaluation."
)
@click.option(
    "--pretrained",
    type=click.Path(path_type=Path),
    multiple=True,
    help="Checkpoint to choose a classifier's first stage from; may be repeated.  [default: all beside --out]",
)
@click.option(
    "--workers",
    type=click.IntRange(1, _MAX_WORKERS),
    help="Number of threads that decode images, or of processes that read them where memory is too small.  "
    "[default: as many as cores, up to 8 processes]",
)
@click.option(
    "--cache/--no-cache",
    "is_cached",
    default=True,
    show_default=True,
    help="Keep the images that a recipe reduces in ~/.cache/symsol-annot, so that they are decoded once.",
)
@click.option(
    "--tensorboard", "has_events", is_flag=True, help="Write losses and figures for TensorBoard, in --out/tensorboard."
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
    batch_size: int | None,
    learning_rate: float | None,
    validation_images: int | None,
    pretrained: tuple[Path, ...],
    workers: int | None,
    *,
    is_cached: bool,
    has_events: bool,
    is_compiled: bool,
) -> None:
    """Train a reference model on the train split of a set.

    RECIPE is a built-in one (--list) or a TOML file. Re-running the command resumes it, even after a crash.
    """
    check_extra("bench", "training")
    if has_events:
        check_extra("tensorboard", "--tensorboard")
    file = load_recipe(recipe)
    with dataset.load(_set_in(data, object_name), "train") as images:
        if object_name not in (None, images.object):
            raise DataError(f"{images.folder}: is a set of {images.object}, not of {object_name}")
        wanted = _changed(file, images, batch_size, learning_rate, validation_images)
        place = out or Path("runs") / f"{images.object}-{file.name}"
        from symsol_annot.bench.models.training import loop  # noqa: PLC0415 - slow to import

        folder = user_cache_folder() if is_cached else None
        cache = None if folder is None else Cache(folder)
        options = loop.Options(epochs, seed, device, pretrained, is_compiled, workers, cache, has_events)
        with _Progress(place) as progress:
            record = loop.train(
                wanted,
                images,
                place,
                options,
                name=file.name,
                on_start=progress.begin,
                on_batch=progress.advance,
                on_loss=progress.tell_loss,
                on_epoch=progress.tell,
            )
    say(f"{place}: {record.epochs_done} epochs of {record.epochs}, with all figures in metrics.csv")
    if record.calibration:
        fitted = ", ".join(f"{name} {value:.4g}" for name, value in record.calibration.items())
        say(f"Fitted on validation images: {fitted}")
    say("Next:")
    if has_events:
        say(f"  tensorboard --logdir {place.parent}")
    say(f"  symsol-annot predict {place} --data {data}")


def _changed(
    file: RecipeFile,
    images: dataset.Dataset,
    batch_size: int | None,
    learning_rate: float | None,
    validation_images: int | None,
) -> Recipe:
    """Return the recipe for the set's object, with what the command line gives in the place of its own."""
    wanted = file.for_object(images.object, has_marking=images.has_marking)
    if learning_rate is not None:
        ratio = learning_rate / wanted.learning_rates[0]
        wanted = replace(wanted, learning_rates=tuple(rate * ratio for rate in wanted.learning_rates))
    wanted = replace(wanted, batch_size=batch_size or wanted.batch_size)
    if validation_images is not None:
        wanted = replace(wanted, validation_images=validation_images)
    if faults := list(wanted.faults()):
        raise SettingsError(f"{file.name}: " + "; ".join(faults))
    return wanted


def _set_in(data: Path, object_name: str | None) -> Path:
    """Return the folder of the set that is meant: of an object, or the only one there is."""
    if object_name:
        return find_set(data, object_name)
    there = set_folders(data)
    if len(there) != 1:
        found = f"several: {', '.join(path.name for path in there)}; --object names one" if there else "none"
        raise DataError(f"{data}: expected a set to train on, found {found}")
    return there[0]


class _Progress:
    """A bar over all epochs, a table of them, and a word on what is kept after an interruption."""

    def __init__(self, place: Path) -> None:
        self._place, self._epochs = place, 0
        self._bar: tqdm[None] | None = None
        self._table: EpochTable | None = None

    def begin(self, record: "TrainingRecord", images_per_epoch: int) -> None:
        """Open the bar, at the epochs that an earlier run finished."""
        self._bar = progress_bar(record.epochs * images_per_epoch, "img", done=record.epochs_done * images_per_epoch)
        self._epochs = record.epochs
        self._describe(record.epochs_done + 1, "")
        done, planned = record.extensions[-1] if record.extensions else (0, 0)
        if record.epochs_done and record.epochs_done == done:
            _say(f"extended after epoch {record.epochs_done}, from {planned} epochs to {record.epochs}")
        elif record.epochs_done:
            _say(f"resumes after epoch {record.epochs_done} of {record.epochs}")

    def advance(self, images: int) -> None:
        """Count a batch's images."""
        if self._bar:
            self._bar.update(images)

    def tell_loss(self, epoch: int, loss: float) -> None:
        """Show the epoch under way, and its mean loss up to now."""
        self._describe(epoch, f" loss {loss:.4g}")

    def tell(self, record: "TrainingRecord") -> None:
        """Show the epoch that is finished."""
        row = record.rows[-1]
        if self._table is None:
            self._table = EpochTable(row, record.epochs)
            _say("\n".join(self._table.heading()))
        _say(self._table.line(row))
        self._describe(record.epochs_done + 1, "")

    def _describe(self, epoch: int, loss: str) -> None:
        if self._bar:
            self._bar.set_description(f"epoch {min(epoch, self._epochs)}/{self._epochs}{loss}", refresh=False)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._bar:
            self._bar.close()
        if isinstance(error, KeyboardInterrupt):
            say(f"Finished epochs are kept in {self._place}; re-running the command resumes it.", err=True)


def _say(line: str) -> None:
    with tqdm.external_write_mode(file=sys.stdout):  # above the bar
        say(line)
