"""What a caller or its callable gave, checked: arrays of numbers, rotations, probabilities, log-densities.

Where what was meant can be told, a message ends with a line of code that mends it.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.advice import answer_remedies, remedies
from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.format import MAX_HYPOTHESES, ROTATION_TOLERANCE
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.errors import RotationError, SettingsError
from symsol_annot.rotations.so3 import Rotations, check_rotations

_UNLISTED_MASS = 1e-12  # what is left to the cells not listed, at the least
_COARSE_MASS = 1e-4  # what the cells together may have whose log-probabilities are rounded to _COARSE_STEP
_FINE_STEP, _COARSE_STEP = 2.0**-19, 2.0**-6


def to_array(given: Any, what: str, remedy: Callable[[], str] = str) -> Array:
    """Return what a caller gave as an array of numbers.

    Args:
        given: what should be one.
        what: it is called in a message.
        remedy: makes the end of the message that says how something else is mended.

    Raises:
        SettingsError: it is none.
    """
    try:
        array = np.asarray(given)
    except (ValueError, TypeError, RuntimeError) as error:  # rows of different lengths; a tensor elsewhere
        raise SettingsError(f"{what}: expected an array of numbers: {error}{remedy()}") from None
    if array.dtype.kind not in "biuf":
        found = f"{array.dtype} of shape {array.shape}"
        raise SettingsError(f"{what}: expected an array of numbers, found {found}{remedy()}")
    return array


def checked_hypotheses(returned: Any, i: int, mend: Callable[[Any], str] = remedies.remedy_for_answer) -> Array:
    """Return hypotheses (m, 3, 3) R_m2c about image i, f4 or f8 as they came.

    Args:
        returned: by a callable, or an entry of a list.
        i: the image.
        mend: from what was returned to the end of the message that says how it is mended.

    Raises:
        SettingsError: a wrong shape or type.
        RotationError: one of them is no rotation.
    """

    def remedy() -> str:
        return mend(returned)

    what = f"hypotheses of image {i}"
    hypotheses = to_array(returned, what, remedy)
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

    answer = to_array(returned, f"image {i}", remedy)
    if answer.shape != (count,):
        raise SettingsError(
            f"image {i}: asked about {count} rotations, the answer has the shape {answer.shape}{remedy()}"
        )
    return answer.astype(np.float64)


def probabilities(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float32]:
    """Return the probabilities (n,) that a callable gives rotations (n, 3, 3) of image i, asked batch by batch.

    Raises:
        SettingsError: a wrong shape or type, or a number outside [0, 1].
    """
    answers = _ask(f, i, rotations, batch_size, "classify").astype(np.float32)
    strange = ~((answers >= 0) & (answers <= 1))  # NaN is strange too
    if strange.any():
        remedy = answer_remedies.remedy_for_probabilities(answers)
        raise SettingsError(f"image {i}: expected probabilities from 0 to 1, found {answers[strange][0]}{remedy}")
    return answers


def log_densities(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float64]:
    """Return the log-densities (n,) that a callable gives rotations (n, 3, 3) of image i, asked batch by batch.

    Raises:
        SettingsError: a wrong shape or type, NaN, or nothing finite.
    """
    log_p = _ask(f, i, rotations, batch_size, "log_density")
    highest = log_p.max()
    if not np.isfinite(highest):  # NaN, if there is one
        remedy = answer_remedies.remedy_for_infinity() if highest == np.inf else ""
        raise SettingsError(f"image {i}: expected log-densities, at least one of them finite, found {highest}{remedy}")
    return log_p


def listed_density(log_p: npt.NDArray[np.float64], floor: float) -> Answer:
    """Return the cells (k,) that are stored, and their log-probabilities (k,), given those of all cells (n,).

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
