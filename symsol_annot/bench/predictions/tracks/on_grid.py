"""What the tracks on the equivolumetric grid share: sparse rows, values on some grid rotations for each image."""

from abc import ABC
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.format import INTEGERS, MAX_GRID_LEVEL, REALS, is_level
from symsol_annot.bench.predictions.structure import Structure
from symsol_annot.bench.predictions.tracks.track import Flags, Indices, TrackReader
from symsol_annot.rotations.grid import STANDARD_LEVEL, grid_sha256, grid_size
from symsol_annot.sets.dataset import Dataset

ROUNDED = 1e-3  # outside of what is allowed, by less than a mistake would be

GRID_ATTRIBUTES: dict[str, type] = {"grid_level": int, "grid_sha256": str}


@dataclass(frozen=True, eq=False)
class SparseRows:
    """Values on some grid rotations for each of b images.

    Attributes:
        offsets: (b + 1,) image r has the entries offsets[r] : offsets[r + 1].
        indices: (K,) grid indices, ascending within an image.
        values: (K,) f4 or f8, as stored.
    """

    offsets: Indices
    indices: Indices
    values: npt.NDArray[Any]

    def row(self, r: int) -> tuple[Indices, npt.NDArray[Any]]:
        """Return the indices (k,) and the values (k,) of one image."""
        entries = slice(self.offsets[r], self.offsets[r + 1])
        return self.indices[entries], self.values[entries]

    def any_in_row(self, flags: Flags) -> Flags:
        """Return for each image (b,) whether any of its entries is flagged, given flags (K,)."""
        before = np.concatenate([[0], np.cumsum(flags)])
        return before[self.offsets[1:]] > before[self.offsets[:-1]]


class GridReader(TrackReader, ABC):
    """Reads sparse rows from three data sets.

    Attributes:
        offsets: name of the data set (N + 1,).
        indices: name of the data set (K,) of grid indices.
        values: name of the data set (K,) of the values there.
        block_entries: how many of them are read at once.
    """

    block_entries: ClassVar[int] = 2**21
    offsets: ClassVar[str]
    indices: ClassVar[str]
    values: ClassVar[str]

    def __init__(self, structure: Structure) -> None:
        super().__init__(structure)
        self._bounds: Indices = np.zeros(1, dtype=np.int64)  # the offsets, once they are known to be sound

    @property
    def grid_level(self) -> int:
        """The level of the grid that it is on."""
        return int(self._file.attributes["grid_level"])

    def _are_rows_sound(self) -> bool:
        structure, level = self._structure, self._file.attributes.get("grid_level")
        bounds = "N + 1" if isinstance(structure.rows, str) else structure.rows + 1
        is_shaped = [
            structure.is_shaped(self.offsets, ("<i8", "<i4"), (bounds,)),
            structure.is_shaped(self.indices, INTEGERS, ("K",)),
            structure.is_shaped(self.values, REALS, ("K",)),
        ]
        if level is not None and not is_level(level):
            self._faults.add(self.name, f"attribute 'grid_level': expected 0 to {MAX_GRID_LEVEL}, found {level!r}")
            return False
        is_known = level is not None and isinstance(bounds, int)
        return is_known and all(is_shaped) and self._are_offsets_sound()

    def _are_offsets_sound(self) -> bool:
        entries, values = (self._structure.facts(name).shape[0] for name in (self.indices, self.values))
        if entries != values:
            self._faults.add(self.name, f"{self.indices!r} has {entries} entries, but {self.values!r} {values}")
            return False
        bounds, size = self._structure.read_integers(self.offsets), grid_size(self.grid_level)
        if bounds is None:
            return False
        self._bounds, steps = bounds, np.diff(bounds)
        if bounds[0] == 0 and bounds[-1] == entries and steps.min() >= 0 and steps.max() <= size:
            return True
        self._faults.add(
            self.name,
            f"{self.offsets!r}: expected ascending numbers from 0 to {entries} with steps of at most {size}, found "
            f"{bounds[0]} to {bounds[-1]} with steps of {steps.min()} to {steps.max()}",
        )
        return False

    def _sparse_blocks(self, row_bytes: int) -> Iterator[tuple[slice, SparseRows]]:
        """Yield runs of rows with a bounded number of entries, or one row with more."""
        bounds = self._bounds
        most_rows = max(1, self.block_bytes // row_bytes)
        start = 0
        while start < len(bounds) - 1:
            fitting = int(np.searchsorted(bounds, bounds[start] + self.block_entries, side="right")) - 1
            stop = min(max(start + 1, fitting), start + most_rows, len(bounds) - 1)
            first, last = int(bounds[start]), int(bounds[stop])
            indices = self._file.read(self.indices, first, last).astype(np.int64)
            values = self._file.read(self.values, first, last)
            yield slice(start, stop), SparseRows(bounds[start : stop + 1] - first, indices, values)
            start = stop

    def _check_indices(self, start: int, rows: SparseRows) -> Flags:
        size = grid_size(self.grid_level)
        outside = rows.any_in_row((rows.indices < 0) | (rows.indices >= size))
        falls = np.zeros(len(rows.indices), dtype=bool)
        falls[1:] = np.diff(rows.indices) <= 0
        begins = rows.offsets[:-1]
        falls[begins[begins < len(falls)]] = False
        unsorted = rows.any_in_row(falls)
        self._faults.add_rows(self.name, f"{self.indices!r} has an index outside 0 to {size - 1}", start, outside)
        self._faults.add_rows(self.name, f"{self.indices!r} are not ascending, or one is repeated", start, unsorted)
        return ~(outside | unsorted)


def grid_defaults(_dataset: Dataset, given: Mapping[str, Any]) -> dict[str, Any]:
    """Return what a file says of its grid where its writer was not told."""
    level = given.get("grid_level", STANDARD_LEVEL)
    return {"grid_level": level, "grid_sha256": grid_sha256(level)}
