"""The tracks of a predictions file: each checked, and read in blocks of bounded size."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.advice.mends import mend_of_matrices
from symsol_annot.bench.predictions.format import (
    CLASSIFIER_ATTRIBUTES,
    DENSITY_FLOOR,
    GRID_ATTRIBUTES,
    INTEGERS,
    MAX_GRID_LEVEL,
    MAX_HYPOTHESES,
    REALS,
    ROTATION_TOLERANCE,
    STANDARD_THRESHOLD,
    is_level,
)
from symsol_annot.bench.predictions.queries import query_count
from symsol_annot.bench.predictions.structure import Structure
from symsol_annot.rotations.grid import grid_size
from symsol_annot.rotations.so3 import Rotations, rotation_deviation

_BLOCK_BYTES = 2**24
_BLOCK_ENTRIES = 2**21
_LEAST_LOG = -1e6  # so that sums over images are finite
_EXACT = 1e-9  # a rotation of float64 is closer to SO(3); scores of it do not depend on a projection
_ROUNDED = 1e-3  # outside of what is allowed, by less than a mistake would be
_ALL_LISTED = 1e-5  # how far from 1 the sum of a density may be that lists every cell

Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


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
        """Return the indices and values of one image."""
        entries = slice(self.offsets[r], self.offsets[r + 1])
        return self.indices[entries], self.values[entries]

    def any_in_row(self, flags: Flags) -> Flags:
        """Return for each image whether any of its entries is flagged."""
        before = np.concatenate([[0], np.cumsum(flags)])
        return before[self.offsets[1:]] > before[self.offsets[:-1]]


@dataclass(frozen=True, eq=False)
class HypothesesBlock:
    """Hypotheses of b images: image_index (b,), hypotheses (b, M, 3, 3) f8, weights (b, M) f8 or None for all alike."""

    image_index: Indices
    hypotheses: Rotations
    weights: npt.NDArray[np.float64] | None


@dataclass(frozen=True, eq=False)
class ClassifierBlock:
    """A classifier's answers about b images: image_index (b,), query_probability (b, Q) as stored, and on the grid."""

    image_index: Indices
    query_probability: npt.NDArray[Any]
    on_grid: SparseRows


@dataclass(frozen=True, eq=False)
class DensityBlock:
    """Densities of b images: image_index (b,), and log-probabilities of grid cells."""

    image_index: Indices
    on_grid: SparseRows


class HypothesesTrack:
    """Rotations that a method proposes for each image (chapter 5)."""

    name = "hypotheses"

    def __init__(self, structure: Structure) -> None:
        self._structure, self._faults = structure, structure.faults
        self._has_weights = structure.has("hypothesis_weights")

    @property
    def count(self) -> int:
        """M, how many hypotheses an image has."""
        return self._structure.facts("hypotheses").shape[1]

    def is_sound(self) -> bool:
        """Check what can be known without reading."""
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
        step = max(1, _BLOCK_BYTES // (72 * self.count))
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


class _GridTrack:
    """What the tracks on the grid share: sparse rows."""

    name: str
    offsets: str
    indices: str
    values: str

    def __init__(self, structure: Structure) -> None:
        self._structure, self._faults, self._file = structure, structure.faults, structure.file
        self._bounds: Indices = np.zeros(1, dtype=np.int64)  # the offsets, once they are known to be sound

    @property
    def grid_level(self) -> int:
        """Of the grid that it is on."""
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
        most_rows = max(1, _BLOCK_BYTES // row_bytes)
        start = 0
        while start < len(bounds) - 1:
            fitting = int(np.searchsorted(bounds, bounds[start] + _BLOCK_ENTRIES, side="right")) - 1
            stop = min(max(start + 1, fitting), start + most_rows, len(bounds) - 1)
            first, last = int(bounds[start]), int(bounds[stop])
            indices = self._file.read(self.indices, first, last).astype(np.int64)
            values = self._file.read(self.values, first, last)
            rows = SparseRows(bounds[start : stop + 1] - first, indices, values)
            yield slice(start, stop), rows
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


class ClassifierTrack(_GridTrack):
    """Probabilities that rotations are in an image's set, at its queries and on the grid (chapter 7)."""

    name, offsets, indices, values = "classifier", "grid_offsets", "grid_indices", "grid_probabilities"

    @property
    def floor(self) -> float:
        """The probability above which answers on the grid are listed."""
        return float(self._file.attributes["floor"])

    def is_sound(self) -> bool:
        """Check what can be known without reading, and the offsets."""
        structure = self._structure
        queries = query_count(len(structure.truth.labels.symmetry_group))
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


class DensityTrack(_GridTrack):
    """Log-probabilities of grid cells."""

    name, offsets, indices, values = "density", "density_offsets", "density_indices", "density_log_probabilities"

    @property
    def density_floor(self) -> float | None:
        """What the writer counts any smaller probability of a cell as; None where the file does not say."""
        floor = self._file.attributes.get(DENSITY_FLOOR)
        return None if floor is None else float(floor)

    def is_sound(self) -> bool:
        """Check what can be known without reading, and the offsets."""
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


def _mend_of_probabilities(values: npt.NDArray[Any]) -> str:
    """Return what to do where values are no probabilities: they may be logits, or off by rounding."""
    if not np.isfinite(values).all():
        return ""
    if values.min() < -_ROUNDED or values.max() > 1.0 + _ROUNDED:
        return "; logits become probabilities by 1 / (1 + np.exp(-x))"
    return "; write np.clip(p, 0, 1)"


def _mend_of_logs(values: npt.NDArray[Any]) -> str:
    """Return what to do where values are no logarithms of probabilities: they may be probabilities, or of a volume."""
    if not (values > 0).any():
        return "" if np.isfinite(values).all() else "; leave out the cells whose probability is 0"
    if (values >= 0).all() and (values <= 1).all():
        return "; these look like probabilities: write np.log(p), without the cells where p is 0"
    if values.max() <= _ROUNDED:
        return "; write np.minimum(log_p, 0)"
    return "; of logarithms of a density, or of logits, subtract each image's scipy.special.logsumexp over the grid"


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


Track = HypothesesTrack | ClassifierTrack | DensityTrack
