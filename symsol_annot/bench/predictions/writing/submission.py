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

import numpy as np

from symsol_annot.bench.predictions.advice import answer_remedies, remedies
from symsol_annot.bench.predictions.columns import Array, Column, whole_column
from symsol_annot.bench.predictions.format import MAX_GRID_LEVEL, REALS, STANDARD_THRESHOLD, is_level
from symsol_annot.bench.predictions.queries import Queries, group_sha256
from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER, DEFAULT_FLOOR
from symsol_annot.bench.predictions.tracks.density import DENSITY, DENSITY_FLOOR
from symsol_annot.bench.predictions.tracks.hypotheses import HYPOTHESES
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.predictions.writing.given_answers import (
    checked_hypotheses,
    listed_density,
    log_densities,
    probabilities,
    to_array,
)
from symsol_annot.bench.predictions.writing.kept_answers import Resume
from symsol_annot.bench.predictions.writing.predictions_writer import held_predictions
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_sha256, grid_size
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

PathLike: TypeAlias = str | os.PathLike[str]

DEFAULT_BATCH = 2**16
DEFAULT_DENSITY_FLOOR = 1e-300  # the least that a floor may be, whose logarithm a file may hold


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
            columns = _columns_of_array(hypotheses, weights, len(dataset))
            try:
                file.write(columns)
            except PredictionsError as error:
                remedy = remedies.remedy_for_array(hypotheses, len(dataset))
                raise _with_remedy(str(path), error, remedy) from None
            return
        ask = hypotheses

        def answer(i: int) -> Answer:
            return {"hypotheses": checked_hypotheses(ask(i), i)}

        file.write_answers(answer, resume=resume, progress=progress)


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
    if not 0.0 <= floor <= STANDARD_THRESHOLD:
        raise SettingsError(f"floor: expected 0 to {STANDARD_THRESHOLD}, found {floor}")
    attributes = {**_grid_attributes(level, batch_size), "floor": float(floor)}
    attributes["group_sha256"] = group_sha256(dataset.symmetry_group)
    advice = "each image is asked at its own queries; answers in the form of the file go to write_columns"
    _refuse_no_callable(classify, "classify", f"; {advice}")
    with held_predictions(path, dataset, CLASSIFIER, {"method": method, **attributes}, resume) as file:
        answer = _classifier_answers(classify, dataset, floor=floor, level=level, batch_size=batch_size)
        file.write_answers(answer, resume=resume, progress=progress)


def _classifier_answers(
    classify: Callable[[int, Rotations], Array], dataset: Dataset, *, floor: float, level: int, batch_size: int
) -> Callable[[int], Answer]:
    """Return what takes an image's index to the classifier's answers at its queries and on the grid."""
    grid, queries = equivolumetric_grid(level), Queries(dataset.fingerprint, dataset.symmetry_group)
    rotation = dataset.labels().rotation

    def answer(i: int) -> Answer:
        at_queries = probabilities(classify, i, queries.rotations(i, rotation[i]), batch_size)
        on_grid = probabilities(classify, i, grid, batch_size)
        if all(answer_remedies.is_normalised(answers, batch_size) for answers in (at_queries, on_grid)):
            raise SettingsError(f"image {i}: {answer_remedies.normalised_classifier(level, len(grid))}")
        listed = np.flatnonzero(on_grid > np.float32(floor))
        return {
            "query_probability": at_queries,
            "grid_indices": listed.astype(np.int32),
            "grid_probabilities": on_grid[listed],
        }

    return answer


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
    if not DEFAULT_DENSITY_FLOOR <= floor < 1.0:
        raise SettingsError(f"floor: expected at least {DEFAULT_DENSITY_FLOOR} and less than 1, found {floor}")
    attributes = {"method": method, **_grid_attributes(level, batch_size), DENSITY_FLOOR: float(floor)}
    remedy = answer_remedies.density_of_array(log_density, len(dataset), level, grid_size(level))
    _refuse_no_callable(log_density, "log_density", remedy)
    with held_predictions(path, dataset, DENSITY, attributes, resume) as file:
        answer = _density_answers(log_density, floor=floor, level=level, batch_size=batch_size)
        file.write_answers(answer, resume=resume, progress=progress)


def _density_answers(
    log_density: Callable[[int, Rotations], Array], *, floor: float, level: int, batch_size: int
) -> Callable[[int], Answer]:
    """Return what takes an image's index to its density on the grid, made to add up to 1."""
    grid = equivolumetric_grid(level)

    def answer(i: int) -> Answer:
        log_p = log_densities(log_density, i, grid, batch_size)
        if fault := answer_remedies.fault_of_log_densities(log_p, batch_size, level):
            raise SettingsError(f"image {i}: expected log-densities; {fault}")
        log_p = log_p - log_p.max()
        log_p -= np.log(np.exp(log_p).sum())
        return listed_density(log_p, floor)

    return answer


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
    made = {name: _column(column, name) for name, column in columns.items()}
    with held_predictions(path, dataset, chosen, {"method": method, **attributes}, resume=False) as file:
        file.write(made)


def _refuse_no_callable(given: Any, name: str, advice: str) -> None:
    if not callable(given):
        raise SettingsError(f"{name}: expected a callable, found {type(given).__name__}{advice}")


def _column(given: Any, name: str) -> Column:
    array = to_array(given, name, lambda: remedies.remedy_for_numbers(given, name))
    if array.ndim == 0:
        raise SettingsError(f"{name}: expected an array, found the number {array}")
    return whole_column(array)


def _columns_of_array(hypotheses: Any, weights: Any, images: int) -> dict[str, Column]:
    def remedy() -> str:
        return remedies.remedy_for_array(hypotheses, images)

    array = to_array(hypotheses, "hypotheses", remedy)
    is_formed = array.dtype.str in REALS and array.ndim == 4 and array.shape[2:] == (3, 3) and len(array) == images
    if not is_formed and (mending := remedy()):
        found = f"{array.dtype} of shape {array.shape}"
        raise SettingsError(
            f"hypotheses: expected float32 or float64 of shape ({images}, M, 3, 3), found {found}{mending}"
        )
    columns = {"hypotheses": _column(hypotheses, "hypotheses")}
    if weights is not None:
        columns["hypothesis_weights"] = _column(weights, "hypothesis_weights")
    return columns


def _with_remedy(path: str, error: PredictionsError, remedy: str) -> PredictionsError:
    return PredictionsError(path, [*error.faults[:-1], error.faults[-1] + remedy])


def _grid_attributes(level: int, batch_size: int) -> dict[str, Any]:
    """Return what a file says about its grid, after checking what a writer was told about it."""
    if not is_level(level):
        raise SettingsError(f"level: expected 0 to {MAX_GRID_LEVEL}, found {level!r}")
    if batch_size < 1:
        raise SettingsError(f"batch_size: expected at least 1, found {batch_size}")
    return {"grid_level": level, "grid_sha256": grid_sha256(level)}
