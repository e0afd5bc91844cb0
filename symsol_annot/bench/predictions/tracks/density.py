"""The track "density": log-probabilities of grid cells, which add up to 1 with those that are not listed."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Answers, Column, sparse_columns
from symsol_annot.bench.predictions.proposals import Predicted, heaviest
from symsol_annot.bench.predictions.tracks.on_grid import (
    GRID_ATTRIBUTES,
    ROUNDED,
    GridReader,
    SparseRows,
    grid_defaults,
)
from symsol_annot.bench.predictions.tracks.track import Flags, Indices, Track
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.rotations.grid import equivolumetric_grid, grid_size

DENSITY_FLOOR = "density_floor"  # optional: what the writer counts any smaller probability of a cell as
_LEAST_LOG = -1e6  # so that sums over images are finite
_ALL_LISTED = 1e-5  # how far from 1 the sum of a density may be that lists every cell
_FAINT = 0.01  # pictures leave out cells with less than this share of the densest


@dataclass(frozen=True, eq=False)
class DensityBlock:
    """Densities of b images: image_index (b,), and log-probabilities of grid cells."""

    image_index: Indices
    on_grid: SparseRows


class DensityReader(GridReader):
    """Reads the log-probabilities of the cells that are listed."""

    name, offsets, indices, values = "density", "density_offsets", "density_indices", "density_log_probabilities"

    @property
    def density_floor(self) -> float | None:
        """What the writer counts any smaller probability of a cell as; None where the file does not say."""
        floor = self._file.attributes.get(DENSITY_FLOOR)
        return None if floor is None else float(floor)

    def is_sound(self) -> bool:
        """Check attributes, shapes, types and the offsets, which are read."""
        is_sound = [
            self._structure.has_attributes(GRID_ATTRIBUTES, self.name),
            self._is_floor_sound(),
            self._are_rows_sound(),
        ]
        return all(is_sound)

    def _is_floor_sound(self) -> bool:
        if DENSITY_FLOOR not in {**self._file.attributes, **self._file.odd_attributes}:
            return True
        if not self._structure.has_attributes({DENSITY_FLOOR: float}, self.name):
            return False
        floor = self._file.attributes[DENSITY_FLOOR]
        if not 0.0 < floor < 1.0:
            fault = f"attribute {DENSITY_FLOOR!r}: expected more than 0 and less than 1, found {floor!r}"
            self._faults.add(self.name, fault)
            return False
        return True

    def blocks(self, image_index: Indices) -> Iterator[DensityBlock]:
        """Yield the images, but for blocks that have a fault."""
        for rows, on_grid in self._sparse_blocks(row_bytes=8):
            strange = on_grid.any_in_row(~((on_grid.values >= _LEAST_LOG) & (on_grid.values <= 0)))
            reason = f"{self.values!r} are not in [{_LEAST_LOG:g}, 0]{_mend_of_logs(on_grid.values)}"
            self._faults.add_rows(self.name, reason, rows.start, strange)
            good = self._check_indices(rows.start, on_grid) & ~strange
            if (self._check_mass(rows.start, on_grid, good) & good).all():
                yield DensityBlock(image_index[rows], on_grid)

    def proposals(self, truth: Truth) -> Callable[[DensityBlock, int], Predicted]:  # noqa: ARG002 - of all readers
        """Return what takes a block and a row of it to the densest cells."""
        grid = equivolumetric_grid(self.grid_level)

        def read(block: DensityBlock, row: int) -> Predicted:
            indices, log_probability = block.on_grid.row(row)
            relative = np.exp(log_probability.astype(np.float64) - log_probability.max(initial=-np.inf))
            seen = relative >= _FAINT
            return heaviest(grid[indices[seen]], relative[seen], left_out=int(np.count_nonzero(~seen)))

        return read

    def _check_mass(self, start: int, on_grid: SparseRows, good: Flags) -> Flags:
        """Check that the listed cells leave something to the others or, where all are listed, add up to 1."""
        mass = np.array(
            [np.exp(on_grid.row(r)[1].astype(np.float64)).sum() if good[r] else 0.0 for r in range(len(good))]
        )
        lists_all = np.diff(on_grid.offsets) == grid_size(self.grid_level)
        is_off = good & np.where(lists_all, np.abs(mass - 1.0) > _ALL_LISTED, mass >= 1.0)
        reason = "the listed cells must hold less than 1, so that something is left for the others (all listed: 1)"
        reason += "; subtract each image's scipy.special.logsumexp over the whole grid"
        self._faults.add_rows(self.name, reason, start, is_off, lambda row: f"they hold {mass[row]:.9g}")
        return ~is_off


def _mend_of_logs(values: npt.NDArray[Any]) -> str:
    """Return what to do where values are no logarithms of probabilities: they may be probabilities, or of a volume."""
    if not (values > 0).any():
        return "" if np.isfinite(values).all() else "; leave out the cells whose probability is 0"
    if (values >= 0).all() and (values <= 1).all():
        return "; these look like probabilities: write np.log(p), without the cells where p is 0"
    if values.max() <= ROUNDED:
        return "; write np.minimum(log_p, 0)"
    return "; of logarithms of a density, or of logits, subtract each image's scipy.special.logsumexp over the grid"


def _columns(answers: Answers) -> dict[str, Column]:
    return sparse_columns(answers, DensityReader.offsets, DensityReader.indices, DensityReader.values)


DENSITY = Track(
    reader=DensityReader,
    title="the densest cells of the grid",
    datasets=("density_offsets", "density_indices", "density_log_probabilities"),
    attributes={**GRID_ATTRIBUTES, DENSITY_FLOOR: float},
    defaults=grid_defaults,
    columns=_columns,
    ranked_by="log_likelihood",
)
