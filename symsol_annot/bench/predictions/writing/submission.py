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
import numpy.typing as npt

from symsol_annot.bench.predictions.advice import remedies
from symsol_annot.bench.predictions.format import (
    DENSITY_FLOOR,
    MAX_GRID_LEVEL,
    MAX_HYPOTHESES,
    REALS,
    ROTATION_TOLERANCE,
    STANDARD_THRESHOLD,
    TRACK_ATTRIBUTES,
    TRACKS,
    is_level,
)
from symsol_annot.bench.predictions.queries import Queries, group_sha256
from symsol_annot.bench.predictions.writing.file import Column, Parts, held_predictions
from symsol_annot.bench.predictions.writing.kept_answers import Array, Resume, Rows
from symsol_annot.errors import PredictionsError, RotationError, SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_sha256, grid_size
from symsol_annot.rotations.so3 import Rotations, check_rotations
from symsol_annot.sets.dataset import Dataset

PathLike: TypeAlias = str | os.PathLike[str]

DEFAULT_FLOOR = 0.1
DEFAULT_BATCH = 2**16
DEFAULT_DENSITY_FLOOR = 1e-300  # the least that a floor may be, whose logarithm a file may hold
_UNLISTED_MASS = 1e-12  # what is left to the cells not listed, at the least
_COARSE_MASS = 1e-4  # what the cells together may have whose log-probabilities are rounded to _COARSE_STEP
_FINE_STEP, _COARSE_STEP = 2.0**-19, 2.0**-6


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
    with held_predictions(path, dataset, "hypotheses", {"method": method}, resume) as file:
        if not callable(hypotheses):
            columns = _columns_of_array(hypotheses, weights, len(dataset))
            try:
                file.write(columns)
            except PredictionsError as error:
                remedy = remedies.remedy_for_array(hypotheses, len(dataset))
                raise _with_remedy(str(path), error, remedy) from None
            return
        ask = hypotheses
        parts = file.collect(lambda i: {"hypotheses": _checked_hypotheses(ask(i), i)}, resume=resume, progress=progress)
        file.write(_padded(parts.column("hypotheses")))


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
    with held_predictions(path, dataset, "classifier", {"method": method, **attributes}, resume) as file:
        grid, queries = equivolumetric_grid(level), Queries(dataset.fingerprint, dataset.symmetry_group)
        rotation = dataset.labels().rotation

        def ask(i: int) -> Rows:
            at_queries = _probabilities(classify, i, queries.rotations(i, rotation[i]), batch_size)
            on_grid = _probabilities(classify, i, grid, batch_size)
            if all(remedies.is_normalised(answers, batch_size) for answers in (at_queries, on_grid)):
                raise SettingsError(f"image {i}: {remedies.normalised_classifier(level, len(grid))}")
            listed = np.flatnonzero(on_grid > np.float32(floor))
            return {
                "query_probability": at_queries,
                "grid_indices": listed.astype(np.int32),
                "grid_probabilities": on_grid[listed],
            }

        parts = file.collect(ask, resume=resume, progress=progress)
        file.write(
            {
                "query_probability": parts.dense("query_probability"),
                **_sparse(parts, "grid_offsets", "grid_indices", "grid_probabilities"),
            }
        )


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
    remedy = remedies.density_of_array(log_density, len(dataset), level, grid_size(level))
    _refuse_no_callable(log_density, "log_density", remedy)
    with held_predictions(path, dataset, "density", attributes, resume) as file:
        grid = equivolumetric_grid(level)

        def ask(i: int) -> Rows:
            log_p = _log_densities(log_density, i, grid, batch_size)
            if fault := remedies.fault_of_log_densities(log_p, batch_size, level):
                raise SettingsError(f"image {i}: expected log-densities; {fault}")
            log_p = log_p - log_p.max()
            log_p -= np.log(np.exp(log_p).sum())
            return _listed_density(log_p, floor)

        parts = file.collect(ask, resume=resume, progress=progress)
        file.write(_sparse(parts, "density_offsets", "density_indices", "density_log_probabilities"))


def write_columns(
    path: PathLike, dataset: Dataset, track: str, columns: Mapping[str, Array], *, method: str, **attributes: Any
) -> None:
    """Write a track from arrays that have the form of the file already (docs/submission.md), images in order.

    Raises:
        SettingsError: there is no such track, data set or attribute, or the dataset is a slice.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: the arrays have faults, or the file is there and about something else.
        OutputError: the file cannot be written.
    """
    if track not in TRACKS:
        raise SettingsError(f"there is no track {track!r}; tracks are {', '.join(TRACKS)}")
    expected = (*TRACKS[track], *TRACK_ATTRIBUTES[track])
    odd = [name for name in columns if name not in TRACKS[track]]
    odd += [name for name in attributes if name not in TRACK_ATTRIBUTES[track]]
    if odd:
        raise SettingsError(f"{', '.join(odd)}: not of the track {track!r}, which has {', '.join(expected)}")
    if track != "hypotheses":
        level = attributes.setdefault("grid_level", STANDARD_LEVEL)
        attributes.setdefault("grid_sha256", grid_sha256(level))
    if track == "classifier":
        attributes.setdefault("group_sha256", group_sha256(dataset.symmetry_group))
        attributes.setdefault("floor", DEFAULT_FLOOR)
    made = {name: _column(column, name) for name, column in columns.items()}
    with held_predictions(path, dataset, track, {"method": method, **attributes}, resume=False) as file:
        file.write(made)


def _refuse_no_callable(given: Any, name: str, advice: str) -> None:
    if not callable(given):
        raise SettingsError(f"{name}: expected a callable, found {type(given).__name__}{advice}")


def _array(given: Any, what: str, remedy: Callable[[], str] = str) -> Array:
    """Return what a caller gave as an array of numbers; `remedy` says how what is none is mended."""
    try:
        array = np.asarray(given)
    except (ValueError, TypeError, RuntimeError) as error:  # rows of different lengths; a tensor elsewhere
        raise SettingsError(f"{what}: expected an array of numbers: {error}{remedy()}") from None
    if array.dtype.kind not in "biuf":
        found = f"{array.dtype} of shape {array.shape}"
        raise SettingsError(f"{what}: expected an array of numbers, found {found}{remedy()}")
    return array


def _column(given: Any, name: str) -> Column:
    array = _array(given, name, lambda: remedies.remedy_for_numbers(given, name))
    if array.ndim == 0:
        raise SettingsError(f"{name}: expected an array, found the number {array}")
    return Column.of(array)


def _columns_of_array(hypotheses: Any, weights: Any, images: int) -> dict[str, Column]:
    def remedy() -> str:
        return remedies.remedy_for_array(hypotheses, images)

    array = _array(hypotheses, "hypotheses", remedy)
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


def _checked_hypotheses(returned: Any, i: int) -> Array:
    def remedy() -> str:
        return remedies.remedy_for_answer(returned)

    what = f"hypotheses of image {i}"
    hypotheses = _array(returned, what, remedy)
    tolerance = ROTATION_TOLERANCE.get(hypotheses.dtype.str)
    if hypotheses.ndim != 3 or not 1 <= len(hypotheses) <= MAX_HYPOTHESES or tolerance is None:
        raise SettingsError(
            f"{what}: expected float32 or float64 of shape (m, 3, 3) with m from 1 to {MAX_HYPOTHESES}, found "
            f"{hypotheses.dtype} of shape {hypotheses.shape}{remedy()}"
        )
    try:
        check_rotations(hypotheses, what, tolerance)
    except RotationError as error:
        raise RotationError(f"{error}{remedy()}") from None
    return hypotheses


def _grid_attributes(level: int, batch_size: int) -> dict[str, Any]:
    """Return what a file says about its grid, after checking what a writer was told about it."""
    if not is_level(level):
        raise SettingsError(f"level: expected 0 to {MAX_GRID_LEVEL}, found {level!r}")
    if batch_size < 1:
        raise SettingsError(f"batch_size: expected at least 1, found {batch_size}")
    return {"grid_level": level, "grid_sha256": grid_sha256(level)}


def _padded(hypotheses: list[Array]) -> dict[str, Column]:
    """Return columns in which every image has as many hypotheses, the added ones with weight 0."""
    most = max(len(h) for h in hypotheses)
    dtype = min((h.dtype for h in hypotheses), key=lambda dtype: dtype.itemsize)  # a file has one precision
    rows = np.tile(np.eye(3, dtype=dtype), (len(hypotheses), most, 1, 1))
    weights = np.zeros((len(hypotheses), most), dtype=np.float32)
    for row, weight, h in zip(rows, weights, hypotheses, strict=True):
        row[: len(h)], weight[: len(h)] = h, 1.0
    columns = {"hypotheses": Column.of(rows)}
    return columns if weights.all() else {**columns, "hypothesis_weights": Column.of(weights)}


def _sparse(parts: Parts, offsets: str, indices: str, values: str) -> dict[str, Column]:
    lengths = parts.lengths(indices)
    bounds = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
    return {
        offsets: Column.of(bounds),
        indices: parts.sparse(indices, lengths),
        values: parts.sparse(values, lengths),
    }


def _ask(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int, name: str
) -> npt.NDArray[np.float64]:
    answers = []
    for start in range(0, len(rotations), batch_size):
        batch = rotations[start : start + batch_size].copy()  # whoever is asked may write to it
        answers.append(_one_each(f(i, batch), i, len(batch), name))
    return np.concatenate(answers)


def _one_each(returned: Any, i: int, count: int, name: str) -> npt.NDArray[np.float64]:
    """Return an answer about so many rotations, one number for each."""

    def remedy() -> str:
        return remedies.remedy_for_values(returned, count, name)

    answer = _array(returned, f"image {i}", remedy)
    if answer.shape != (count,):
        raise SettingsError(
            f"image {i}: asked about {count} rotations, the answer has the shape {answer.shape}{remedy()}"
        )
    return answer.astype(np.float64)


def _probabilities(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float32]:
    answers = _ask(f, i, rotations, batch_size, "classify").astype(np.float32)
    strange = ~((answers >= 0) & (answers <= 1))  # NaN is strange too
    if strange.any():
        remedy = remedies.remedy_for_probabilities(answers)
        raise SettingsError(f"image {i}: expected probabilities from 0 to 1, found {answers[strange][0]}{remedy}")
    return answers


def _log_densities(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float64]:
    log_p = _ask(f, i, rotations, batch_size, "log_density")
    highest = log_p.max()
    if not np.isfinite(highest):  # NaN, if there is one
        remedy = remedies.remedy_for_infinity() if highest == np.inf else ""
        raise SettingsError(f"image {i}: expected log-densities, at least one of them finite, found {highest}{remedy}")
    return log_p


def _listed_density(log_p: npt.NDArray[np.float64], floor: float) -> Rows:
    """Return the cells that are stored, and their log-probabilities.

    A cell that is not stored gets its share of what is left of 1, which is 1e-12 at the least, since a sum of float64
    tells no less from nothing. Where that share would be more than the floor, all cells are stored, none as less than
    the floor.
    """
    listed = np.flatnonzero(~(log_p <= np.log(floor)))
    if (len(log_p) - len(listed)) * floor < _UNLISTED_MASS:
        kept = _rounded(np.maximum(log_p, np.log(floor)))
        return {"density_indices": np.arange(len(kept), dtype=np.int32), "density_log_probabilities": kept}
    kept = log_p[listed]
    mass = np.exp(kept).sum()
    kept = kept - max(0.0, np.log(mass) - np.log1p(-_UNLISTED_MASS)) if mass > 0 else kept
    return {"density_indices": listed.astype(np.int32), "density_log_probabilities": np.minimum(kept, 0.0)}


def _rounded(log_p: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return log-probabilities that gzip makes small: off by 1e-6 at most, and by 2^-7 for cells of next to nothing."""
    step = np.where(log_p > np.log(_COARSE_MASS / len(log_p)), _FINE_STEP, _COARSE_STEP)
    return np.minimum(np.rint(log_p / step) * step, 0.0)
