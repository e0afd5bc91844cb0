"""Writing predictions files: arrays in, or a callable per image, which may be stopped and resumed.

Each writer takes the split that the predictions are about, as `symsol_annot.load` returns it:

    test = symsol_annot.load("data/cylO")
    write_hypotheses("preds.h5", test, lambda i: model(test[i].image), method="mine")

A second writer adds its track to the same file. What a callable returned is kept beside the file, in `preds.h5.parts`,
until all images are done. After an interruption the same call with `resume=True` asks about the other images alone;
without it, answers that are there are refused, since they may be another model's. A file is put in its place once it
passed every check. While one process writes a file, another one that is to write it is refused.
"""

import os
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

from symsol_annot.bench.predictions.advice import answer_remedies, remedies
from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER, DEFAULT_FLOOR
from symsol_annot.bench.predictions.tracks.density import DENSITY
from symsol_annot.bench.predictions.tracks.hypotheses import HYPOTHESES
from symsol_annot.bench.predictions.tracks.table import TRACKS
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
from symsol_annot.bench.predictions.writing.kept_answers import Resume
from symsol_annot.bench.predictions.writing.predictions_writer import held_predictions
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL, grid_size
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

PathLike: TypeAlias = str | os.PathLike[str]


def write_hypotheses(
    path: PathLike,
    dataset: Dataset,
    hypotheses: Array | Callable[[int], Array],
    *,
    method: str,
    weights: Array | None = None,
    resume: Resume = False,
    progress: bool = True,
) -> None:
    """Write the track "hypotheses".

    Args:
        path: of the predictions file.
        dataset: the whole split.
        hypotheses: (N, M, 3, 3) R_m2c in the order of the images; or a callable from an image's index to (m, 3, 3),
            where m may differ from image to image: the others are padded with hypotheses of weight 0.
        method: what the method calls itself.
        weights: (N, M), with an array only; the precision metrics use them, and 0 means absent.
        resume: what is done with answers that an earlier call kept: False refuses them, True uses them again, for
            which the caller vouches that they are this callable's; a string names who answers (a checkpoint's digest,
            a commit), is kept with the answers, and has them used again where it is the same.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: a wrong shape or type, weights with a callable, `resume` with an array, or a slice instead of the
            whole split. Where what was meant can be told, the message ends with a line of code that mends it.
        RotationError: what the callable returned is no rotation; the message names the image.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: what was to be written has faults, the file is there and about something else, or answers
            are there that may be another model's.
        OutputError: another process writes the file, or it or what is kept beside it cannot be written.
    """
    if resume and not callable(hypotheses):
        raise SettingsError("resume: belongs to a callable; an array is written in one go")
    if weights is not None and callable(hypotheses):
        raise SettingsError("weights: belong to an array of hypotheses; a callable leaves out what is absent")
    with held_predictions(path, dataset, HYPOTHESES, {"method": method}, resume) as file:
        if not callable(hypotheses):
            columns = columns_of_array(hypotheses, weights, len(dataset))
            try:
                file.write(columns)
            except PredictionsError as error:
                remedy = remedies.remedy_for_array(hypotheses, len(dataset))
                raise _with_remedy(str(path), error, remedy) from None
            return
        file.write_answers(hypotheses_answers(hypotheses), resume=resume, progress=progress)


def write_classifier(
    path: PathLike,
    dataset: Dataset,
    classify: Callable[[int, Rotations], Array],
    *,
    method: str,
    floor: float = DEFAULT_FLOOR,
    level: int = STANDARD_LEVEL,
    batch_size: int = DEFAULT_BATCH,
    resume: Resume = False,
    progress: bool = True,
) -> None:
    """Write the track "classifier", asking at each image's queries and on the grid.

    Args:
        path: of the predictions file.
        dataset: the whole split.
        classify: from an image's index and rotations R_m2c (n, 3, 3) to probabilities (n,) that they are in its set.
        method: what the method calls itself.
        floor: probabilities on the grid up to it are not stored.
        level: of the grid; other levels than the standard one do not rank.
        batch_size: how many rotations are asked about at once.
        resume: what is done with answers that an earlier call kept: False refuses them, True uses them again, for
            which the caller vouches that they are this callable's; a string names who answers (a checkpoint's digest,
            a commit), is kept with the answers, and has them used again where it is the same.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: an answer that is no probabilities (the message names the image), a wrong floor, level or batch
            size, or a slice instead of the whole split.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: what was to be written has faults, the file is there and about something else, or answers
            are there that may be another model's.
        OutputError: another process writes the file, or it or what is kept beside it cannot be written.
    """
    attributes = {"method": method, **classifier_attributes(dataset, floor, level, batch_size)}
    advice = "each image is asked at its own queries; answers in the form of the file go to write_columns"
    refuse_no_callable(classify, "classify", f"; {advice}")
    with held_predictions(path, dataset, CLASSIFIER, attributes, resume) as file:
        answer = classifier_answers(classify, dataset, floor=floor, level=level, batch_size=batch_size)
        file.write_answers(answer, resume=resume, progress=progress)


def write_density(
    path: PathLike,
    dataset: Dataset,
    log_density: Callable[[int, Rotations], Array],
    *,
    method: str,
    floor: float = DEFAULT_DENSITY_FLOOR,
    level: int = STANDARD_LEVEL,
    batch_size: int = DEFAULT_BATCH,
    resume: Resume = False,
    progress: bool = True,
) -> None:
    """Write the track "density", asking on the grid and making the cells' probabilities add up to 1.

    Args:
        path: of the predictions file.
        dataset: the whole split.
        log_density: from an image's index and rotations R_m2c (n, 3, 3) to log-densities (n,), up to a constant per
            image, the same in all of its batches.
        method: what the method calls itself.
        floor: what a smaller probability of a cell is counted as, at most; the file has it as `density_floor`. With the
            default one, a file's log-likelihood is within 0.01 of the density's own, but for cells below 1e-300.
            A higher floor makes smaller files: cells below it are not stored, and share evenly what is left.
        level: of the grid; other levels than the standard one do not rank.
        batch_size: how many rotations are asked about at once.
        resume: what is done with answers that an earlier call kept: False refuses them, True uses them again, for
            which the caller vouches that they are this callable's; a string names who answers (a checkpoint's digest,
            a commit), is kept with the answers, and has them used again where it is the same.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: an answer that is no log-densities (the message names the image), a wrong floor, level or batch
            size, or a slice instead of the whole split.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: what was to be written has faults, the file is there and about something else, or answers
            are there that may be another model's.
        OutputError: another process writes the file, or it or what is kept beside it cannot be written.
    """
    attributes = {"method": method, **density_attributes(floor, level, batch_size)}
    remedy = answer_remedies.density_of_array(log_density, len(dataset), level, grid_size(level))
    refuse_no_callable(log_density, "log_density", remedy)
    with held_predictions(path, dataset, DENSITY, attributes, resume) as file:
        answer = density_answers(log_density, floor=floor, level=level, batch_size=batch_size)
        file.write_answers(answer, resume=resume, progress=progress)


def write_columns(
    path: PathLike, dataset: Dataset, track: str, columns: Mapping[str, Array], *, method: str, **attributes: Any
) -> None:
    """Write a track from arrays that have the form of the file already (docs/submission.md), images in order.

    Args:
        path: of the predictions file.
        dataset: the whole split.
        track: its name, one of `TRACKS`.
        columns: names of the track's data sets to arrays, a row per image or, of sparse rows, their entries.
        method: what the method calls itself.
        attributes: of the file, such as `grid_level` and `floor`; what is left out gets its standard value.

    Raises:
        SettingsError: there is no such track, data set or attribute, or the dataset is a slice.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: the arrays have faults, or the file is there and about something else.
        OutputError: the file cannot be written.
    """
    if track not in TRACKS:
        raise SettingsError(f"there is no track {track!r}; tracks are {', '.join(TRACKS)}")
    chosen = TRACKS[track]
    odd = [name for name in columns if name not in chosen.datasets]
    odd += [name for name in attributes if name not in chosen.attributes]
    if odd:
        expected = (*chosen.datasets, *chosen.attributes)
        raise SettingsError(f"{', '.join(odd)}: not of the track {track!r}, which has {', '.join(expected)}")
    defaults = chosen.defaults(dataset, attributes)
    attributes |= {name: value for name, value in defaults.items() if name not in attributes}
    made = {name: given_column(column, name) for name, column in columns.items()}
    with held_predictions(path, dataset, chosen, {"method": method, **attributes}, resume=False) as file:
        file.write(made)


def _with_remedy(path: str, error: PredictionsError, remedy: str) -> PredictionsError:
    return PredictionsError(path, [*error.faults[:-1], error.faults[-1] + remedy])
