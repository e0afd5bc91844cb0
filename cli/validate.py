"""`symsol-annot validate`: list all faults of predictions files."""

import sys
from pathlib import Path

import click
from symsol_annot_cli.parameters import DATA, PREDICTIONS, example
from symsol_annot_cli.terminal import say

from symsol_annot.bench.predictions.predictions_reader import open_predictions
from symsol_annot.errors import SymsolError


@click.command(epilog=example("symsol-annot validate preds.h5 --data data"))
@PREDICTIONS
@DATA
def validate(paths: tuple[Path, ...], data: Path) -> None:
    """List all faults of predictions files, with track, row and reason."""
    is_good = True
    for path in paths:
        try:
            with open_predictions(path, data) as predictions:
                predictions.check()
                tracks = ", ".join(reader.name for reader in predictions.readers)
                say(f"{path}: valid; {predictions.about.object}, {len(predictions.about)} images: {tracks}")
        except SymsolError as error:
            say(f"Error: {error}", err=True)
            is_good = False
    sys.exit(0 if is_good else 1)
