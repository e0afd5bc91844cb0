"""`symsol-annot plot`: pictures of sets, predictions, scores and losses."""

from collections.abc import Callable, Sequence
from pathlib import Path

import click
from symsol_annot_cli.parameters import DATA, SET_FOLDER, SPLIT, Group, NearChoice, example
from symsol_annot_cli.terminal import say

from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.truth import find_set
from symsol_annot.bench.scoring.reports import curves as score_plots
from symsol_annot.bench.scoring.reports.report import STRATA
from symsol_annot.plotting.contact_sheet import contact_sheet
from symsol_annot.plotting.rotations import KINDS, plot_sets
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets import dataset
from symsol_annot.sets.dataset import Dataset, Sample
from symsol_annot.system.machine import check_extra

_OUT = click.option(
    "--out", type=click.Path(path_type=Path, dir_okay=False), required=True, help="The picture: .png, .pdf or .svg."
)
_IMAGES = click.option(
    "--image",
    "images",
    type=click.IntRange(min=0),
    multiple=True,
    default=(0,),
    help="Index of an image; may be repeated.  [default: 0]",
)


@click.group(cls=Group)
def plot() -> None:
    """Draw sets, predictions, scores and losses, for papers and for looking."""


@plot.command(epilog=example("symsol-annot plot images data/cylO --count 8"))
@SET_FOLDER
@SPLIT
@click.option("--start", type=click.IntRange(min=0), default=0, show_default=True, help="Index of the first image.")
@click.option("--count", type=click.IntRange(min=1, max=200), default=16, show_default=True, help="Number of images.")
@click.option("--out", type=click.Path(path_type=Path, dir_okay=False), help="The picture.  [default: DATA-SPLIT.png]")
def images(folder: Path, split: str, start: int, count: int, out: Path | None) -> None:
    """Draw images with their segmentations and symmetry sets, on one sheet."""
    check_extra("plot", "plotting")
    samples = dataset.load(folder, split)
    if start >= len(samples):
        raise click.UsageError(f"--start {start}: the split has {len(samples)} images, from 0")
    path = out or Path(f"{folder.resolve().name}-{split}.png")
    contact_sheet(
        samples[start : start + count],
        path,
        has_marking=samples.has_marking,
        parts=samples.manifest.settings.named_parts,
    )
    say(path)


@plot.command(epilog=example("symsol-annot plot sets data/tetX --image 3 --predictions preds.h5 --out sets.pdf"))
@SET_FOLDER
@SPLIT
@_IMAGES
@click.option(
    "--kind",
    type=click.Choice(KINDS),
    default=KINDS[0],
    show_default=True,
    help="In the ball of rotation vectors, or on the sphere of directions with the tilt as colour.",
)
@click.option("--predictions", type=click.Path(path_type=Path), help="A predictions file to draw over the truth.")
@click.option("--track", type=click.Choice(list(TRACKS)), help="The track, if the predictions have several.")
@_OUT
def sets(
    folder: Path,
    split: str,
    images: tuple[int, ...],
    kind: str,
    predictions: Path | None,
    track: str | None,
    out: Path,
) -> None:
    """Draw images and their symmetry sets, with predictions over them."""
    if track and not predictions:
        raise click.UsageError(f"--track {track}: is of --predictions, which is not given")
    check_extra("plot", "plotting")
    samples = dataset.load(folder, split)
    chosen = [_sample(samples, image) for image in images]
    title, predicted = f"{samples.object}, {split}", None
    if predictions:
        method, every = _predicted(predictions, samples, track)
        title, predicted = f"{title}: {method}", [every[image] for image in images]
    plot_sets(chosen, out, kind, predicted, title)
    say(out)


@plot.command("slice", epilog=example("symsol-annot plot slice runs/tetX-classifier --image 3 --out slice.pdf"))
@click.argument("checkpoints", metavar="CHECKPOINT...", nargs=-1, required=True, type=click.Path(path_type=Path))
@DATA
@SPLIT
@click.option("--image", type=click.IntRange(min=0), default=0, show_default=True, help="Index of the image.")
@click.option("--axis", type=click.Choice(["x", "y", "z"]), default="x", show_default=True, help="Axis of the model.")
@click.option(
    "--reach",
    type=click.FloatRange(0, 180, min_open=True),
    default=180.0,
    show_default=True,
    help="The largest angle, in degrees.",
)
@_OUT
def slice_(
    checkpoints: tuple[Path, ...], data: Path, split: str, image: int, axis: str, reach: float, out: Path
) -> None:
    """Draw the probabilities that classifiers give along a turn of an image's rotation about one axis."""
    check_extra("bench", "plotting slices")
    check_extra("plot", "plotting")
    from symsol_annot.bench.models.plots import slices as slice_plots  # noqa: PLC0415 - slow to import
    from symsol_annot.bench.models.training.checkpoints import open_checkpoint  # noqa: PLC0415

    opened = [open_checkpoint(path) for path in checkpoints]
    samples = dataset.load(find_set(data, opened[0].record.object), split)
    classifiers = slice_plots.classifiers_for(samples, opened)
    slice_plots.plot_slice(classifiers, _sample(samples, image), out, axis, reach)
    say(out)


def _add_scores_plot(name: str, draw: Callable[[Sequence[Path], Path, str, str], None], about: str) -> None:
    """Add a command that draws files of scores."""
    line = f"symsol-annot plot {name} a.json b.json --object tetX --out {name}.pdf"

    @plot.command(name, help=about, epilog=example(line))
    @click.argument("paths", metavar="SCORES.JSON...", nargs=-1, required=True, type=click.Path(path_type=Path))
    @click.option("--object", "object_name", metavar="NAME", required=True, help="An object in the scores.")
    @click.option("--stratum", type=NearChoice(STRATA), default="all", show_default=True, help="Stratum of the images.")
    @_OUT
    def draw_scores(paths: tuple[Path, ...], object_name: str, stratum: str, out: Path) -> None:
        check_extra("plot", "plotting")
        draw(paths, out, object_name, stratum)
        say(out)


_add_scores_plot(
    "precision-recall",
    score_plots.plot_precision_recall,
    "Draw the precision of classifiers over their recall, at all thresholds.",
)
_add_scores_plot(
    "coverage",
    score_plots.plot_coverage,
    "Draw the coverage and accuracy of hypotheses over the angle.",
)

_add_scores_plot(
    "calibration",
    score_plots.plot_calibration,
    "Draw the share of the symmetry sets in the smallest regions of densities, over the regions' mass.",
)


@plot.command(epilog=example("symsol-annot plot losses --out losses.png"))
@click.option("--toy", is_flag=True, help="Draw hypotheses in a plane that converge, instead of curves.")
@_OUT
def losses(*, toy: bool, out: Path) -> None:
    """Draw the losses of the thesis: figures 4.5, A.1 and A.2 as curves, or figures 4.2 to 4.4 as a toy."""
    check_extra("bench", "plotting losses")
    check_extra("plot", "plotting")
    from symsol_annot.bench.models.plots import losses as loss_plots  # noqa: PLC0415 - slow to import

    (loss_plots.plot_toys if toy else loss_plots.plot_curves)(out)
    say(out)


def _sample(samples: Dataset, image: int) -> Sample:
    if image >= len(samples):
        raise click.UsageError(f"--image {image}: the split has {len(samples)} images, from 0")
    return samples[image]


def _predicted(path: Path, samples: Dataset, track: str | None) -> tuple[str, Sequence[Rotations]]:
    """Return the method's name and what it says of each image."""
    with open_predictions(path, samples.folder) as predictions:
        if predictions.truth.fingerprint != samples.fingerprint:
            about = f"{predictions.truth.object} {predictions.truth.split}"
            raise click.UsageError(f"--predictions {path}: is about {about}; --split names another")
        readers = {reader.name: reader for reader in predictions.readers}
        if track and track not in readers:
            raise click.UsageError(f"--track {track}: {path} has {', '.join(readers)}")
        chosen = readers[track] if track else predictions.readers[0]
        return predictions.method, [one.rotations for one in predictions.proposals(chosen)]
