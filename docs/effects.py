"""Measures what keys of recipes do, each alone: .venv/bin/python docs/effects.py [--set data/tetX].

Two short trainings, of a mixture and of a classifier, have all of a recipe's means; of each further one, one thing is
changed. Of each, docs/results/effects.json keeps its recipe, the F-measure on validation images after the last epoch
with what is fitted on them, a classifier's without that, a mixture's log-likelihood, and the speed then. The table of
docs/training.md is written from that file, with the speeds of docs/results/effect_speeds.json, which
tools/perf/effect_speeds.py measures in one run. Re-running the command resumes it, and trains nothing that the file has
of the same recipe.
"""

import argparse
import json
import subprocess
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from written_tables import put_table

from symsol_annot.bench.models.recipe import recipe_from_toml
from symsol_annot.bench.models.training.checkpoints import WEIGHTS_FILE, read_record
from symsol_annot.errors import SymsolError, WeightsError
from symsol_annot.system.files import write_atomically

PROJECT = Path(__file__).resolve().parents[1]
RESULTS = PROJECT / "docs" / "results" / "effects.json"
SPEEDS = PROJECT / "docs" / "results" / "effect_speeds.json"
PAGE = PROJECT / "docs" / "training.md"
MEANS: Mapping[str, Any] = {
    "start": "random",
    "batch_size": 64,
    "epochs": 2,
    "milestones": [],
    "schedule": "cosine",
    "warm_up": 0.25,
    "clip_norm": 10.0,
    "rolls": True,
    "input_size": 32,
    "precision": "auto",
    "validation_images": 1000,
}
BASES: Mapping[str, Mapping[str, Any]] = {
    "mixture": {"model": "mixture", **MEANS, "learning_rates": [1.5e-3], "structure": "free", "components": 32},
    "classifier": {
        "model": "classifier",
        **MEANS,
        "learning_rates": [1e-3],
        "frequencies": 3,
        "negatives": 256,
        "frozen_epochs": 0,
        "bias_from_negatives": True,
        "members": 8,
        "near_negatives": 128,
        "fitted_shift": True,
    },
}
EFFECTS: Mapping[str, Mapping[str, Any]] = {  # a base's name, and what is changed
    "mixture": {},
    "mixture, constant rate": {"schedule": "steps"},
    "mixture, no warm-up": {"warm_up": 0.0},
    "mixture, not clipped": {"clip_norm": 0.0},
    "mixture, not rolled": {"rolls": False},
    "mixture, one member": {"members": 1},
    "mixture, float32": {"precision": "float32"},
    "classifier": {},
    "classifier, logit from 0": {"bias_from_negatives": False},
    "classifier, one member": {"members": 1},
    "classifier, uniform negatives": {"near_negatives": 0},
    "classifier, rejected candidates": {"hard_negatives": 32, "hard_weight": 1.0},
    "mixture, 64 pixels": {"input_size": 64},
}
SEEDS: Mapping[str, tuple[int, ...]] = dict.fromkeys(BASES, (0, 1))  # of others: 0


@dataclass(frozen=True)
class Measured:
    """What came of a training.

    Attributes:
        f_measure: the mean of the validation images after the last epoch, with what was fitted on them.
        unfitted_f_measure: a classifier's at 0.8, without the fitted shift; None of a mixture.
        log_likelihood: a mixture's at R_gt; None of a classifier.
        images_per_second: of the last epoch.
        processor_minutes: of all epochs.
    """

    f_measure: float
    unfitted_f_measure: float | None
    log_likelihood: float | None
    images_per_second: float
    processor_minutes: float


def main() -> None:
    """Train what is not trained yet, and write file and table after each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", type=Path, default=PROJECT / "data" / "tetX", help="a set  [default: data/tetX]")
    parser.add_argument("--folder", type=Path, default=PROJECT / "build" / "effects", help="the working folder")
    parser.add_argument("--only", choices=EFFECTS, action="append", help="one training; may be repeated")
    options = parser.parse_args()
    try:
        for name in options.only or EFFECTS:
            for seed in SEEDS.get(name, (0,)):
                if not is_known(name, seed):
                    keep(name, seed, measured(name, seed, options.set, options.folder))
                write_table()
    except SymsolError as error:
        sys.exit(f"Error: {error}")
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)


def recipe_text(name: str, instead: Mapping[str, Any] | None = None) -> str:
    """Return a training's recipe as TOML, with some keys instead of the base's."""
    chosen = {"title": f"Single effects: {name}", **BASES[name.partition(",")[0]], **(instead or {}), **EFFECTS[name]}
    return "".join(f"{key} = {json.dumps(value)}\n" for key, value in chosen.items())


def measured(
    name: str, seed: int, folder_of_set: Path, folder: Path, instead: Mapping[str, Any] | None = None
) -> Measured:
    """Train, or go on, or take what is finished, and return what came of it.

    Raises:
        WeightsError: the folder has a training of something else.
    """
    (folder / "recipes").mkdir(parents=True, exist_ok=True)
    file_name = name.replace(",", "").replace(" ", "-")
    recipe = folder / "recipes" / f"{file_name}.toml"
    recipe.write_text(recipe_text(name, instead))
    run = folder / "runs" / f"{file_name}-{seed}"
    if not is_finished(run / WEIGHTS_FILE):
        words = ["train", recipe, "--data", folder_of_set, "--seed", seed, "--out", run, "--device", "cpu"]
        subprocess.run([Path(sys.executable).with_name("symsol-annot"), *map(str, words)], check=True)
    record = read_record(run / WEIGHTS_FILE)
    if record.recipe != recipe_from_toml(recipe.read_text(), str(recipe)):
        raise WeightsError(f"{run}: is of another recipe than {recipe}; move it away to train anew")
    last = record.rows[-1]
    minutes = sum(row["processor_seconds"] for row in record.rows) / 60
    return Measured(
        round(record.calibration["f_measure"], 4),
        round(last["f_measure"], 4) if "f_measure" in last else None,
        round(last["log_likelihood_at_gt"], 3) if "log_likelihood_at_gt" in last else None,
        round(last["images_per_second"], 1),
        round(minutes, 2),
    )


def is_finished(weights: Path) -> bool:
    """Tell whether a training is there and finished."""
    return weights.is_file() and read_record(weights).is_finished


def known_results() -> dict[str, Any]:
    """Return what the file of results has: by name, the recipe and what came of each seed."""
    found: dict[str, Any] = json.loads(RESULTS.read_text()) if RESULTS.is_file() else {}
    return found


def is_known(name: str, seed: int) -> bool:
    """Tell whether the file of results has a training of this recipe and seed."""
    of_name = known_results().get(name, {})
    return of_name.get("recipe") == recipe_text(name) and str(seed) in of_name["seeds"]


def keep(name: str, seed: int, found: Measured, instead: Mapping[str, Any] | None = None) -> None:
    """Put what came of a training into the file of results, beside what was before of the same recipe."""
    known, recipe = known_results(), recipe_text(name, instead)
    if known.get(name, {}).get("recipe") != recipe:
        known[name] = {"recipe": recipe, "seeds": {}}
    known[name]["seeds"][str(seed)] = asdict(found)
    ordered = {one: known[one] for one in EFFECTS if one in known}
    write_atomically(RESULTS, (json.dumps(ordered, indent=1) + "\n").encode())


def table() -> str:
    """Return the table of the results as Markdown."""
    lines = ["| changed | F-measure | without the fit | log-likelihood | speed |", "|---|---|---|---|---|"]
    speeds = json.loads(SPEEDS.read_text())["training"] if SPEEDS.is_file() else {}
    for name, known in known_results().items():
        changes = ", ".join(f"`{key} = {json.dumps(value)}`" for key, value in EFFECTS[name].items()) or "nothing"
        figures = [Measured(**one) for one in known["seeds"].values()]
        told = [
            ", ".join(f"{value:.3f}" for value in values if value is not None)
            for values in zip(
                *((one.f_measure, one.unfitted_f_measure, one.log_likelihood) for one in figures), strict=True
            )
        ]
        speed = f"{speeds[name]['speed']:.2f}" if "speed" in speeds.get(name, {}) else ""
        lines.append(f"| {name.partition(',')[0]}: {changes} | {' | '.join(told)} | {speed} |")
    return "\n".join(lines) + "\n"


def write_table() -> None:
    """Put the table in its place on the page."""
    put_table(PAGE, Path(__file__).name, table())


if __name__ == "__main__":
    main()
