"""The track "hypotheses": rotations that a method proposes for each image (chapter 5)."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.advice.mends import mend_of_matrices
from symsol_annot.bench.predictions.columns import Answers, Column, whole_column
from symsol_annot.bench.predictions.format import MAX_HYPOTHESES, REALS, ROTATION_TOLERANCE
from symsol_annot.bench.predictions.proposals import Predicted, heaviest
from symsol_annot.bench.predictions.structure import Structure
from symsol_annot.bench.predictions.tracks.track import Flags, Indices, Track, TrackReader
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.rotations.so3 import Rotations, rotation_deviation
from symsol_annot.sets.dataset import Dataset

_EXACT = 1e-9  # a rotation of float64 is closer to SO(3); scores of it do not depend on a projection


@dataclass(frozen=True, eq=False)
class HypothesesBlock:
    """Hypotheses of b images: image_index (b,), hypotheses (b, M, 3, 3) f8, weights (b, M) f8 or None for all alike."""

    image_index: Indices
    hypotheses: Rotations
    weights: npt.NDArray[np.float64] | None


class HypothesesReader(TrackReader):
    """Reads hypotheses and their weights; rounding is taken out of the rotations."""

    name = "hypotheses"

    def __init__(self, structure: Structure) -> None:
        super().__init__(structure)
        self._has_weights = structure.has("hypothesis_weights")

    @property
    def count(self) -> int:
        """M, how many hypotheses an image has."""
        return self._structure.facts("hypotheses").shape[1]

    def is_sound(self) -> bool:
        """Check shapes, types and M."""
        structure = self._structure
        is_shaped = structure.is_shaped("hypotheses", REALS, (structure.rows, "M", 3, 3))
        if is_shaped and not 1 <= self.count <= MAX_HYPOTHESES:
            self._faults.add(self.name, f"M = {self.count}: 1 to {MAX_HYPOTHESES} hypotheses per image are read")
            return False
        if self._has_weights:
            count: int | str = self.count if is_shaped else "M"
            return structure.is_shaped("hypothesis_weights", REALS, (structure.rows, count)) and is_shaped
        return is_shaped

    def blocks(self, image_index: Indices) -> Iterator[HypothesesBlock]:
        """Yield the images that have no fault."""
        structure = self._structure
        tolerance = ROTATION_TOLERANCE[structure.facts("hypotheses").dtype]
        step = max(1, self.block_bytes // (72 * self.count))
        for start in range(0, len(image_index), step):
            stop = min(start + step, len(image_index))
            hypotheses = structure.read_reals("hypotheses", start, stop)
            weights, used = None, np.ones(hypotheses.shape[:2], dtype=bool)
            good = np.ones(stop - start, dtype=bool)
            if self._has_weights:
                weights = structure.read_reals("hypothesis_weights", start, stop)
                good, used = self._check_weights(start, weights), weights > 0
            good &= self._check_rotations(start, hypotheses, used, tolerance)  # and rounding is taken out of them
            yield HypothesesBlock(
                image_index[start:stop][good], hypotheses[good], None if weights is None else weights[good]
            )

    def proposals(self, truth: Truth) -> Callable[[HypothesesBlock, int], Predicted]:  # noqa: ARG002 - of all readers
        """Return what takes a block and a row of it to the hypotheses that are not absent."""

        def read(block: HypothesesBlock, row: int) -> Predicted:
            weights = np.ones(block.hypotheses.shape[1]) if block.weights is None else block.weights[row]
            return heaviest(block.hypotheses[row][weights > 0], weights[weights > 0])

        return read

    def _check_weights(self, start: int, weights: npt.NDArray[np.float64]) -> Flags:
        is_number = (np.isfinite(weights) & (weights >= 0)).all(axis=1)
        has_positive = (weights > 0).any(axis=1)
        self._faults.add_rows(self.name, "'hypothesis_weights' are not all finite and at least 0", start, ~is_number)
        reason = "'hypothesis_weights' has no positive one"
        self._faults.add_rows(self.name, reason, start, is_number & ~has_positive)
        return is_number & has_positive

    def _check_rotations(self, start: int, hypotheses: Rotations, used: Flags, tolerance: float) -> Flags:
        is_finite = np.isfinite(hypotheses).all(axis=(2, 3)) | ~used
        self._faults.add_rows(self.name, "'hypotheses' has a NaN or an infinite entry", start, ~is_finite.all(axis=1))
        off = np.where(used & is_finite, _deviation(hypotheses), 0.0)
        is_off = (off > tolerance).any(axis=1)
        rounded = (off > _EXACT) & (off <= tolerance)
        hypotheses[rounded] = _projected(hypotheses[rounded])

        def describe(row: int) -> str:
            m = int(np.argmax(off[row]))
            is_reflection = _deviation(-hypotheses[row, m]) < 0.1
            return f"hypothesis {m}, off by {off[row, m]:.2g}{', with determinant -1' if is_reflection else ''}"

        reason = f"'hypotheses' holds a matrix that is no rotation (R^T R = I and det R = 1 within {tolerance:g})"
        reason += mend_of_matrices(float(off[is_off].max(initial=0.0)))
        self._faults.add_rows(self.name, reason, start, is_off, describe)
        return is_finite.all(axis=1) & ~is_off


def _projected(R: Rotations) -> Rotations:
    """Return the rotations nearest to (n, 3, 3) matrices close to rotations, by a step of Newton's for R^T R = I.

    What was off by e before is off by e^2 after: of 1e-4, which is the most that is read, 1e-8.
    """
    nearest: Rotations = R @ (3.0 * np.eye(3) - np.swapaxes(R, -1, -2) @ R) / 2.0
    return nearest


def _deviation(R: Rotations) -> npt.NDArray[np.float64]:
    """Return how far matrices are from SO(3), infinite where that cannot be computed."""
    deviation = rotation_deviation(R)
    return np.where(np.isnan(deviation), np.inf, deviation)


def _padded(answers: Answers) -> dict[str, Column]:
    """Return columns in which every image has as many hypotheses, the added ones with weight 0."""
    hypotheses = list(answers.each("hypotheses"))
    most = max(len(h) for h in hypotheses)
    dtype = min((h.dtype for h in hypotheses), key=lambda dtype: dtype.itemsize)  # a file has one precision
    rows = np.tile(np.eye(3, dtype=dtype), (len(hypotheses), most, 1, 1))
    weights = np.zeros((len(hypotheses), most), dtype=np.float32)
    for row, weight, h in zip(rows, weights, hypotheses, strict=True):
        row[: len(h)], weight[: len(h)] = h, 1.0
    columns = {"hypotheses": whole_column(rows)}
    return columns if weights.all() else {**columns, "hypothesis_weights": whole_column(weights)}


def _no_defaults(_dataset: Dataset, _given: Mapping[str, Any]) -> dict[str, Any]:
    return {}


HYPOTHESES = Track(
    reader=HypothesesReader,
    title="the hypotheses",
    datasets=("hypotheses", "hypothesis_weights"),
    attributes={},
    defaults=_no_defaults,
    columns=_padded,
    ranked_by="f_measure_at_5_deg",
    ranked_by_if_there="f_measure_unweighted_at_5_deg",  # small weights must not make many guesses free
)
