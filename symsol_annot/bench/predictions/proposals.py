"""The rotations that a predictions file proposes for each image, as pictures show them."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.reader import Predictions
from symsol_annot.bench.predictions.tracks import (
    ClassifierBlock,
    ClassifierTrack,
    DensityBlock,
    DensityTrack,
    HypothesesBlock,
    HypothesesTrack,
    Track,
)
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.rotations.so3 import Rotations

MAX_ROTATIONS = 1000  # of one image
_FAINT = 0.01  # cells of a density with less than this share of the densest are left out

WHAT = {
    "hypotheses": "the hypotheses",
    "classifier": f"the rotations claimed with p > {STANDARD_THRESHOLD}: candidates of the image, and the grid",
    "density": "the densest cells of the grid",
}

Weights = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is predicted for one image.

    Attributes:
        rotations: (n, 3, 3) R_m2c, the heaviest first.
        weights: (n,) in (0, 1], relative to the heaviest.
        left_out: how many more there are.
    """

    rotations: Rotations
    weights: Weights
    left_out: int


def predicted_rotations(predictions: Predictions, track: Track) -> list[Predicted]:
    """Return what a track says of each image of its split, see `WHAT`.

    Raises:
        PredictionsError: the contents have faults, all of which it lists.
    """
    read = _reader(track, predictions.truth)
    found: dict[int, Predicted] = {}
    for block in predictions.blocks(track):
        for row, image in enumerate(block.image_index):
            found[int(image)] = read(block, row)
    predictions.raise_faults()
    return [found[image] for image in sorted(found)]


def _reader(track: Track, truth: Truth) -> Callable[[Any, int], Predicted]:
    """Return what takes a block and a row of it to what is predicted for that image."""
    match track:
        case HypothesesTrack():
            return _hypotheses
        case ClassifierTrack():
            return _Claims(truth, track.grid_level).of
        case DensityTrack():
            grid = equivolumetric_grid(track.grid_level)
            return lambda block, row: _density(block, row, grid)


def _hypotheses(block: HypothesesBlock, row: int) -> Predicted:
    weights = np.ones(block.hypotheses.shape[1]) if block.weights is None else block.weights[row]
    return _heaviest(block.hypotheses[row][weights > 0], weights[weights > 0])


class _Claims:
    """The rotations that a classifier claims of an image."""

    def __init__(self, truth: Truth, grid_level: int) -> None:
        self._labels = truth.labels
        self._queries = Queries(truth.fingerprint, truth.labels.symmetry_group)
        self._grid = equivolumetric_grid(grid_level)

    def of(self, block: ClassifierBlock, row: int) -> Predicted:
        image = int(block.image_index[row])
        asked = self._queries.unshuffle(image, block.query_probability[row])[0]
        candidates = self._labels.rotation[image] @ self._labels.symmetry_group
        indices, probability = block.on_grid.row(row)
        rotations, weights = np.concatenate([candidates, self._grid[indices]]), np.concatenate([asked, probability])
        claimed = weights > STANDARD_THRESHOLD
        return _heaviest(rotations[claimed], weights[claimed].astype(np.float64))


def _density(block: DensityBlock, row: int, grid: Rotations) -> Predicted:
    indices, log_probability = block.on_grid.row(row)
    relative = np.exp(log_probability.astype(np.float64) - log_probability.max(initial=-np.inf))
    seen = relative >= _FAINT
    predicted = _heaviest(grid[indices[seen]], relative[seen])
    return Predicted(predicted.rotations, predicted.weights, len(indices) - len(predicted.weights))


def _heaviest(rotations: Rotations, weights: Weights) -> Predicted:
    order = np.argsort(-weights, kind="stable")[:MAX_ROTATIONS]
    heaviest = weights.max(initial=0.0)
    relative = weights[order] / heaviest if heaviest else weights[order]
    return Predicted(rotations[order], relative, len(weights) - len(order))
