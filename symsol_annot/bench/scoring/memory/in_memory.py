"""Scoring what a program holds in memory: arrays, tensors, callables; the same figures as of a file, to the bit.

Everything goes the way of a predictions file but for the file: the same checks, the same messages, the same scorers.
"""

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from symsol_annot.bench.predictions.advice import remedies
from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.contents import HeldArrays, filled, said_of
from symsol_annot.bench.predictions.format import IMAGE_INDEX
from symsol_annot.bench.predictions.predictions_reader import Predictions
from symsol_annot.bench.predictions.tracks.classifier import DEFAULT_FLOOR
from symsol_annot.bench.predictions.tracks.table import TRACK_OF_DATASET, TRACKS
from symsol_annot.bench.predictions.tracks.track import Track
from symsol_annot.bench.predictions.truth import Truth, truth_of
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.predictions.writing.asked import (
    DEFAULT_BATCH,
    DEFAULT_DENSITY_FLOOR,
    classifier_answers,
    classifier_attributes,
    columns_of_array,
    density_answers,
    density_attributes,
    given_column,
    hypotheses_answers,
    refuse_no_callable,
)
from symsol_annot.bench.scoring.memory.answered import GridRun, HeldAnswers
from symsol_annot.bench.scoring.memory.scores import Scores
from symsol_annot.bench.scoring.scoring import ObjectScores, TrackScores
from symsol_annot.bench.scoring.scoring import score as score_predictions
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.text.names import did_you_mean

_NAME = "predictions"  # what the argument is called in messages, and in the lines that mend it
_IMAGES_AT_ONCE = 8  # a density has 3.5 MB per image
Ask: TypeAlias = Callable[..., Any]


@dataclass(frozen=True)
class Asking:
    """How a callable is asked.

    Attributes:
        level: of the grid, for a classifier and a density.
        floor: as the writers take it; None for the track's default.
        batch_size: how many rotations are asked about at once.
    """

    level: int = STANDARD_LEVEL
    floor: float | None = None
    batch_size: int = DEFAULT_BATCH


class _Columns(dict[str, Any]):
    """What a dict has of one track in the form of a predictions file: arrays, and attributes."""


def score(
    predictions: Any,
    dataset: Dataset,
    *,
    track: str | None = None,
    weights: Any = None,
    method: str = "in memory",
    level: int = STANDARD_LEVEL,
    floor: float | None = None,
    batch_size: int = DEFAULT_BATCH,
    intervals: bool = True,
) -> Scores:
    """Score predictions that are in memory: the same figures as of a predictions file, to the bit.

    Args:
        predictions: in the order of the images of `dataset`, one of

            - an array or a tensor (N, M, 3, 3) of hypotheses R_m2c;
            - a list of N such arrays (M_i, 3, 3), where M_i may differ from image to image;
            - a callable that is asked about each image, as the writers of `symsol_annot.bench.submission` take it: from
              an index into `dataset` to hypotheses (m, 3, 3); for the tracks "classifier" and "density" from an index
              and rotations (n, 3, 3) to probabilities or log-densities (n,);
            - a dict of arrays by the names that docs/submission.md gives data sets, in that form; its attributes, like
              `grid_level`, may stand among them. It may be of several tracks;
            - a dict of any of the first three by the names of tracks.
        dataset: the split that they are about, as `symsol_annot.load` returns it. Hypotheses and densities may be about
            a slice like `test[:500]`.
        track: what a callable predicts: "hypotheses", the default, "classifier" or "density".
        weights: (N, M) of an array of hypotheses; 0 means absent.
        method: what the method calls itself.
        level: of the grid on which a callable is asked; other levels than 4 do not rank.
        floor: as `write_classifier` and `write_density` take it.
        batch_size: how many rotations a callable is asked about at once.
        intervals: whether figures get bootstrap intervals, which takes half a second for 5,000 images.

    Returns:
        The figures by track and metric, the columns of single images, and as its repr the table that
        `symsol-annot score` prints.

    Raises:
        SettingsError: a wrong shape or type, an unknown track or name, or answers of a callable that are none. Where
            what was meant can be told, the message ends with a line of code that mends it.
        RotationError: what a callable returned is no rotation.
        PredictionsError: the arrays have faults, all of which it lists.
        NotAnnotatedError: the split has no symmetry sets.
    """
    refuse_no_dataset(dataset)
    truth, asking = truth_of(dataset), Asking(level, floor, batch_size)
    arrays: dict[str, Array] = {}
    attributes: dict[str, Any] = {"method": method}
    asked: dict[str, Ask] = {}
    for name, given in _by_track(predictions, track).items():
        refuse_slice(TRACKS[name], dataset)
        if isinstance(given, _Columns):
            found, said = _in_the_files_form(name, given, dataset)
        elif name == "hypotheses":
            found, said = _hypotheses(given, weights, len(dataset)), {}
        else:
            asked[name] = given
            continue
        arrays |= found
        attributes |= said
    if weights is not None and "hypothesis_weights" not in arrays:
        raise SettingsError("weights: belong to an array of hypotheses; a callable leaves out what is absent")
    scored: dict[str, TrackScores] = {}
    if arrays:
        scored |= dict(score_arrays(truth, attributes, arrays, intervals=intervals).tracks)
    for name, ask in asked.items():
        run = GridRun(TRACKS[name], truth, grid_attributes(TRACKS[name], dataset, asking, method))
        _add_answers(run, answers_of(TRACKS[name], ask, dataset, asking), len(dataset))
        scored[name] = run.scores(intervals=intervals)
    tracks = {name: scored[name] for name in TRACKS if name in scored}
    return Scores(dataset.indices, dataset.is_whole, ObjectScores("", "", method, truth, tracks))


def _add_answers(run: GridRun, answer: Callable[[int], Any], images: int) -> None:
    """Score what a callable answers about each of so many images, some of them at once."""
    for start in range(0, images, _IMAGES_AT_ONCE):
        run.add({i: answer(i) for i in range(start, min(start + _IMAGES_AT_ONCE, images))})


def refuse_no_dataset(dataset: Any) -> None:
    """Refuse what is no split.

    Raises:
        SettingsError: it is none; the message has the line that opens one.
    """
    if not isinstance(dataset, Dataset):
        line = f'import symsol_annot; dataset = symsol_annot.load({str(dataset)!r}, split="test")'
        is_path = isinstance(dataset, str | os.PathLike)
        advice = f"; this line opens one:\n    {line}" if is_path else ""
        raise SettingsError(f"dataset: expected what symsol_annot.load returns, found {type(dataset).__name__}{advice}")


def known_track(name: str) -> Track:
    """Return a track by its name.

    Raises:
        SettingsError: there is none of that name.
    """
    if name not in TRACKS:
        raise SettingsError(f"there is no track {name!r}{did_you_mean(str(name), TRACKS)}")
    return TRACKS[name]


def mend_of_answer(returned: Any) -> str:
    """Return how a callable's answer is mended, as the end of a message."""
    return remedies.remedy_for_answer(returned, _NAME)


def mend_of_row(row: Any) -> str:
    """Return how an entry of a list is mended, as the end of a message."""
    return remedies.remedy_for_row(row, _NAME)


def answers_of(
    track: Track, ask: Ask, dataset: Dataset, asking: Asking, mend: Callable[[Any], str] = mend_of_answer
) -> Callable[[int], Answer]:
    """Return what takes an image's index to what a callable answers of it, checked.

    Args:
        track: what is asked for.
        ask: the callable.
        dataset: the split.
        asking: how it is asked.
        mend: how an answer of hypotheses is mended, as the end of a message.

    Raises:
        SettingsError: it is no callable.
    """
    refuse_no_callable(ask, track.name, "; answers that are there already go in as a dict (docs/scoring-in-python.md)")
    if track.name == "hypotheses":
        return hypotheses_answers(lambda i: plain(ask(i)), mend)
    floor, level, batch_size = _floor(track, asking), asking.level, asking.batch_size
    if track.name == "classifier":
        return classifier_answers(ask, dataset, floor=floor, level=level, batch_size=batch_size)
    return density_answers(ask, floor=floor, level=level, batch_size=batch_size)


def grid_attributes(track: Track, dataset: Dataset, asking: Asking, method: str) -> dict[str, Any]:
    """Return what a predictions file would say of a classifier or a density.

    Raises:
        SettingsError: a wrong floor, level or batch size.
    """
    floor = _floor(track, asking)
    if track.name == "classifier":
        found = classifier_attributes(dataset, floor, asking.level, asking.batch_size)
    else:
        found = density_attributes(floor, asking.level, asking.batch_size)
    return {"method": method, **found}


def score_arrays(
    truth: Truth, attributes: Mapping[str, Any], arrays: Mapping[str, Array], *, intervals: bool
) -> ObjectScores:
    """Score arrays in the form of a predictions file.

    Args:
        truth: of the images that they are about, in their order.
        attributes: the method, and those of the tracks.
        arrays: by the names of data sets.
        intervals: whether figures get their bootstrap intervals.

    Raises:
        PredictionsError: with all faults.
    """
    held = HeldArrays(_NAME, {**said_of(truth), **attributes}, {IMAGE_INDEX: np.arange(len(truth)), **arrays})
    return score_predictions(Predictions(held, truth), intervals=intervals)


def plain(given: Any) -> Any:
    """Return tensors as arrays, wherever they lie, one by one or in a list; anything else as it is."""
    if isinstance(given, list | tuple):
        return [plain(one) for one in given]
    if not hasattr(given, "detach"):  # torch's, which is not imported here
        return given
    tensor = given.detach().cpu()
    try:
        return np.asarray(tensor.numpy())
    except TypeError:  # bfloat16, which numpy does not have: the message for it has the line that mends it
        return given


def _floor(track: Track, asking: Asking) -> float:
    if asking.floor is not None:
        return asking.floor
    return DEFAULT_FLOOR if track.name == "classifier" else DEFAULT_DENSITY_FLOOR


def refuse_slice(track: Track, dataset: Dataset) -> None:
    """Refuse a slice of a split where a track's scores need all of it.

    Raises:
        SettingsError: they do.
    """
    if track.name == "classifier" and not dataset.is_whole:
        raise SettingsError(
            f"{dataset!r} is a slice; a classifier is asked about each image at queries that belong to its place in "
            f"the whole split: score it on symsol_annot.load({str(dataset.folder)!r}, {dataset.split!r})"
        )


def _by_track(predictions: Any, track: str | None) -> dict[str, Any]:
    """Return track to what was given of it: a dict of arrays in the file's form, hypotheses, or a callable."""
    if track is not None:
        known_track(track)
    if isinstance(predictions, Mapping) and all(isinstance(name, str) for name in predictions):
        return _of_mapping(predictions)
    if callable(predictions):
        return {track or _track_of(predictions): predictions}
    if track not in {None, "hypotheses"}:
        raise SettingsError(
            f"predictions: the track {track!r} takes a callable, or a dict of arrays with the names of "
            f"docs/submission.md; found {type(predictions).__name__}"
        )
    return {"hypotheses": predictions}


def _track_of(ask: Ask) -> str:
    """Return the track of a callable that nobody named: hypotheses, if it takes an index alone."""
    try:
        inspect.signature(ask).bind(0)
    except TypeError:
        raise SettingsError(
            "predictions: a callable of an index and rotations is a classifier or a density; say which:\n"
            '    symsol_annot.score(predictions, dataset, track="classifier")  # or track="density"'
        ) from None
    except ValueError:  # some callables of C have no signature
        pass
    return "hypotheses"


def _of_mapping(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return track to what a dict has of it; its keys are names of data sets, attributes and tracks."""
    attributes = {name for track in TRACKS.values() for name in track.attributes}
    found: dict[str, Any] = {}
    for name, value in given.items():
        if name in TRACK_OF_DATASET and not (name in TRACKS and callable(value)):
            if name == "hypotheses" and "hypothesis_weights" not in given:
                found[name] = value
            else:
                found.setdefault(TRACK_OF_DATASET[name], _Columns())[name] = value
        elif name in TRACKS:
            found[name] = value
        elif name not in attributes:
            known = [*TRACKS, *TRACK_OF_DATASET, *attributes]
            raise SettingsError(f"predictions: {name!r} is no track, data set or attribute{did_you_mean(name, known)}")
    if not found:
        raise SettingsError(f"predictions: the dict is empty; it has {', '.join(TRACKS)}, or data sets of theirs")
    for track, value in found.items():
        if isinstance(value, _Columns):
            value |= {name: given[name] for name in TRACKS[track].attributes if name in given}
    return found


def _in_the_files_form(
    track: str, given: Mapping[str, Any], dataset: Dataset
) -> tuple[dict[str, Array], dict[str, Any]]:
    """Return arrays by the names of data sets, and the attributes of their track."""
    chosen = TRACKS[track]
    said = {name: _scalar(value) for name, value in given.items() if name in chosen.attributes}
    said |= {name: value for name, value in chosen.defaults(dataset, said).items() if name not in said}
    arrays = {
        name: filled(given_column(plain(value), name)) for name, value in given.items() if name in chosen.datasets
    }
    return arrays, said


def _scalar(value: Any) -> Any:
    """Return a number of numpy's as one of Python's, which attributes of a file are; anything else as it is."""
    return value.item() if isinstance(value, np.generic | np.ndarray) and value.size == 1 else value


def _hypotheses(given: Any, weights: Any, images: int) -> dict[str, Array]:
    """Return the columns of hypotheses that were given as an array, a list or a callable."""
    if callable(given):
        ask = hypotheses_answers(lambda i: plain(given(i)), mend_of_answer)
        return _of_answers([ask(i) for i in range(images)])
    given = plain(given)
    if isinstance(given, list) and (rows := _rows(given, images)) is not None:
        if weights is not None:
            raise SettingsError("weights: belong to an array of hypotheses; a list leaves out what is absent")
        return _of_answers(rows)
    columns = columns_of_array(given, plain(weights), images, _NAME)
    return {name: filled(column) for name, column in columns.items()}


def _rows(given: Sequence[Any], images: int) -> list[Answer] | None:
    """Return a list's hypotheses image by image, checked; None where it is no list of N arrays (M_i, 3, 3)."""
    if len(given) != images or not all(isinstance(r, np.ndarray) and r.shape[1:] == (3, 3) for r in given):
        return None
    ask = hypotheses_answers(lambda i: given[i], mend_of_row)
    return [ask(i) for i in range(images)]


def _of_answers(answers: Sequence[Answer]) -> dict[str, Array]:
    columns = TRACKS["hypotheses"].columns(HeldAnswers(answers))
    return {name: filled(column) for name, column in columns.items()}
