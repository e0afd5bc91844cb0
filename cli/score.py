"""`symsol-annot score`: score predictions files."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import DATA, DECIMALS, PREDICTIONS, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.bench.scoring.memory.foreign import score_npz
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.reports.scores_file import write_scores
from symsol_annot.bench.scoring.scoring import score as score_predictions
from symsol_annot.errors import printable
from symsol_annot.system.files import write_atomically


@click.command(epilog=example("symsol-annot score preds.h5 --json scores.json"))
@PREDICTIONS
@DATA
@click.option(
    "--secret",
    "secrets",
    metavar="FILE",
    multiple=True,
    type=click.Path(path_type=Path),
    help="The secret of a sealed test, which lies beside its labels; may be repeated.",
)
@click.option("--intervals", is_flag=True, help="Show each figure with its 95% interval.")
@click.option(
    "--json",
    "json_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write all figures, with their intervals, to this file; packed where its name ends in .gz.",
)
@click.option(
    "--per-image",
    "csv_path",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Write the figures of each image to this CSV.",
)
@DECIMALS
def score(
    paths: tuple[Path, ...],
    data: Path,
    secrets: tuple[Path, ...],
    json_path: Path | None,
    csv_path: Path | None,
    decimals: int | None,
    *,
    intervals: bool,
) -> None:
    """Score predictions: recall, precision and F-measure, by stratum.

    Several files, one per object, give the benchmark's table. An .npz of rotation matrices (images, hypotheses, 3, 3)
    is scored as it is; `convert` takes other forms.
    """
    outputs = [path.absolute() for path in (json_path, csv_path) if path]
    if len(set(outputs)) < len(outputs) or not {path.absolute() for path in paths}.isdisjoint(outputs):
        raise click.UsageError("--json and --per-image each need a file of their own, which is none of the predictions")
    if decimals is not None and not json_path:
        raise click.UsageError("--decimals goes with --json")
    scores = []
    for path in paths:
        if path.suffix == ".npz":
            scores.append(score_npz(path, data))
            continue
        with open_predictions(path, data, secrets) as predictions:
            rows = len(predictions.readers) * len(predictions.truth)
            with progress_bar(rows, "row") as bar:
                bar.set_description(printable(path.name))
                scores.append(score_predictions(predictions, bar.update))
    document = report.to_document(scores, decimals)
    say(tables.tables(document, intervals=intervals, width=tables.room()))
    if outputs and any(made.truth.is_sealed for made in scores):
        say("Warning: figures of single images tell labels: of a sealed test, send back the table alone", err=True)
    if json_path:
        write_scores(json_path, document)
    if csv_path:
        write_atomically(csv_path, report.per_image_csv(scores).encode())
