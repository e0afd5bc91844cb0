"""Compares the thesis's classifiers at a reduced size: .venv/bin/python docs/thesis_classifiers.py [--folder FOLDER].

The rows of table 7.1 and the numbers of negatives of figure 7.4, as the recipes `reduced-classifier` and so on have
them. It trains none: `docs/baselines.py RECIPE --only train` does, after the hypothesis networks that a first stage
may come from. Of each training that FOLDER/runs has and that is finished, docs/results/thesis_classifiers.json keeps
the figures on its validation images after the last epoch; the table of docs/models.md is written from that file, in
which trainings that are not in the folder stay as they are.
"""

import argparse
import json
import sys
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baseline_rows import BOARD, MARKED, BaselineError, row_of
from written_tables import put_table

from symsol_annot.bench.leaderboard.results import THESIS
from symsol_annot.bench.models.recipe import load_recipe, recipe_to_toml
from symsol_annot.bench.models.training.checkpoints import read_record
from symsol_annot.errors import SymsolError
from symsol_annot.system.files import write_atomically

PROJECT = Path(__file__).resolve().parents[1]
RESULTS = PROJECT / "docs" / "results" / "thesis_classifiers.json"
PAGE = PROJECT / "docs" / "models.md"
FOLDER = PROJECT / "build" / "baselines" / "published"
PREFIX = "reduced-"
ROWS: Mapping[str, str] = {
    "classifier-no-encoding": "no positional encoding",
    "classifier-no-pretraining": "no pretraining",
    "classifier-best-precision": "first stage by best precision",
    "classifier": "baseline: first stage by best recall, K = 256",
    "classifier-k64": "K = 64",
    "classifier-k128": "K = 128",
    "classifier-k512": "K = 512",
    "classifier-k1024": "K = 1024",
}
FIGURES = ("f_measure", "recall", "precision")


def main() -> None:
    """Take what is finished, and write file and table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=FOLDER, help=f"of baselines.py  [default: {FOLDER}]")
    try:
        keep(finished(parser.parse_args().folder))
        write_table()
    except SymsolError as error:
        sys.exit(f"Error: {error}")


def finished(folder: Path) -> dict[str, dict[str, Any]]:
    """Return what came of the finished trainings of a folder, by row and object.

    Raises:
        BaselineError: one is of another recipe than the row's.
    """
    found: dict[str, dict[str, Any]] = {}
    for name in ROWS:
        row = row_of(PREFIX + name, "published", 0, folder)
        for shape in MARKED:
            if not (weights := row.weights(shape)).is_file():
                continue
            record = read_record(weights)
            if record.recipe != load_recipe(row.recipe).for_object(shape, has_marking=True):
                raise BaselineError(f"{weights}: is of another recipe than {row.recipe}; move it away to train anew")
            if record.is_finished:
                found.setdefault(name, {})[shape] = {
                    **{figure: round(record.rows[-1][figure], 4) for figure in FIGURES},
                    "processor_minutes": round(sum(epoch["processor_seconds"] for epoch in record.rows) / 60, 1),
                    "first_stage": record.first_stage.partition(", sha256")[0],
                    "recipe": recipe_to_toml(record.recipe),
                }
    return found


def keep(found: Mapping[str, Mapping[str, Any]]) -> None:
    """Put what came of trainings into the file of results."""
    known = known_results()
    merged = {name: {**known.get(name, {}), **found.get(name, {})} for name in ROWS}
    write_atomically(RESULTS, (json.dumps({name: of for name, of in merged.items() if of}, indent=1) + "\n").encode())


def known_results() -> dict[str, dict[str, Any]]:
    """Return what the file of results has."""
    known: dict[str, dict[str, Any]] = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    return known


def table() -> str:
    """Return the table of the results as Markdown, beside the thesis's own figures."""
    of_thesis = tomllib.loads((BOARD / THESIS).read_text())["tables"]["Table 7.1: F-measure at 0.8"]
    shapes = [shape for shape in MARKED if any(shape in known for known in known_results().values())]
    columns = [f"{shape}: {what}" for shape in shapes for what in ("the thesis", "F at 0.8")]
    lines = [f"| | {' | '.join(columns)} |", "|---|" + "---|" * len(columns)]
    for name, known in known_results().items():
        cells = []
        for shape in shapes:
            theirs = of_thesis["rows"].get(name)
            cells.append("" if theirs is None else f"{theirs[of_thesis['objects'].index(shape)]:.3f}")
            cells.append(f"{known[shape]['f_measure']:.3f}" if shape in known else "")
        lines.append(f"| {ROWS[name]} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def write_table() -> None:
    """Put the table in its place on the page."""
    put_table(PAGE, Path(__file__).name, table())


if __name__ == "__main__":
    main()
