"""Makes a row of the leaderboard: .venv/bin/python docs/baselines.py ROW [--tier TIER] [--object NAME] [--seed SEED].

Trains, predicts and scores a recipe, or `retrieval`, which needs no training, by the commands that the result's TOML
then names, and writes ROW.toml and ROW.json.gz to docs/results/leaderboard/TIER; of another seed than 0,
ROW-seed-SEED, which the board merges with ROW.
Re-running the command resumes it. Whatever is finished is not done again, on whichever machine it was done: a folder
runs/OBJECT-ROW or a file OBJECT-ROW.h5 that is put into the working folder is taken as it is. Sets are looked for in
its folder `data` (`small` of the small tier), which may have links to them, and rendered where they are not there.
The scores are of all objects that have predictions. Objects that the result has already, and that have no predictions
in the working folder, keep theirs. Notes that somebody wrote into a result's file are kept.
"""

import argparse
import datetime as dt
import json
import signal
import subprocess
import sys
import time
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any

from baseline_rows import TIERS, BaselineError, Row, row_of

import symsol_annot
from symsol_annot.bench.leaderboard.results import SET
from symsol_annot.bench.models.devices import choose_device, hardware
from symsol_annot.bench.models.retrieval import retrieval
from symsol_annot.bench.models.training.checkpoints import read_record
from symsol_annot.bench.models.training.record import TrainingRecord
from symsol_annot.bench.scoring.reports.scores_file import read_scores, write_scores
from symsol_annot.errors import DataError, SymsolError
from symsol_annot.sets.dataset import load
from symsol_annot.system.files import write_atomically
from symsol_annot.system.reading import file_sha256

WORK = Path(__file__).resolve().parent.parent / "build" / "baselines"
STEPS = ("render", "train", "predict", "score", "write")


def main() -> None:
    """Run what is asked for; an error is one message."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("row", help="a recipe, as `symsol-annot train --list` has them, or retrieval")
    parser.add_argument("--tier", choices=list(TIERS), help="[default: small for small-..., else published]")
    parser.add_argument("--object", action="append", help="may be repeated  [default: those of the row]")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--folder", type=Path, help="the working folder  [default: build/baselines/TIER]")
    parser.add_argument("--only", choices=STEPS, action="append", help="one step; may be repeated")
    options = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))  # so that a step's note is written
    tier = options.tier or ("small" if options.row.startswith("small-") else "published")
    folder = options.folder or WORK / tier
    try:
        make(row_of(options.row, tier, options.seed, folder), options.object, options.only or STEPS)
    except SymsolError as error:
        sys.exit(f"Error: {error}")
    except subprocess.CalledProcessError as error:
        sys.exit(error.returncode)


def make(row: Row, objects: list[str] | None, steps: tuple[str, ...] | list[str]) -> None:
    """Do steps of a row for some objects, or for all that it has."""
    if unknown := sorted(set(objects or []) - set(row.fingerprints())):
        raise BaselineError(f"--object {unknown[0]}: the {row.tier} tier has {', '.join(row.fingerprints())}")
    row.folder.mkdir(parents=True, exist_ok=True)
    for name in objects or row.objects():
        for step, do in (("render", render), ("train", train), ("predict", predict)):
            if step in steps:
                do(row, name)
    if "score" in steps:
        score(row)
    if "write" in steps:
        write(row)


def run(folder: Path, words: list[str]) -> None:
    """Run a command in a folder, and show it."""
    print("$", " ".join(words), flush=True)
    subprocess.run([Path(sys.executable).with_name(words[0]), *words[1:]], cwd=folder, check=True)


def render(row: Row, name: str) -> None:
    """Render an object's set, unless it is there; it has to be the one that the leaderboard is about."""
    place = row.folder / row.data / name
    if not is_rendered(place):
        commands = tomllib.loads((row.place / SET).read_text())["commands"]
        run(row.folder, next(words for line in commands if name in (words := line.split())))
    if load(place, "test").fingerprint != row.fingerprints()[name]:
        raise BaselineError(f"{place}: its test split is not that of {row.place / SET}; move it away to render it anew")


def is_rendered(place: Path) -> bool:
    """Tell whether a set's test split is there and whole."""
    try:
        load(place, "test")
    except DataError:
        return False
    return True


def train(row: Row, name: str) -> None:
    """Train on an object, from where an earlier run was stopped, unless the row needs no training."""
    if not row.is_trained:
        return
    file = row.weights(name)
    if not file.is_file() or not read_record(file).is_finished:
        run(row.folder, row.train_command(name))


def predict(row: Row, name: str) -> None:
    """Predict an object's test images, unless that was done from what there is now, or somewhere else."""
    if row.is_trained:
        finished_record(row, name)
    path, note, made_from = row.predictions(name), row.note(f"{name}-predict"), row.made_from(name)
    known = read_note(note)
    is_by_these = known.get("made_from", made_from) == made_from
    is_whole = known.get("is_whole", True)  # what comes from elsewhere is; tracks are written one after another
    if path.is_file() and is_by_these and is_whole:
        return
    if not is_by_these:
        path.unlink(missing_ok=True)
    start, before, is_whole = time.monotonic(), known.get("minutes", 0.0) if is_by_these else 0.0, False
    try:
        run(row.folder, row.predict_command(name))
        is_whole = True
    finally:  # what was answered before an interruption is kept, so its time counts
        spent = before + (time.monotonic() - start) / 60
        device = hardware(choose_device("auto"))
        write_note(note, {"made_from": made_from, "minutes": spent, "device": device, "is_whole": is_whole})


def score(row: Row) -> None:
    """Score all predictions that there are, unless these were scored."""
    names = row.predicted()
    if not names:
        raise BaselineError(f"{row.folder}: has no predictions of {row.name} to score")
    if row.scores.is_file():
        scored = {name: entry["predictions"]["sha256"] for name, entry in read_scores(row.scores)["objects"].items()}
        if scored == {name: file_sha256(row.predictions(name)) for name in names}:
            return
    start = time.monotonic()
    run(row.folder, row.score_command(names))
    today = dt.datetime.now(tz=dt.UTC).date()
    write_note(row.note("score"), {"minutes": (time.monotonic() - start) / 60, "date": today.isoformat()})


def write(row: Row) -> None:
    """Write the result's files."""
    if not row.scores.is_file():
        raise BaselineError(f"{row.scores}: is missing; --only score makes it")
    scores, earlier = read_scores(row.scores), read_earlier(row)
    there = {**earlier.scores, **scores["objects"]}
    scored = {name: entry["predictions"]["sha256"] for name, entry in scores["objects"].items()}
    text = result(row, scored, earlier)
    ordered = {name: there[name] for name in row.fingerprints() if name in there}
    write_scores(row.place / row.scores.name, {**scores, "objects": ordered})
    write_atomically(row.place / f"{row.name}.toml", text.encode())
    print(
        f"{row.place / row.name}.toml\nNext:\n  symsol-annot leaderboard {row.place.parent} --out docs/leaderboard.md"
    )


@dataclass(frozen=True)
class Earlier:
    """A result that was written before: its account as TOML has it, and the scores of its objects."""

    account: Mapping[str, Any]
    scores: Mapping[str, Any]


def read_earlier(row: Row) -> Earlier:
    """Return the result of the row that the board has; an empty one where it has none."""
    account, scores = row.place / f"{row.name}.toml", row.place / row.scores.name
    if not account.is_file() or not scores.is_file():
        return Earlier({}, {})
    return Earlier(tomllib.loads(account.read_text()), read_scores(scores)["objects"])


def finished_record(row: Row, name: str) -> TrainingRecord:
    """Return what a checkpoint says of its training, which has to be of this row and finished."""
    file = row.weights(name)
    record = read_record(file)
    wanted = {"recipe": row.recipe, "object": name, "seed": row.seed}
    for what, found in {"recipe": record.name, "object": record.object, "seed": record.seed}.items():
        if found != wanted[what]:
            raise BaselineError(f"{file}: {what}: expected {wanted[what]!r}, found {found!r}")
    if not record.is_finished:
        raise BaselineError(f"{file}: has {record.epochs_done} epochs of {record.epochs}; --only train resumes it")
    return record


def result(row: Row, digests: Mapping[str, str], earlier: Earlier) -> str:
    """Return the result's TOML, from what the checkpoints say of their trainings.

    Args:
        row: whose.
        digests: of the predictions that were scored, by object.
        earlier: the result of the same row, of which objects that were not scored are kept.
    """
    kept = {name: table for name, table in earlier.account.get("objects", {}).items() if name not in digests}
    names = [name for name in row.fingerprints() if name in digests or name in kept]
    records = {name: finished_record(row, name) for name in digests} if row.is_trained else {}
    scored, predicted = read_note(row.note("score")), {name: read_note(row.note(f"{name}-predict")) for name in digests}
    made_by = (row.train_command, row.predict_command) if row.is_trained else (row.predict_command,)
    before_by = commands_of_objects(earlier)
    by = {name: before_by[name] if name in kept else [" ".join(words(name)) for words in made_by] for name in names}
    before, now = earlier.account["hardware"] if kept else "", hardware_in_words(records, predicted)
    head = {
        "title": row.title,
        "by": "symsol-annot",
        "hardware": before if now in before else "; ".join(filter(None, [before, now])),
        **({"recipe": row.recipe} if row.is_trained else {}),
        "method": row.method,
        "input_px": input_px(records) if row.is_trained else retrieval.DEFAULT_SIZE,
        **row.knowledge(),
        "commands": [*chain.from_iterable(by.values()), " ".join(row.score_command(names))],
    }
    lines = [f"{key} = {json.dumps(value, indent=4, ensure_ascii=False)}" for key, value in head.items()]
    lines += (
        [f"score_minutes = {total:.1f}"] if (total := score_minutes(scored, digests, earlier, kept)) is not None else []
    )
    lines += [
        *notes_of(earlier.account),
        f"date = {scored.get('date', dt.datetime.now(tz=dt.UTC).date())}",
    ]
    for name in names:
        if name in kept:
            lines += [f"\n[objects.{name}]", *(f"{key} = {json.dumps(kept[name][key])}" for key in kept[name])]
            continue
        lines += [f"\n[objects.{name}]", *training_lines(records.get(name), predicted[name])]
        lines += [f'predictions_sha256 = "{digests[name]}"']
    return "\n".join(lines) + "\n"


def commands_of_objects(earlier: Earlier) -> dict[str, list[str]]:
    """Return the commands that an earlier result names for each of its objects: all but the last, which scores."""
    names, lines = list(earlier.account.get("objects", {})), earlier.account.get("commands", [])[:-1]
    each = len(lines) // max(1, len(names))
    return {name: lines[k * each : (k + 1) * each] for k, name in enumerate(names)}


def training_lines(record: TrainingRecord | None, predicted: Mapping[str, Any]) -> list[str]:
    """Return the lines about how an object's model came to be, None where nothing was trained, and predicted."""
    lines = ["seed = 0", "minutes = 0.0", "processor_minutes = 0.0"]
    if record is not None:
        lines = [f"seed = {record.seed}", f"minutes = {minutes(record, 'seconds'):.1f}"]
        lines += [f"processor_minutes = {minutes(record, 'processor_seconds'):.1f}"]
    lines += [f"predict_minutes = {predicted['minutes']:.1f}"] if predicted else []
    if record is not None:
        lines += [f"first_stage = {json.dumps(record.first_stage.partition(', sha256')[0], ensure_ascii=False)}"]
    return lines


def minutes(record: TrainingRecord, what: str) -> float:
    """Return how many minutes the epochs took, by one of their figures in seconds."""
    return sum(row.get(what, 0.0) for row in record.rows) / 60


def hardware_in_words(records: Mapping[str, TrainingRecord], predicted: Mapping[str, Mapping[str, Any]]) -> str:
    """Return what the models were trained on, and what predicted where that was another device, or all there was."""
    elsewhere = {name: note["device"] for name, note in predicted.items() if note}
    if not records:
        return f"{in_words(elsewhere)}; symsol-annot {symsol_annot.__version__}"
    trained = in_words({name: device_of(record) for name, record in records.items()})
    versions = sorted(
        {f"torch {r.software['torch']}, symsol-annot {r.software['symsol-annot']}" for r in records.values()}
    )
    other = {name: device for name, device in elsewhere.items() if not device_of(records[name]).endswith(device)}
    predicting = f"; predicting on {in_words(other)}" if other else ""
    return f"{trained}{predicting}; {'; '.join(versions)}"


def device_of(record: TrainingRecord) -> str:
    """Return the device of a training, without torch's name of its kind."""
    kind, _, device = record.software["device"].partition(" ")
    return device if kind == "cpu" else f"GPU {device}"


def in_words(devices: Mapping[str, str]) -> str:
    """Return the device of all objects, or each with its objects where there are several."""
    kinds = list(dict.fromkeys(devices.values()))
    if len(kinds) == 1:
        return kinds[0]
    return "; ".join(f"{', '.join(n for n, d in devices.items() if d == kind)} on {kind}" for kind in kinds)


def input_px(records: Mapping[str, TrainingRecord]) -> int:
    """Return the side of the images that the networks read."""
    sides = {record.recipe.input_size or record.image_size[0] for record in records.values()}
    return max(sides)


def score_minutes(
    scored: Mapping[str, Any], digests: Mapping[str, str], earlier: Earlier, kept: Mapping[str, Any]
) -> float | None:
    """Return how long scoring all objects of a result took; None where that is not known."""
    known = {name: table["predictions_sha256"] for name, table in earlier.account.get("objects", {}).items()}
    if kept and all(known.get(name) == digest for name, digest in digests.items()):
        return earlier.account.get("score_minutes")  # it is written again
    if "minutes" not in scored:
        return None
    if not kept:
        return float(scored["minutes"])
    is_known = len(kept) == len(earlier.account["objects"]) and "score_minutes" in earlier.account
    return float(scored["minutes"] + earlier.account["score_minutes"]) if is_known else None


def notes_of(known: Mapping[str, Any]) -> list[str]:
    """Return the line of notes of a result's account; none where it has none."""
    return [f"notes = {json.dumps(known['notes'], ensure_ascii=False)}"] if "notes" in known else []


def read_note(path: Path) -> dict[str, Any]:
    """Return what is kept of a finished step; nothing of one that was finished on another machine."""
    found: dict[str, Any] = json.loads(path.read_text()) if path.is_file() else {}
    return found


def write_note(path: Path, found: Mapping[str, Any]) -> None:
    """Keep what a finished step found."""
    path.parent.mkdir(exist_ok=True)
    write_atomically(path, json.dumps(found).encode())


if __name__ == "__main__":
    main()
