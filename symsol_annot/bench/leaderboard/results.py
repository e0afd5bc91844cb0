"""The files that docs/leaderboard.md is built from: image sets, results on them, and the thesis's own numbers.

    thesis.toml             the thesis's tables
    SET/set.toml            an image set: what makes it, and the fingerprints of its splits
    SET/NAME.toml           a result: who, how, on what
    SET/NAME.json           its scores, as `score --json` wrote them
    SET/reference/ROW.json  scores of a reference row, as `reference` wrote them; shown beside results, not ranked

A result is held against its set, and its figures against those of its images. Strangers send these files in: names,
numbers and shapes are checked here, words are escaped by who shows them.
"""

import datetime as dt
import math
import os
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, TypeVar

from symsol_annot.bench.models.recipe import builtin_recipes
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.scoring.metric_table import METRICS, Place, metrics_shown
from symsol_annot.bench.scoring.scores_file import figures_that_differ, read_scores
from symsol_annot.errors import ScoresError, bulleted, count_of
from symsol_annot.system.reading import read_text
from symsol_annot.system.text.names import OBJECT_NAME_RULE, SPLITS, is_object_name, is_split
from symsol_annot.system.text.tables import from_table


class _Checked(Protocol):
    """What a file says, as far as types go."""

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""


T = TypeVar("T", bound=_Checked)

THESIS, SET = "thesis.toml", "set.toml"
_SHOWN = 5  # differences of one object
_SHA256 = re.compile(r"[0-9a-f]{64}")
_NAME = re.compile(r"[A-Za-z0-9._-]+")  # as it stands in links and headings
_NAME_RULE = "a name has letters, digits, '.', '_' and '-' alone"
REFERENCE = "reference"
_MAX_BYTES = 2**18  # of a TOML file; the thesis's tables have 10 kB
_SHOWN_FAULTS = 20  # of one file


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

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        if self.images < 1:
            yield f"images: expected 1 or more, found {self.images}"
        if not is_split(self.split):
            yield f"split: expected one of {', '.join(SPLITS)}, found {shown(self.split)}"
        yield from (f"fingerprints: {fault}" for fault in _faults_of_objects(self.fingerprints))


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

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        if self.seed < 0:
            yield f"seed: expected 0 or more, found {self.seed}"
        for name, minutes in (("minutes", self.minutes), ("processor_minutes", self.processor_minutes)):
            if minutes is not None and not 0 <= minutes < math.inf:
                yield f"{name}: expected a finite number, 0 or more, found {minutes}"


@dataclass(frozen=True, kw_only=True)
class Run:
    """A result's own account of itself.

    Attributes:
        title: the method.
        by: who sends it in.
        date: of the scores.
        hardware: what the models were trained on.
        commands: from the set to the scores; none where `code` says how the predictions were made.
        recipe: of this package, if it was trained by one.
        code: where the method's code is, or what it is described in.
        notes: more in words.
        objects: object to training.
    """

    title: str
    by: str
    date: dt.date
    hardware: str
    commands: tuple[str, ...] = ()
    recipe: str = ""
    code: str = ""
    notes: str = ""
    objects: Mapping[str, Training]

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        for name in ("title", "by", "hardware"):
            if not getattr(self, name).strip():
                yield f"{name}: is empty"
        if not any(text.strip() for text in (*self.commands, self.code)):
            yield "commands, code: one of them has to say how the predictions were made"
        if self.recipe and self.recipe not in builtin_recipes():
            yield f"recipe: there is no {shown(self.recipe)} built in; leave it out"
        for name, training in self.objects.items():
            yield from (f"objects.{name}.{fault}" for fault in training.faults())


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


@dataclass(frozen=True)
class Reference:
    """A reference row on one set: of a method that knows the answer, half of it, or nothing.

    Attributes:
        name: of its file.
        method: what it is.
        scores: object to what scores.json says of it.
    """

    name: str
    method: str
    scores: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class ThesisTable:
    """A table of the thesis.

    Attributes:
        track, metric: the same in scores.json.
        objects: its columns.
        rows: recipe to a value per object; NaN where the thesis has none.
    """

    track: str
    metric: str
    objects: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        metrics = {track: [metric.name for metric in metrics_shown(track, Place.LEADERBOARD)] for track in METRICS}
        if self.track not in metrics:
            yield f"track: expected one of {', '.join(metrics)}, found {shown(self.track)}"
        elif self.metric not in metrics[self.track]:
            yield f"metric: expected one of {', '.join(metrics[self.track])}, found {shown(self.metric)}"
        yield from (f"objects: {fault}" for fault in _faults_of_objects(self.objects))
        for recipe, values in self.rows.items():
            if recipe not in builtin_recipes():
                yield f"rows: there is no recipe {shown(recipe)} built in"
            elif len(values) != len(self.objects):
                yield f"rows.{recipe}: expected a number per object, {len(self.objects)}, found {len(values)}"
            elif any(math.isinf(value) for value in values):
                yield f"rows.{recipe}: expected finite numbers, or nan where the thesis has none"


@dataclass(frozen=True, kw_only=True)
class Thesis:
    """The thesis's own numbers.

    Attributes:
        notes: on what they are, in Markdown.
        tables: by number and what they show.
        small: recipe to the one of the small tier that stands for it.
    """

    notes: str
    tables: Mapping[str, ThesisTable]
    small: Mapping[str, str]

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        for recipe, name in self.small.items():
            if name not in builtin_recipes():
                yield f"small.{recipe}: there is no recipe {shown(name)} built in"
        for title, table in self.tables.items():
            yield from (f"tables.{title}.{fault}" for fault in table.faults())


@dataclass(frozen=True)
class Leaderboard:
    """All of it.

    Attributes:
        sets: folder to image set.
        results: folder to the results on that set, by name.
        references: folder to the reference rows on that set, by name.
        thesis: its own numbers.
    """

    sets: Mapping[str, ImageSet]
    results: Mapping[str, tuple[Result, ...]]
    references: Mapping[str, tuple[Reference, ...]]
    thesis: Thesis


def read_leaderboard(folder: str | os.PathLike[str]) -> Leaderboard:
    """Read and check a leaderboard's folder.

    Raises:
        ScoresError: a file is missing, malformed or about other images, or a result does not rank; all faults at once.
    """
    folder = Path(folder)
    if not (folder / THESIS).is_file():
        raise ScoresError(f"{folder}: is no leaderboard's folder: it has no {THESIS}")
    thesis, faults = _read(folder / THESIS, Thesis, "the thesis's numbers")
    sets: dict[str, ImageSet] = {}
    results: dict[str, tuple[Result, ...]] = {}
    references: dict[str, tuple[Reference, ...]] = {}
    for place in _folders(folder):
        faults += [f"{folder}: {fault}" for fault in _faults_of_names([place.name])]
        image_set, found = _read(place / SET, ImageSet, "an image set")
        faults += found
        if image_set is not None:
            sets[place.name] = image_set
            results[place.name], of_results = _results(place, image_set)
            references[place.name], of_references = _references(place, image_set)
            faults += of_results + of_references
    faults += _doubled(results)
    if faults or thesis is None:
        raise ScoresError(f"{folder}: the leaderboard has {count_of(faults)}:\n" + bulleted(faults))
    return Leaderboard(sets, results, references, thesis)


def _faults_of_names(names: Iterable[str]) -> Iterator[str]:
    """Say which names of files cannot stand on a page as they are."""
    yield from (f"{shown(name)}: {_NAME_RULE}" for name in names if not _NAME.fullmatch(name))


def _faults_of_objects(names: Iterable[str]) -> Iterator[str]:
    """Say which names are no object's."""
    yield from (f"{shown(name)}: an object's name has {OBJECT_NAME_RULE}" for name in names if not is_object_name(name))


def _folders(folder: Path) -> list[Path]:
    """Return the folders in one, by name; what begins with a dot is the system's."""
    try:
        return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise ScoresError(f"{folder}: cannot be read: {error.strerror}") from None


def _names_in(folder: Path, endings: set[str]) -> list[str]:
    """Return the names of the files in a folder that have one of the endings, without it."""
    try:
        found = {p.stem for p in folder.iterdir() if p.suffix in endings and not p.name.startswith(".")}
    except OSError as error:
        raise ScoresError(f"{folder}: cannot be read: {error.strerror}") from None
    return sorted(found)


def _read(path: Path, kind: type[T], what: str) -> tuple[T | None, list[str]]:
    """Return a TOML file as a dataclass, or None, and its faults with the file's name."""
    try:
        made, faults = from_table(kind, tomllib.loads(read_text(path, _MAX_BYTES)), what)
    except OSError as error:
        return None, [f"{path}: cannot be read: {error.strerror or error}"]
    except (ValueError, RecursionError) as error:  # RecursionError: lists in lists in lists
        return None, [f"{path}: cannot be read: {error}"]
    if made is not None:
        faults += made.faults()
    more = [f"{len(faults) - _SHOWN_FAULTS} faults more"] if len(faults) > _SHOWN_FAULTS else []
    return made, [f"{path}: {fault}" for fault in [*faults[:_SHOWN_FAULTS], *more]]


def _results(place: Path, image_set: ImageSet) -> tuple[tuple[Result, ...], list[str]]:
    """Return the results on a set, and the faults of their files."""
    names = [name for name in _names_in(place, {".toml", ".json"}) if f"{name}.toml" != SET]
    results, faults = [], [f"{place}: {fault}" for fault in _faults_of_names(names)]
    for name in names:
        run, found = _read(place / f"{name}.toml", Run, "a result")
        try:
            scores = read_scores(place / f"{name}.json")
        except ScoresError as error:
            found.append(str(error))
            scores = {}
        if run is not None and scores:
            of_scores = [*_faults_of_ranks(scores), *_faults_of_scores(scores, image_set)]
            found += [f"{place / name}.json: {fault}" for fault in of_scores]
            found += [f"{place / name}.toml: {fault}" for fault in _faults_of_run(run, scores["objects"])]
            results.append(Result(name, run, scores["objects"]))
        faults += found
    return tuple(results), faults


def _references(place: Path, image_set: ImageSet) -> tuple[tuple[Reference, ...], list[str]]:
    """Return the reference rows on a set, and the faults of their files."""
    folder = place / REFERENCE
    if not folder.is_dir():
        return (), []
    names = _names_in(folder, {".json"})
    rows, faults = [], [f"{folder}: {fault}" for fault in _faults_of_names(names)]
    for name in names:
        try:
            scores = read_scores(folder / f"{name}.json")
        except ScoresError as error:
            faults.append(str(error))
            continue
        faults += [f"{folder / name}.json: {fault}" for fault in _faults_of_scores(scores, image_set)]
        rows.append(Reference(name, scores["method"], scores["objects"]))
    return tuple(rows), faults


def _faults_of_ranks(scores: Mapping[str, Any]) -> Iterator[str]:
    """Say why scores do not rank."""
    if scores.get("ranks") is not True:
        yield "'ranks' is not true: `score` warned of something, so it does not rank"
    for name, entry in scores["objects"].items():
        tracks = [track for track in METRICS if track in entry]
        yield from (f"objects.{name}.{track}.warnings: does not rank" for track in tracks if entry[track]["warnings"])


def _faults_of_scores(scores: Mapping[str, Any], image_set: ImageSet) -> Iterator[str]:
    """Say why scores are of other images, or do not follow from their images' figures."""
    for name, entry in scores["objects"].items():
        wanted = {"split": image_set.split, "images": image_set.images, "fingerprint": image_set.fingerprints.get(name)}
        for what, expected in wanted.items():
            if entry[what] != expected:
                found = shown(entry[what])
                yield f"objects.{name}.{what}: expected {expected}, found {found}: it is about other images"
        if not _sha256_of(entry):
            yield f"objects.{name}.predictions.sha256: is no SHA-256"
        tracks = [track for track in METRICS if track in entry]
        if not tracks:
            yield f"objects.{name}: has no track"
        yield from (f"objects.{name}.per_image.{metric}: is missing" for metric in _missing(entry, tracks))
        yield from (f"objects.{name}.{difference}" for difference in islice(figures_that_differ(entry), _SHOWN))


def _missing(entry: Mapping[str, Any], tracks: Iterable[str]) -> Iterator[str]:
    """Yield which metrics of the page an object's scores lack; without them a bad figure could be left out."""
    for track in tracks:
        names = [metric.name for metric in metrics_shown(track, Place.LEADERBOARD)]
        yield from (f"{track}.{name}" for name in names if name not in entry["per_image"][track])


def _faults_of_run(run: Run, scores: Mapping[str, Any]) -> Iterator[str]:
    if set(run.objects) != set(scores):
        found = ", ".join(name if is_object_name(name) else shown(name) for name in run.objects) or "none"
        yield f"objects: expected those of the scores, {', '.join(scores)}, found {found}"


def _doubled(results: Mapping[str, tuple[Result, ...]]) -> Iterator[str]:
    """Say which predictions are there more than once."""
    first: dict[str, str] = {}
    for folder, of_set in results.items():
        for result in of_set:
            for entry in result.scores.values():
                sha256, name = _sha256_of(entry), f"{folder}/{result.name}"
                if sha256 in first:
                    yield f"{name}: its predictions {sha256[:12]}.. are those of {first[sha256]}"
                if sha256:
                    first.setdefault(sha256, name)


def _sha256_of(entry: Mapping[str, Any]) -> str:
    """Return the SHA-256 of the predictions that an object's scores are of; "" where they do not say it."""
    predictions = entry.get("predictions")
    found = predictions.get("sha256") if isinstance(predictions, dict) else None
    return found if isinstance(found, str) and _SHA256.fullmatch(found) else ""
