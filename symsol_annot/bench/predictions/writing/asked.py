"""What callables are asked of an image, and what is made of arrays: the answers and columns that a track is made of."""

from collections.abc import Callable
from typing import Any

import numpy as np

from symsol_annot.bench.predictions.advice import answer_remedies, remedies
from symsol_annot.bench.predictions.columns import Array, Column, whole_column
from symsol_annot.bench.predictions.format import MAX_GRID_LEVEL, REALS, STANDARD_THRESHOLD, is_level
from symsol_annot.bench.predictions.queries import Queries, group_sha256
from symsol_annot.bench.predictions.tracks.density import DENSITY_FLOOR
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.predictions.writing.given_answers import (
    checked_hypotheses,
    listed_density,
    log_densities,
    probabilities,
    to_array,
)
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.grid import equivolumetric_grid, grid_sha256
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

DEFAULT_BATCH = 2**16
DEFAULT_DENSITY_FLOOR = 1e-300  # the least that a floor may be, whose logarithm a file may hold


def hypotheses_answers(
    ask: Callable[[int], Array], mend: Callable[[Any], str] = remedies.remedy_for_answer
) -> Callable[[int], Answer]:
    """Return what takes an image's index to its hypotheses, checked; `mend` says how a wrong answer is mended."""

    def answer(i: int) -> Answer:
        return {"hypotheses": checked_hypotheses(ask(i), i, mend)}

    return answer


def classifier_attributes(dataset: Dataset, floor: float, level: int, batch_size: int) -> dict[str, Any]:
    """Return what a file says of its classifier, after checking what `write_classifier` was told.

    Raises:
        SettingsError: a wrong floor, level or batch size.
    """
    if not 0.0 <= floor <= STANDARD_THRESHOLD:
        raise SettingsError(f"floor: expected 0 to {STANDARD_THRESHOLD}, found {floor}")
    attributes = {**_grid_attributes(level, batch_size), "floor": float(floor)}
    return {**attributes, "group_sha256": group_sha256(dataset.symmetry_group)}


def classifier_answers(
    classify: Callable[[int, Rotations], Array], dataset: Dataset, *, floor: float, level: int, batch_size: int
) -> Callable[[int], Answer]:
    """Return what takes an image's index to the classifier's answers at its queries and on the grid.

    The arguments are those of `write_classifier`; an answer that is no probabilities raises a SettingsError.
    """
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


def density_attributes(floor: float, level: int, batch_size: int) -> dict[str, Any]:
    """Return what a file says of its density, after checking what `write_density` was told.

    Raises:
        SettingsError: a wrong floor, level or batch size.
    """
    if not DEFAULT_DENSITY_FLOOR <= floor < 1.0:
        raise SettingsError(f"floor: expected at least {DEFAULT_DENSITY_FLOOR} and less than 1, found {floor}")
    return {**_grid_attributes(level, batch_size), DENSITY_FLOOR: float(floor)}


def density_answers(
    log_density: Callable[[int, Rotations], Array], *, floor: float, level: int, batch_size: int
) -> Callable[[int], Answer]:
    """Return what takes an image's index to its density on the grid, made to add up to 1.

    The arguments are those of `write_density`; an answer that is no log-densities raises a SettingsError.
    """
    grid = equivolumetric_grid(level)

    def answer(i: int) -> Answer:
        log_p = log_densities(log_density, i, grid, batch_size)
        if fault := answer_remedies.fault_of_log_densities(log_p, batch_size, level):
            raise SettingsError(f"image {i}: expected log-densities; {fault}")
        log_p = log_p - log_p.max()
        log_p -= np.log(np.exp(log_p).sum())
        return listed_density(log_p, floor)

    return answer


def columns_of_array(hypotheses: Any, weights: Any, images: int, name: str = "hypotheses") -> dict[str, Column]:
    """Return the columns of the track "hypotheses", given (N, M, 3, 3) R_m2c and, if there are any, weights (N, M).

    Args:
        hypotheses: as a caller gave them.
        weights: as a caller gave them, or None.
        images: N, how many there are.
        name: of the caller's argument, for the line that mends it.

    Raises:
        SettingsError: a wrong shape or type, where what was meant can be told.
    """

    def remedy() -> str:
        return remedies.remedy_for_array(hypotheses, images, name)

    array = to_array(hypotheses, name, remedy)
    is_formed = array.dtype.str in REALS and array.ndim == 4 and array.shape[2:] == (3, 3) and len(array) == images
    if not is_formed and (mending := remedy()):
        found = f"{array.dtype} of shape {array.shape}"
        raise SettingsError(f"{name}: expected float32 or float64 of shape ({images}, M, 3, 3), found {found}{mending}")
    columns = {"hypotheses": given_column(hypotheses, name)}
    if weights is not None:
        columns["hypothesis_weights"] = given_column(weights, "hypothesis_weights")
    return columns


def given_column(given: Any, name: str) -> Column:
    """Return what a caller gave for a data set as a column.

    Raises:
        SettingsError: it is no array of numbers.
    """
    array = to_array(given, name, lambda: remedies.remedy_for_numbers(given, name))
    if array.ndim == 0:
        raise SettingsError(f"{name}: expected an array, found the number {array}")
    return whole_column(array)


def refuse_no_callable(given: Any, name: str, advice: str) -> None:
    """Refuse what is no callable.

    Raises:
        SettingsError: it is none; `advice` ends the message.
    """
    if not callable(given):
        raise SettingsError(f"{name}: expected a callable, found {type(given).__name__}{advice}")


def _grid_attributes(level: int, batch_size: int) -> dict[str, Any]:
    """Return what a file says about its grid, after checking what a writer was told about it."""
    if not is_level(level):
        raise SettingsError(f"level: expected 0 to {MAX_GRID_LEVEL}, found {level!r}")
    if batch_size < 1:
        raise SettingsError(f"batch_size: expected at least 1, found {batch_size}")
    return {"grid_level": level, "grid_sha256": grid_sha256(level)}
