"""What the files of a leaderboard say: image sets, results on them, reference rows, and the thesis's own numbers.

Anybody may send such files in: names, numbers and shapes are checked here, words are escaped by who shows them.
"""

import datetime as dt
import math
import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final

from symsol_annot.bench.models.recipe import builtin_recipes
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.system.text.names import OBJECT_NAME_RULE, SPLITS, is_object_name, is_split

_ADDRESS = re.compile(r"https://[A-Za-z0-9][A-Za-z0-9._~:/?#@&+,;=%-]{3,500}")  # as it stands in a link of Markdown
_SHA256 = re.compile(r"[0-9a-f]{64}")
_LARGEST_INPUT_PX: Final = 2**14
HOW_IT_WAS_MADE = (
    "commands, code: one of them has to say how the predictions were made: `commands`, a list of what was run, or "
    "`code`, an address that begins with https://"
)


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
        predict_minutes: to predict the test images; None where not told.
        first_stage: what it began with, where that was trained before.
        predictions_sha256: of the predictions file, which has to be that of the scores; empty where not told.
    """

    seed: int
    minutes: float
    processor_minutes: float | None = None
    predict_minutes: float | None = None
    first_stage: str = ""
    predictions_sha256: str = ""

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        if self.seed < 0:
            yield f"seed: expected 0 or more, found {self.seed}"
        yield from _faults_of_minutes(self, "minutes", "processor_minutes", "predict_minutes")
        if self.predictions_sha256 and not _SHA256.fullmatch(self.predictions_sha256):
            yield f"predictions_sha256: expected 64 hexadecimal digits, found {shown(self.predictions_sha256)}"


@dataclass(frozen=True, kw_only=True)
class Account:
    """A result's own account of itself.

    Attributes:
        title: the method.
        by: who sends it in.
        date: of the scores.
        hardware: what the models were trained on.
        score_minutes: to score the predictions about all objects; None where not told.
        commands: from the set to the scores; none where `code` says how the predictions were made.
        recipe: of this package, if it was trained by one.
        code: an address, https://.., of the method's code or its description.
        notes: more in words.
        method: a name that results share which differ in their seed alone; together they are one row.
        input_px: the side in pixels of the square image that the network reads; None where not told.
        given_group: whether the method was told the body's symmetry group, in training or after; None where not told.
        given_sets: whether it learnt from symmetry sets or rejected candidates, rather than from one rotation per
            image; None where not told.
        objects: object to training.
    """

    title: str
    by: str
    date: dt.date
    hardware: str
    score_minutes: float | None = None
    commands: tuple[str, ...] = ()
    recipe: str = ""
    code: str = ""
    notes: str = ""
    method: str = ""
    input_px: int | None = None
    given_group: bool | None = None
    given_sets: bool | None = None
    objects: Mapping[str, Training]

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        for name in ("title", "by", "hardware"):
            if not getattr(self, name).strip():
                yield f"{name}: is empty"
        if not any(text.strip() for text in (*self.commands, self.code)):
            yield HOW_IT_WAS_MADE
        elif self.code.strip() and not _ADDRESS.fullmatch(self.code):
            yield f"code: expected an address that begins with https://, found {shown(self.code)}"
        if self.input_px is not None and not 1 <= self.input_px <= _LARGEST_INPUT_PX:
            yield f"input_px: expected 1 to {_LARGEST_INPUT_PX} pixels, found {self.input_px}"
        if self.recipe and self.recipe not in builtin_recipes():
            yield f"recipe: there is no {shown(self.recipe)} built in; leave it out"
        yield from _faults_of_minutes(self, "score_minutes")
        for name, training in self.objects.items():
            yield from (f"objects.{name}.{fault}" for fault in training.faults())


@dataclass(frozen=True)
class Result:
    """One result on one set.

    Attributes:
        name: of its files.
        scores_file: the name of the file of its scores.
        account: how it came to be.
        scores: object to what scores.json says of it.
    """

    name: str
    scores_file: str
    account: Account
    scores: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Reference:
    """A reference row on one set: of a method that knows the answer, half of it, or nothing.

    Attributes:
        name: of its file.
        scores_file: the file's name with its ending.
        method: what it is.
        scores: object to what scores.json says of it.
    """

    name: str
    scores_file: str
    method: str
    scores: Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True, kw_only=True)
class ThesisTable:
    """A table of the thesis.

    Attributes:
        track, metric: their names in scores.json.
        objects: its columns.
        rows: recipe to a value per object; NaN where the thesis has none.
    """

    track: str
    metric: str
    objects: tuple[str, ...]
    rows: Mapping[str, tuple[float, ...]]

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""
        metrics = {track: [metric.name for metric in metrics_shown(track, Place.LEADERBOARD)] for track in SCORINGS}
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


def _faults_of_minutes(entry: Training | Account, *names: str) -> Iterator[str]:
    """Say which of an entry's times are none."""
    for name in names:
        minutes = getattr(entry, name)
        if minutes is not None and not 0 <= minutes < math.inf:
            yield f"{name}: expected a finite number, 0 or more, found {minutes}"


def _faults_of_objects(names: Iterable[str]) -> Iterator[str]:
    """Say which names are no object's."""
    yield from (f"{shown(name)}: an object's name has {OBJECT_NAME_RULE}" for name in names if not is_object_name(name))
