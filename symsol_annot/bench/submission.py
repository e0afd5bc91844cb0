"""Writing predictions files: arrays in, or a callable an image, which may be stopped and gone on with.

Each writer takes the split that the predictions are about, as `symsol_annot.load` returns it:

    test = symsol_annot.load("data/cylO")
    write_hypotheses("preds.h5", test, lambda i: model(test[i].image), method="mine")

A second writer adds its track to the same file. What a callable returned is kept beside the file, in `preds.h5.parts`,
until all images are done; the same call goes on from there. A file is put in its place once it passed every check.
"""

import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.format import (
    CLASSIFIER_ATTRIBUTES,
    GRID_ATTRIBUTES,
    MAX_GRID_LEVEL,
    MAX_HYPOTHESES,
    ROTATION_TOLERANCE,
    STANDARD_THRESHOLD,
    TRACKS,
    is_level,
)
from symsol_annot.bench.predictions_file import Array, Column, Parts, PredictionsFile, Rows
from symsol_annot.bench.queries import Queries, group_sha256
from symsol_annot.dataset import Dataset
from symsol_annot.errors import SettingsError
from symsol_annot.grid import STANDARD_LEVEL, equivolumetric_grid, grid_sha256
from symsol_annot.so3 import Rotations, check_rotations

PathLike: TypeAlias = str | os.PathLike[str]

DEFAULT_FLOOR = 0.1
DEFAULT_BATCH = 2**16
DENSITY_FLOOR = 1e-9
_LEAST_FLOOR = 1e-300  # whose logarithm a file may hold
_UNLISTED_MASS = 1e-12  # what is left to the cells not listed, at the least
_TRACK_ATTRIBUTES: dict[str, dict[str, type]] = {
    "hypotheses": {},
    "classifier": CLASSIFIER_ATTRIBUTES,
    "density": GRID_ATTRIBUTES,
}


def write_hypotheses(
    path: PathLike,
    dataset: Dataset,
    hypotheses: Array | Callable[[int], Array],
    *,
    method: str,
    weights: Array | None = None,
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
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: a wrong shape from the callable, weights with it, or a slice instead of the whole split.
        RotationError: what the callable returned is no rotation; the message names the image.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: what was to be written has faults, or the file is there and about something else.
        OutputError: the file, or what is kept beside it, cannot be written.
    """
    file = PredictionsFile(Path(path), dataset, "hypotheses", {"method": method})
    if callable(hypotheses):
        if weights is not None:
            raise SettingsError("weights: belong to an array of hypotheses; a callable leaves out what is absent")
        ask = hypotheses
        parts = file.collect(lambda i: {"hypotheses": _checked_hypotheses(ask(i), i)}, progress=progress)
        columns = _padded(parts.column("hypotheses"))
    else:
        columns = {"hypotheses": _column(hypotheses, "hypotheses")}
        if weights is not None:
            columns["hypothesis_weights"] = _column(weights, "hypothesis_weights")
    file.write(columns)


def write_classifier(
    path: PathLike,
    dataset: Dataset,
    classify: Callable[[int, Rotations], Array],
    *,
    method: str,
    floor: float = DEFAULT_FLOOR,
    level: int = STANDARD_LEVEL,
    batch_size: int = DEFAULT_BATCH,
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
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: an answer that is no probabilities (the message names the image), a wrong floor, level or batch
            size, or a slice instead of the whole split.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: what was to be written has faults, or the file is there and about something else.
        OutputError: the file, or what is kept beside it, cannot be written.
    """
    if not 0.0 <= floor <= STANDARD_THRESHOLD:
        raise SettingsError(f"floor: expected 0 to {STANDARD_THRESHOLD}, found {floor}")
    attributes = {**_grid_attributes(level, batch_size), "floor": float(floor)}
    attributes["group_sha256"] = group_sha256(dataset.symmetry_group)
    file = PredictionsFile(Path(path), dataset, "classifier", {"method": method, **attributes})
    grid, queries = equivolumetric_grid(level), Queries(dataset.fingerprint, dataset.symmetry_group)
    rotation = dataset.labels().rotation

    def ask(i: int) -> Rows:
        at_queries = _probabilities(classify, i, queries.rotations(i, rotation[i]), batch_size)
        on_grid = _probabilities(classify, i, grid, batch_size)
        listed = np.flatnonzero(on_grid > np.float32(floor))
        return {
            "query_probability": at_queries,
            "grid_indices": listed.astype(np.int32),
            "grid_probabilities": on_grid[listed],
        }

    parts = file.collect(ask, progress=progress)
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
    floor: float = DENSITY_FLOOR,
    level: int = STANDARD_LEVEL,
    batch_size: int = DEFAULT_BATCH,
    progress: bool = True,
) -> None:
    """Write the track "density", asking on the grid and making the cells' probabilities add up to 1.

    Args:
        path: of the predictions file.
        dataset: the whole split.
        log_density: from an image's index and rotations R_m2c (n, 3, 3) to log-densities (n,), up to a constant an
            image.
        method: what the method calls itself.
        floor: cells with a probability up to it are not stored; they share what is left evenly.
        level: of the grid; other levels than the standard one do not rank.
        batch_size: how many rotations are asked about at once.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: an answer that is no log-densities (the message names the image), a wrong floor, level or batch
            size, or a slice instead of the whole split.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: what was to be written has faults, or the file is there and about something else.
        OutputError: the file, or what is kept beside it, cannot be written.
    """
    if not _LEAST_FLOOR <= floor < 1.0:
        raise SettingsError(f"floor: expected at least {_LEAST_FLOOR} and less than 1, found {floor}")
    attributes = {"method": method, **_grid_attributes(level, batch_size)}
    file = PredictionsFile(Path(path), dataset, "density", attributes, {"floor": float(floor)})
    grid = equivolumetric_grid(level)

    def ask(i: int) -> Rows:
        log_p = _ask(log_density, i, grid, batch_size)
        highest = log_p.max()
        if not np.isfinite(highest):  # NaN, if there is one
            raise SettingsError(f"image {i}: expected log-densities, at least one of them finite, found {highest}")
        log_p = log_p - highest
        log_p -= np.log(np.exp(log_p).sum())
        return _listed_density(log_p, floor)

    parts = file.collect(ask, progress=progress)
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
    expected = (*TRACKS[track], *_TRACK_ATTRIBUTES[track])
    odd = [name for name in columns if name not in TRACKS[track]]
    odd += [name for name in attributes if name not in _TRACK_ATTRIBUTES[track]]
    if odd:
        raise SettingsError(f"{', '.join(odd)}: not of the track {track!r}, which has {', '.join(expected)}")
    if track != "hypotheses":
        level = attributes.setdefault("grid_level", STANDARD_LEVEL)
        attributes.setdefault("grid_sha256", grid_sha256(level))
    if track == "classifier":
        attributes.setdefault("group_sha256", group_sha256(dataset.symmetry_group))
        attributes.setdefault("floor", DEFAULT_FLOOR)
    made = {name: _column(column, name) for name, column in columns.items()}
    PredictionsFile(Path(path), dataset, track, {"method": method, **attributes}).write(made)


def _array(given: Any, what: str) -> Array:
    """Return what a caller gave as an array of numbers."""
    try:
        array = np.asarray(given)
    except ValueError as error:  # rows of different lengths
        raise SettingsError(f"{what}: expected an array of numbers: {error}") from None
    if array.dtype.kind not in "biuf":
        raise SettingsError(f"{what}: expected an array of numbers, found {array.dtype} of shape {array.shape}")
    return array


def _column(given: Any, name: str) -> Column:
    array = _array(given, name)
    if array.ndim == 0:
        raise SettingsError(f"{name}: expected an array, found the number {array}")
    return Column.of(array)


def _checked_hypotheses(returned: Any, i: int) -> Array:
    hypotheses = _array(returned, f"hypotheses of image {i}")
    tolerance = ROTATION_TOLERANCE.get(hypotheses.dtype.str)
    if hypotheses.ndim != 3 or not 1 <= len(hypotheses) <= MAX_HYPOTHESES or tolerance is None:
        raise SettingsError(
            f"hypotheses of image {i}: expected float32 or float64 of shape (m, 3, 3) with m from 1 to "
            f"{MAX_HYPOTHESES}, found {hypotheses.dtype} of shape {hypotheses.shape}"
        )
    check_rotations(hypotheses, f"hypotheses of image {i}", tolerance)
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
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float64]:
    answers = []
    for start in range(0, len(rotations), batch_size):
        batch = rotations[start : start + batch_size].copy()  # whoever is asked may write to it
        answer = _array(f(i, batch), f"image {i}")
        if answer.shape != (len(batch),):
            raise SettingsError(
                f"image {i}: asked about {len(batch)} rotations, the answer has the shape {answer.shape}"
            )
        answers.append(answer.astype(np.float64))
    return np.concatenate(answers)


def _probabilities(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float32]:
    answers = _ask(f, i, rotations, batch_size).astype(np.float32)
    strange = ~((answers >= 0) & (answers <= 1))  # NaN is strange too
    if strange.any():
        raise SettingsError(f"image {i}: expected probabilities from 0 to 1, found {answers[strange][0]}")
    return answers


def _listed_density(log_p: npt.NDArray[np.float64], floor: float) -> Rows:
    listed = np.flatnonzero(~(log_p <= np.log(floor)))
    kept = log_p[listed]
    if len(listed) < len(log_p):
        mass = np.exp(kept).sum()
        kept = kept - max(0.0, np.log(mass) - np.log1p(-_UNLISTED_MASS)) if mass > 0 else kept
    return {"density_indices": listed.astype(np.int32), "density_log_probabilities": np.minimum(kept, 0.0)}
