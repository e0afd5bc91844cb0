"""The track "classifier": probabilities that rotations are in an image's set, at its queries and on the grid."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Answers, Column, dense_column, sparse_columns
from symsol_annot.bench.predictions.format import REALS, STANDARD_THRESHOLD
from symsol_annot.bench.predictions.proposals import Predicted, heaviest
from symsol_annot.bench.predictions.queries import Queries, group_sha256, query_count
from symsol_annot.bench.predictions.tracks.on_grid import (
    GRID_ATTRIBUTES,
    ROUNDED,
    GridReader,
    SparseRows,
    grid_defaults,
)
from symsol_annot.bench.predictions.tracks.track import Indices, Track
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.rotations.grid import equivolumetric_grid
from symsol_annot.sets.dataset import Dataset

DEFAULT_FLOOR = 0.1  # the probability up to which a writer lists no grid rotation
CLASSIFIER_ATTRIBUTES: dict[str, type] = {**GRID_ATTRIBUTES, "group_sha256": str, "floor": float}


@dataclass(frozen=True, eq=False)
class ClassifierBlock:
    """A classifier's answers about b images: image_index (b,), query_probability (b, Q) as stored, and on the grid."""

    image_index: Indices
    query_probability: npt.NDArray[Any]
    on_grid: SparseRows


class ClassifierReader(GridReader):
    """Reads the answers at the queries and on the grid (chapter 7)."""

    name, offsets, indices, values = "classifier", "grid_offsets", "grid_indices", "grid_probabilities"

    @property
    def floor(self) -> float:
        """The probability above which answers on the grid are listed."""
        return float(self._file.attributes["floor"])

    def is_sound(self) -> bool:
        """Check attributes, shapes, types and the offsets, which are read."""
        structure = self._structure
        queries = query_count(len(structure.about.symmetry_group))
        is_sound = [
            structure.has_attributes(CLASSIFIER_ATTRIBUTES, self.name),
            structure.is_shaped("query_probability", REALS, (structure.rows, queries)),
            self._are_rows_sound(),
        ]
        floor = self._file.attributes.get("floor")
        if isinstance(floor, int | float) and not 0 <= floor <= STANDARD_THRESHOLD:
            self._faults.add(self.name, f"attribute 'floor': expected 0 to {STANDARD_THRESHOLD}, found {floor!r}")
            return False
        return all(is_sound)

    def blocks(self, image_index: Indices) -> Iterator[ClassifierBlock]:
        """Yield the images, but for blocks that have a fault."""
        for rows, on_grid in self._sparse_blocks(8 * self._structure.facts("query_probability").shape[1]):
            probability = self._file.read("query_probability", rows.start, rows.stop)
            strange = ~((probability >= 0) & (probability <= 1)).all(axis=1)  # NaN is strange too
            mend = _mend_of_probabilities(probability) if strange.any() else ""
            not_above = on_grid.any_in_row(~((on_grid.values > self.floor) & (on_grid.values <= 1)))
            self._faults.add_rows(self.name, f"'query_probability' is not in [0, 1]{mend}", rows.start, strange)
            reason = f"{self.values!r} are not above the floor {self.floor:g} and at most 1"
            self._faults.add_rows(self.name, reason, rows.start, not_above)
            if (self._check_indices(rows.start, on_grid) & ~strange & ~not_above).all():
                yield ClassifierBlock(image_index[rows], probability, on_grid)

    def proposals(self, truth: Truth) -> Callable[[ClassifierBlock, int], Predicted]:
        """Return what takes a block and a row of it to the rotations that are claimed of that image."""
        labels, grid = truth.labels, equivolumetric_grid(self.grid_level)
        queries = Queries(truth.fingerprint, labels.symmetry_group)

        def read(block: ClassifierBlock, row: int) -> Predicted:
            image = int(block.image_index[row])
            asked = queries.unshuffle(image, block.query_probability[row])[0]
            candidates = labels.rotation[image] @ labels.symmetry_group
            indices, probability = block.on_grid.row(row)
            rotations, weights = np.concatenate([candidates, grid[indices]]), np.concatenate([asked, probability])
            claimed = weights > STANDARD_THRESHOLD
            return heaviest(rotations[claimed], weights[claimed].astype(np.float64))

        return read


def _mend_of_probabilities(values: npt.NDArray[Any]) -> str:
    """Return what to do where values are no probabilities: they may be logits, or off by rounding."""
    if not np.isfinite(values).all():
        return ""
    if values.min() < -ROUNDED or values.max() > 1.0 + ROUNDED:
        return "; logits become probabilities by 1 / (1 + np.exp(-x))"
    return "; write np.clip(p, 0, 1)"


def _columns(answers: Answers) -> dict[str, Column]:
    reader = ClassifierReader
    return {
        "query_probability": dense_column(answers, "query_probability"),
        **sparse_columns(answers, reader.offsets, reader.indices, reader.values),
    }


def _defaults(dataset: Dataset, given: Mapping[str, Any]) -> dict[str, Any]:
    return {
        **grid_defaults(dataset, given),
        "group_sha256": group_sha256(dataset.symmetry_group),
        "floor": DEFAULT_FLOOR,
    }


CLASSIFIER = Track(
    reader=ClassifierReader,
    title=f"the rotations claimed with p > {STANDARD_THRESHOLD}: candidates of the image, and the grid",
    datasets=("query_probability", "grid_offsets", "grid_indices", "grid_probabilities"),
    attributes=CLASSIFIER_ATTRIBUTES,
    defaults=_defaults,
    columns=_columns,
    ranked_by="f_measure",
    why_not_sealed="an image's queries hold its rotation among 8 decoys, and so tell most of its label",
)
