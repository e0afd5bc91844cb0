"""`symsol-annot retrieve`: predict by the nearest train images, without training."""

from pathlib import Path

import click
import numpy as np
from symsol_annot_cli.parameters import SET_FOLDER, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.bench.models.retrieval.embedding import MAX_SIZE
from symsol_annot.bench.models.retrieval.retrieval import DEFAULT_SIZE, METHOD, Retrieved
from symsol_annot.bench.models.retrieval.retrieval import retrieve as write_retrieved
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets import dataset


@click.command(epilog=example("symsol-annot retrieve data/cylO --out preds.h5"))
@SET_FOLDER
@click.option(
    "--out",
    type=click.Path(path_type=Path, dir_okay=False),
    default=Path("preds.h5"),
    show_default=True,
    help="The predictions file.",
)
@click.option(
    "--views",
    type=click.Path(path_type=Path),
    help="Set of the same object whose train images are searched.  [default: DATA]",
)
@click.option(
    "--size",
    type=click.IntRange(1, MAX_SIZE),
    default=DEFAULT_SIZE,
    show_default=True,
    help="Width and height in pixels that images are reduced to.",
)
@click.option("--method", default=METHOD, show_default=True, help="The method's name in the file.")
@click.option(
    "--level", type=click.IntRange(0, 5), default=STANDARD_LEVEL, show_default=True, help="Level of the grid."
)
def retrieve(folder: Path, out: Path, views: Path | None, size: int, method: str, level: int) -> None:
    """Predict the test images of a set by the train images that look most like them.

    Needs no training and no torch. Re-running an interrupted command resumes it.
    """
    with dataset.load(folder, "test") as test, dataset.load(views or folder, "train") as train:
        with progress_bar(len(train) + len(test), "image") as bar:
            done = write_retrieved(test, train, out, size=size, method=method, level=level, on_images=bar.update)
        about = f"{out}: {', '.join(done.tracks)} about {len(test)} images of {test.object}"
    say(f"{about}\n{_fitted(done)}\nNext:\n  symsol-annot score {out} --data {folder}")


def _fitted(done: Retrieved) -> str:
    """Return what was fitted, for people to read."""
    widths, angle_deg = done.bandwidths, np.degrees(done.bandwidths.angle_rad)
    densities = f"bandwidth {angle_deg:.2f} degrees, uniform share {widths.uniform:g}, mean ln p {done.log_density:.3f}"
    claims = "no claims: their threshold is fitted on symmetry sets of train images, and a sealed test takes none"
    if done.rule is not None:
        claims = f"claims: ln p > {done.rule.offset:g} + {done.rule.slope:g} ln(peak), F-measure {done.f_measure:.3f}"
    return f"Fitted on train images, each left out of the views: {densities}\n{claims}"
