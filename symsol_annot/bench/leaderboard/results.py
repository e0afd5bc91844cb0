"""The files that docs/leaderboard.md is built from: image sets, results on them, and the thesis's own numbers.

    thesis.toml             the thesis's tables
    SET/set.toml            an image set: what makes it, and the fingerprints of its splits
    SET/NAME.toml           a result: who, how, on what
    SET/NAME.json           its scores, as `score --json` wrote them; or packed, NAME.json.gz
                            those that say one `method` differ in their seed alone, and make one row
    SET/reference/ROW.json  scores of a reference row, as `reference` wrote them, or ROW.json.gz; shown beside results,
                            not ranked

A result is held against its set, and its figures against those of its images. Anybody may send such files in: names,
numbers and shapes are checked here and in `entries.py`, words are escaped by who shows them.
"""

import os
import re
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, TypeVar

from symsol_annot.bench.leaderboard.entries import Account, ImageSet, Leaderboard, Reference, Result, Thesis
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.scoring.metric import Place
from symsol_annot.bench.scoring.reports.scores_file import figures_that_differ, read_scores
from symsol_annot.bench.scoring.scorers.table import SCORINGS, metrics_shown
from symsol_annot.errors import ScoresError, bulleted, count_of
from symsol_annot.system.reading import read_text
from symsol_annot.system.text.names import is_object_name
from symsol_annot.system.text.tables import from_table
from symsol_annot.system.text.toml import MAX_TOML_BYTES, parse_toml


class _Checked(Protocol):
    """What a file says, as far as types go."""

    def faults(self) -> Iterator[str]:
        """Say what is wrong with it."""


T = TypeVar("T", bound=_Checked)

THESIS, SET = "thesis.toml", "set.toml"
SCORES_ENDINGS = (".json", ".json.gz")
_SHOWN = 5  # differences of one object
_SHA256 = re.compile(r"[0-9a-f]{64}")
_NAME = re.compile(r"[A-Za-z0-9._-]+")  # as it stands in links and headings
_NAME_RULE = "a name has letters, digits, '.', '_' and '-' alone"
REFERENCE = "reference"
_SHOWN_FAULTS = 20  # of one file
_SHARED = ("title", "by", "recipe", "input_px", "given_group", "given_sets")  # by results of one method


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


def _folders(folder: Path) -> list[Path]:
    """Return the folders in one, by name; what begins with a dot is the system's."""
    try:
        return sorted(path for path in folder.iterdir() if path.is_dir() and not path.name.startswith("."))
    except OSError as error:
        raise ScoresError(f"{folder}: cannot be read: {error.strerror}") from None


def _names_in(folder: Path, endings: Iterable[str]) -> list[str]:
    """Return the names of the files in a folder that have one of the endings, without it."""
    try:
        there = [path.name for path in folder.iterdir() if not path.name.startswith(".")]
    except OSError as error:
        raise ScoresError(f"{folder}: cannot be read: {error.strerror}") from None
    return sorted({name.removesuffix(ending) for ending in endings for name in there if name.endswith(ending)})


def _scores_of(folder: Path, name: str, faults: list[str]) -> tuple[str, dict[str, Any]]:
    """Return the file of a name's scores and what it says; nothing, and one fault more, where it cannot be used."""
    files = [f"{name}{ending}" for ending in SCORES_ENDINGS]
    there = [file for file in files if os.path.lexists(folder / file)]
    if len(there) > 1:
        faults.append(f"{folder}: has both {' and '.join(there)}; keep one of them")
        return there[0], {}
    file = there[0] if there else files[0]
    try:
        return file, read_scores(folder / file)
    except ScoresError as error:
        faults.append(str(error))
        return file, {}


def _read(path: Path, kind: type[T], what: str) -> tuple[T | None, list[str]]:
    """Return a TOML file as a dataclass, or None, and its faults with the file's name."""
    try:
        made, faults = from_table(kind, parse_toml(read_text(path, MAX_TOML_BYTES)), what)
    except OSError as error:
        return None, [f"{path}: cannot be read: {error.strerror or error}"]
    except ValueError as error:
        return None, [f"{path}: cannot be read: {error}"]
    if made is not None:
        faults += made.faults()
    more = [f"{len(faults) - _SHOWN_FAULTS} faults more"] if len(faults) > _SHOWN_FAULTS else []
    return made, [f"{path}: {fault}" for fault in [*faults[:_SHOWN_FAULTS], *more]]


def _results(place: Path, image_set: ImageSet) -> tuple[tuple[Result, ...], list[str]]:
    """Return the results on a set, and the faults of their files."""
    names = [name for name in _names_in(place, (".toml", *SCORES_ENDINGS)) if f"{name}.toml" != SET]
    results, faults = [], [f"{place}: {fault}" for fault in _faults_of_names(names)]
    for name in names:
        account, found = _read(place / f"{name}.toml", Account, "a result")
        file, scores = _scores_of(place, name, found)
        if account is not None and scores:
            of_scores = [*_faults_of_ranks(scores), *_faults_of_scores(scores, image_set)]
            found += [f"{place / file}: {fault}" for fault in of_scores]
            found += [f"{place / name}.toml: {fault}" for fault in _faults_of_account(account, scores["objects"])]
            results.append(Result(name, file, account, scores["objects"]))
        faults += found
    faults += [f"{place}: {fault}" for fault in _faults_of_methods(results)]
    return tuple(results), faults


def _faults_of_methods(results: Iterable[Result]) -> Iterator[str]:
    """Say which results of one method differ in more than their seed, or have one seed twice."""
    first: dict[str, Result] = {}
    seeds: dict[tuple[str, str, int], str] = {}
    for result in (result for result in results if result.account.method):
        method = result.account.method
        other = first.setdefault(method, result)
        for what in _SHARED:
            found, wanted = getattr(result.account, what), getattr(other.account, what)
            if found != wanted:
                yield (
                    f"{result.name}.toml: {what}: expected {shown(wanted)}, as {other.name}.toml of one method, "
                    f"found {shown(found)}"
                )
        for name, training in result.account.objects.items():
            same = seeds.setdefault((method, name, training.seed), result.name)
            if same != result.name:
                yield f"{result.name}.toml: objects.{name}.seed: {training.seed} is that of {same}.toml, of one method"
        yield from _faults_of_facts(result, other)


def _faults_of_facts(result: Result, other: Result) -> Iterator[str]:
    """Say in which facts, such as M, two results of one method differ, by object and track.

    The M of lists with weights is that of the longest list, and may differ.
    """
    for name in (name for name in result.scores if name in other.scores):
        ours, theirs = result.scores[name], other.scores[name]
        for track, scoring in SCORINGS.items():
            if track not in ours or track not in theirs:
                continue
            if _has_weights(ours[track], track) and _has_weights(theirs[track], track):
                continue
            for fact in scoring.shown_facts:
                if ours[track][fact] != theirs[track][fact]:
                    yield (
                        f"{result.scores_file}: objects.{name}.{track}.{fact}: expected {theirs[track][fact]}, "
                        f"as {other.scores_file}, found {ours[track][fact]}"
                    )


def _has_weights(entry: Mapping[str, Any], track: str) -> bool:
    """Tell whether scores are of answers with weights."""
    return TRACKS[track].ranked_by_if_there in entry["all"]


def _references(place: Path, image_set: ImageSet) -> tuple[tuple[Reference, ...], list[str]]:
    """Return the reference rows on a set, and the faults of their files."""
    folder = place / REFERENCE
    if not folder.is_dir():
        return (), []
    names = _names_in(folder, SCORES_ENDINGS)
    rows, faults = [], [f"{folder}: {fault}" for fault in _faults_of_names(names)]
    for name in names:
        file, scores = _scores_of(folder, name, faults)
        if scores:
            faults += [f"{folder / file}: {fault}" for fault in _faults_of_scores(scores, image_set)]
            rows.append(Reference(name, file, scores["method"], scores["objects"]))
    return tuple(rows), faults


def _faults_of_ranks(scores: Mapping[str, Any]) -> Iterator[str]:
    """Say why scores do not rank."""
    if scores.get("ranks") is not True:
        yield "'ranks' is not true: `score` warned of something, so it does not rank"
    for name, entry in scores["objects"].items():
        tracks = [track for track in SCORINGS if track in entry]
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
        tracks = [track for track in SCORINGS if track in entry]
        if not tracks:
            yield f"objects.{name}: has no track"
        yield from (f"objects.{name}.per_image.{metric}: is missing" for metric in _missing(entry, tracks))
        yield from (f"objects.{name}.{difference}" for difference in islice(figures_that_differ(entry), _SHOWN))


def _missing(entry: Mapping[str, Any], tracks: Iterable[str]) -> Iterator[str]:
    """Yield which metrics of the page an object's scores lack; without them a bad figure could be left out."""
    for track in tracks:
        names = [metric.name for metric in metrics_shown(track, Place.LEADERBOARD)]
        names += [name for name in [TRACKS[track].ranked_by_if_there] if name in entry[track]["all"]]  # it would rank
        yield from (f"{track}.{name}" for name in names if name not in entry["per_image"][track])


def _faults_of_account(account: Account, scores: Mapping[str, Any]) -> Iterator[str]:
    if set(account.objects) != set(scores):
        found = ", ".join(name if is_object_name(name) else shown(name) for name in account.objects) or "none"
        yield f"objects: expected those of the scores, {', '.join(scores)}, found {found}"
        return
    for name, training in account.objects.items():
        scored = _sha256_of(scores[name])
        if training.predictions_sha256 not in ("", scored):
            yield f"objects.{name}.predictions_sha256: the scores are of other predictions, {shown(scored)}"


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
