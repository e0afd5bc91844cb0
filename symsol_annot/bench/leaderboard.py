"""The files that docs/leaderboard.md is built from: image sets, results on them, and the thesis's own numbers.

    thesis.toml             the thesis's tables
    SET/set.toml            an image set: what makes it, and the fingerprints of its splits
    SET/NAME.toml           a result: who, how, on what
    SET/NAME.json           its scores, as `score --json` wrote them

A result is held against its set, and its figures against those of its images.
"""

import datetime as dt
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, TypeVar

from symsol_annot.bench.recipe import builtin_recipes
from symsol_annot.bench.report import TABLE
from symsol_annot.bench.scores_file import figures_that_differ, read_scores
from symsol_annot.bench.tables import from_table
from symsol_annot.errors import ScoresError, bulleted, count_of

T = TypeVar("T")

THESIS, SET = "thesis.toml", "set.toml"
_SHOWN = 5  # differences of one object
_SHA256 = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, kw_only=True)
class ImageSet:
    """What results are about.

    Attributes:
        title: in words.
        split: which.
        images: how many that has of each object.
        commands: what makes the set.
        fingerprints: object to that of its split.
        notes: more in words.
    """

    title: str
    split: str
    images: int
    commands: tuple[str, ...]
    fingerprints: Mapping[str, str]
    notes: str = ""


@dataclass(frozen=True, kw_only=True)
class Training:
    """How the model of one object came to be.

    Attributes:
        seed: of the training.
        minutes: it took.
        processor_minutes: of the host's processor, in all threads; None where not known.
        first_stage: what it began with, where that was trained before.
    """

    seed: int
    minutes: float
    processor_minutes: float | None = None
    first_stage: str = ""


@dataclass(frozen=True, kw_only=True)
class Run:
    """A result's own account of itself.

    Attributes:
        title: the method.
        by: who sends it in.
        date: of the scores.
        hardware: what the models were trained on.
        commands: from the set to the scores.
        recipe: of this package, if it was trained by one.
        code: where the method's code is, or what it is described in.
        notes: more in words.
        objects: object to training.
    """

    title: str
    by: str
    date: dt.date
    hardware: str
    commands: tuple[str, ...]
    recipe: str = ""
    code: str = ""
    notes: str = ""
    objects: Mapping[str, Training]


@dataclass(frozen=True)
class Result:
    """One result on one set.

    Attributes:
        name: of its files.
        run: how it came to be.
        scores: object to what scores.json says of it.
    """

    name: str
    run: Run
    scores: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class ThesisTable:
    """A table of the thesis.

    Attributes:
        track, metric: the same in scores.json.
        objects: its columns.
        rows: recipe to a value an object; NaN where the thesis has none.
    """

    track: str
    metric: str
    objects: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]


@dataclass(frozen=True, kw_only=True)
class Thesis:
    """The thesis's own numbers.

    Attributes:
        notes: on what they are.
        tables: by number and what they show.
        small: recipe to the one of the small tier that stands for it.
    """

    notes: str
    tables: Mapping[str, ThesisTable]
    small: Mapping[str, str]


@dataclass(frozen=True)
class Leaderboard:
    """All of it.

    Attributes:
        sets: folder to image set.
        results: folder to the results on that set, by name.
        thesis: its own numbers.
    """

    sets: Mapping[str, ImageSet]
    results: Mapping[str, tuple[Result, ...]]
    thesis: Thesis


def read_leaderboard(folder: Path) -> Leaderboard:
    """Read and check a leaderboard's folder.

    Raises:
        ScoresError: a file is missing, malformed or about other images, or a result does not rank; all faults at once.
    """
    if not (folder / THESIS).is_file():
        raise ScoresError(f"{folder}: is no leaderboard's folder: it has no {THESIS}")
    thesis, faults = _read(folder / THESIS, Thesis, "the thesis's numbers")
    sets: dict[str, ImageSet] = {}
    results: dict[str, tuple[Result, ...]] = {}
    for place in sorted(path for path in folder.iterdir() if path.is_dir()):
        image_set, found = _read(place / SET, ImageSet, "an image set")
        faults += found
        if image_set is not None:
            sets[place.name] = image_set
            results[place.name], found = _results(place, image_set)
            faults += found
    faults += _doubled(results)
    if faults or thesis is None:
        count = count_of(faults)
        raise ScoresError(f"{folder}: the leaderboard has {count}:\n" + bulleted(faults))
    return Leaderboard(sets, results, thesis)


def _read(path: Path, kind: type[T], what: str) -> tuple[T | None, list[str]]:
    """Return a TOML file as a dataclass, or None, and its faults with the file's name."""
    try:
        made, faults = from_table(kind, tomllib.loads(path.read_text(encoding="utf-8")), what)
    except (OSError, UnicodeError, tomllib.TOMLDecodeError) as error:
        return None, [f"{path}: cannot be read: {error}"]
    return made, [f"{path}: {fault}" for fault in faults]


def _results(place: Path, image_set: ImageSet) -> tuple[tuple[Result, ...], list[str]]:
    """Return the results on a set, and the faults of their files."""
    names = sorted({path.stem for path in place.iterdir() if path.suffix in {".toml", ".json"} and path.name != SET})
    results, faults = [], []
    for name in names:
        run, found = _read(place / f"{name}.toml", Run, "a result")
        try:
            scores = read_scores(place / f"{name}.json")
        except ScoresError as error:
            found.append(str(error))
            scores = {}
        if run is not None and scores:
            found += [f"{place / name}.json: {fault}" for fault in _faults_of_scores(scores, image_set)]
            found += [f"{place / name}.toml: {fault}" for fault in _faults_of_run(run, scores["objects"])]
            results.append(Result(name, run, scores["objects"]))
        faults += found
    return tuple(results), faults


def _faults_of_scores(scores: Mapping[str, Any], image_set: ImageSet) -> Iterator[str]:
    """Say why scores do not rank, or are of other images, or do not follow from their images' figures."""
    if scores.get("ranks") is not True:
        yield "'ranks' is not true: `score` warned of something, so it does not rank"
    for name, entry in scores["objects"].items():
        wanted = {"split": image_set.split, "images": image_set.images, "fingerprint": image_set.fingerprints.get(name)}
        for what, expected in wanted.items():
            if entry[what] != expected:
                yield f"objects.{name}.{what}: expected {expected}, found {entry[what]!r}: it is about other images"
        if not _SHA256.fullmatch(str(_of(entry, "predictions", "sha256"))):
            yield f"objects.{name}.predictions.sha256: is no SHA-256"
        tracks = [track for track in TABLE if track in entry]
        if not tracks:
            yield f"objects.{name}: has no track"
        yield from (f"objects.{name}.{track}.warnings: does not rank" for track in tracks if entry[track]["warnings"])
        yield from (f"objects.{name}.{difference}" for difference in islice(figures_that_differ(entry), _SHOWN))


def _faults_of_run(run: Run, scores: Mapping[str, Any]) -> Iterator[str]:
    if set(run.objects) != set(scores):
        yield f"objects: expected those of the scores, {', '.join(scores)}, found {', '.join(run.objects) or 'none'}"
    for name in ("title", "by", "hardware"):
        if not getattr(run, name).strip():
            yield f"{name}: is empty"
    if not run.commands and not run.code:
        yield "commands, code: one of them has to say how the predictions were made"
    if run.recipe and run.recipe not in builtin_recipes():
        yield f"recipe: there is no {run.recipe!r} built in; leave it out"


def _doubled(results: Mapping[str, tuple[Result, ...]]) -> Iterator[str]:
    """Say which predictions are there more than once."""
    first: dict[str, str] = {}
    for folder, of_set in results.items():
        for result in of_set:
            for entry in result.scores.values():
                sha256, name = str(_of(entry, "predictions", "sha256")), f"{folder}/{result.name}"
                if sha256 in first:
                    yield f"{name}: its predictions {sha256[:12]}.. are those of {first[sha256]}"
                first.setdefault(sha256, name)


def _of(table: Any, *keys: str) -> Any:
    for key in keys:
        table = table.get(key) if isinstance(table, dict) else None
    return table
