"""Makes docs/results/leaderboard/small: .venv/bin/python docs/baselines.py FOLDER [--only STEP] [--object NAME].

Renders, trains, predicts and scores the small tier in FOLDER, by the commands that the results then name. The same
command resumes. Notes that somebody wrote into a result's file are kept. With OMP_NUM_THREADS=1 two
objects may be trained at once, one on each core.
"""

import argparse
import datetime as dt
import json
import subprocess
import sys
import tomllib
from pathlib import Path

from symsol_annot import __version__
from symsol_annot.bench.leaderboard.results import SET
from symsol_annot.bench.models.recipe import load_recipe
from symsol_annot.bench.models.training.checkpoints import WEIGHTS_FILE, read_record
from symsol_annot.sets.dataset import load

OBJECTS = ("cylO", "tetX")
RECIPES = {  # with the objects that they are trained on
    **dict.fromkeys(("small-wta", "small-rwta", "small-ewta", "small-classifier"), OBJECTS),
    **dict.fromkeys(("small-classifier-no-encoding", "small-classifier-no-pretraining"), OBJECTS),
    "small-classifier-k1024": OBJECTS,
    **dict.fromkeys(("small-classifier-hard-negatives", "small-classifier-f5", "small-classifier-longer"), ("tetX",)),
}
SIZE = 64  # of the images, which the networks read as they are
PLACE = Path(__file__).resolve().parent / "results" / "leaderboard" / "small"


def render_command(name):
    """Return the words that render an object's set."""
    counts = ["--train", "20000", "--test", "500", "--size", str(SIZE)]
    return ["symsol-annot", "render", "--object", name, *counts, "--out", "small"]


def train_command(recipe, name):
    """Return the words that train a recipe on an object."""
    return ["symsol-annot", "train", recipe, "--data", "small", "--object", name]


def predict_command(recipe, name):
    """Return the words that predict the test images."""
    run = f"{name}-{recipe}"
    return ["symsol-annot", "predict", f"runs/{run}", "--data", "small", "--out", f"{run}.h5"]


def score_command(recipe):
    """Return the words that score a recipe's predictions."""
    files = [f"{name}-{recipe}.h5" for name in RECIPES[recipe]]
    return ["symsol-annot", "score", *files, "--data", "small", "--json", f"{recipe}.json"]


def main():
    """Run what is asked for, and write the results' files."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", choices=("render", "train", "score"))
    parser.add_argument("--object", choices=OBJECTS)
    options = parser.parse_args()
    options.folder.mkdir(parents=True, exist_ok=True)
    for name in [options.object] if options.object else OBJECTS:
        if options.only in (None, "render"):
            run(options.folder, render_command(name))
        if options.only in (None, "train"):
            for recipe in (recipe for recipe, names in RECIPES.items() if name in names):
                run(options.folder, train_command(recipe, name))
    if options.only in (None, "score"):
        for recipe, names in RECIPES.items():
            score(options.folder, recipe, names)
        (PLACE / SET).write_text(image_set(options.folder))


def run(folder, words):
    """Run a command in a folder, and show it."""
    print("$", " ".join(words), flush=True)
    subprocess.run([Path(sys.executable).with_name(words[0]), *words[1:]], cwd=folder, check=True)


def score(folder, recipe, names):
    """Predict what is not predicted yet, score it, and write the result's files."""
    for name in names:
        if not (folder / f"{name}-{recipe}.h5").exists():
            run(folder, predict_command(recipe, name))
    run(folder, score_command(recipe))
    (PLACE / f"{recipe}.json").write_bytes((folder / f"{recipe}.json").read_bytes())
    (PLACE / f"{recipe}.toml").write_text(result(recipe, folder))


def result(recipe, folder):
    """Return the result's TOML, from what the checkpoints say of their trainings."""
    names = RECIPES[recipe]
    records = {name: read_record(folder / "runs" / f"{name}-{recipe}" / WEIGHTS_FILE) for name in names}
    words = [f(recipe, name) for name in names for f in (train_command, predict_command)]
    first, file = records[names[0]], load_recipe(recipe)
    has_negatives = any(file.for_object(name, has_marking=True).needs_rejected_candidates for name in names)
    head = {
        "title": file.title.partition(", small")[0],
        "by": f"symsol-annot {__version__}",
        "hardware": f"{first.software['device'].removeprefix('cpu ')}, no GPU; torch {first.software['torch']}",
        "recipe": recipe,
        "method": recipe,
        "input_px": SIZE,
        "given_group": has_negatives,  # rejected candidates are those of the body's group
        "given_sets": has_negatives,
        "commands": [" ".join(command) for command in (*words, score_command(recipe))],
    }
    lines = [f"{key} = {json.dumps(value, indent=4)}" for key, value in head.items()]
    lines += [*notes_of(PLACE / f"{recipe}.toml"), f"date = {dt.datetime.now(tz=dt.UTC).date()}"]
    for name, record in records.items():
        seconds = {what: sum(row[what] for row in record.rows) for what in ("seconds", "processor_seconds")}
        began = record.first_stage.partition(", sha256")[0]
        lines += [
            f"\n[objects.{name}]",
            f"seed = {record.seed}",
            f"minutes = {seconds['seconds'] / 60:.1f}",
            f"processor_minutes = {seconds['processor_seconds'] / 60:.1f}",
            f"first_stage = {json.dumps(began)}",
        ]
    return "\n".join(lines) + "\n"


def notes_of(path):
    """Return the line of notes that a TOML file has; none where there is no file or none in it."""
    known = tomllib.loads(path.read_text()) if path.exists() else {}
    return [f"notes = {json.dumps(known['notes'], ensure_ascii=False)}"] if "notes" in known else []


def image_set(folder):
    """Return the set's TOML."""
    tests = {name: load(folder / "small" / name, "test") for name in OBJECTS}
    lines = [
        'title = "Small: 64x64 images, for a CPU"',
        'split = "test"',
        f"images = {len(tests[OBJECTS[0]])}",
        f"commands = {json.dumps([' '.join(render_command(name)) for name in OBJECTS], indent=4)}",
        *notes_of(PLACE / SET),
        "\n[fingerprints]",
        *(f'{name} = "{test.fingerprint}"' for name, test in tests.items()),
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    main()
