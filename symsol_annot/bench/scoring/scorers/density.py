"""How a density on the grid is scored: log-likelihood and spread, each beside that of the best density there."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.counted import grid_distances, grid_inside
from symsol_annot.bench.predictions.tracks.density import DENSITY, DENSITY_FLOOR, DensityBlock, DensityReader
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring import metrics
from symsol_annot.bench.scoring.averages import Figure
from symsol_annot.bench.scoring.metric import HIGHER, LOWER, NEITHER, Metric, Place, Values
from symsol_annot.bench.scoring.scorers.scorer import ASKED_OTHERWISE, GridScorer, TrackScoring
from symsol_annot.rotations.nearest import nearest_angles
from symsol_annot.rotations.so3 import Angles

REGIONS = (50, 80, 90, 95, 99)  # masses, in percent, of the smallest regions in which members are counted
SHOWN_REGION = 90
_LOWEST_FLOOR = 1e-300  # `write_density`'s own, under which no figure that is read depends on it
EXACT_NATS = 0.01  # below the ceiling: all of the mass is on the cells of the set


@dataclass(frozen=True, eq=False)
class MeasuredDensity:
    """What is measured of the densities of b images; "ceiling" is the best density that the grid allows.

    Attributes:
        at_members: (b,) the log-likelihood at the members.
        ceiling_at_members: (b,) the ceiling's.
        at_gt: (b,) the log-likelihood at R_gt.
        ceiling_at_gt: (b,) the ceiling's.
        spread_rad: (b,) the expected angle to the nearest member.
        spread_at_ceiling_rad: (b,) the ceiling's.
        in_regions: (b, 5) the share of the members that the smallest regions of the masses REGIONS hold.
    """

    at_members: Values
    ceiling_at_members: Values
    at_gt: Values
    ceiling_at_gt: Values
    spread_rad: Values
    spread_at_ceiling_rad: Values
    in_regions: Values


def region_metric(percent: int) -> str:
    """Return the name of the metric that tells how much of a set the smallest region of a mass holds."""
    return f"set_in_region_of_{percent}_percent"


def _in_region(column: int) -> Callable[[MeasuredDensity], Values]:
    return lambda of: of.in_regions[:, column]


METRICS: tuple[Metric[MeasuredDensity], ...] = (
    Metric("log_likelihood", HIGHER, Place.SUMMARY, lambda of: of.at_members, "log-likelihood", row=1),
    Metric(
        "log_likelihood_ceiling",
        NEITHER,
        Place.SUMMARY,
        lambda of: of.ceiling_at_members,
        "ceiling",
        row=2,
        is_detail=True,
    ),
    Metric("log_likelihood_at_gt", HIGHER, Place.TABLES, lambda of: of.at_gt, "log-likelihood at R_gt", row=3),
    Metric(
        "log_likelihood_at_gt_ceiling",
        NEITHER,
        Place.TABLES,
        lambda of: of.ceiling_at_gt,
        "ceiling",
        row=4,
        is_detail=True,
    ),
    Metric("spread_rad", LOWER, Place.SUMMARY, lambda of: of.spread_rad, "spread, rad", row=5),
    Metric(
        "spread_at_ceiling_rad",
        NEITHER,
        Place.TABLES,
        lambda of: of.spread_at_ceiling_rad,
        "at the ceiling, rad",
        row=6,
        is_detail=True,
    ),
    *(
        Metric(
            region_metric(percent),
            NEITHER,
            Place.TABLES if percent == SHOWN_REGION else Place.FILE,
            _in_region(column),
            f"share of the set in the region of {percent}%",
            row=7,
        )
        for column, percent in enumerate(REGIONS)
    ),
)


class DensityScorer(GridScorer):
    """Scores the log-probabilities of cells."""

    metrics = METRICS

    def __init__(self, reader: DensityReader, truth: Truth) -> None:
        super().__init__(truth, reader.grid_level)
        self._counted = truth.counted_on(self._level)
        floor = reader.density_floor
        self.facts = {"grid_level": self._level, **({} if floor is None else {DENSITY_FLOOR: floor})}

    def _measure(self, block: DensityBlock) -> MeasuredDensity:
        self._try_conventions(block)
        columns, in_regions = np.zeros((6, len(block.image_index))), np.zeros((len(block.image_index), len(REGIONS)))
        for row, i in enumerate(block.image_index.tolist()):  # the angles of one image alone take 2 MiB
            columns[:, row], in_regions[row] = self._measure_image(i, *block.on_grid.row(row))
        at_members, best_at_members, at_gt, best_at_gt, spread_rad, best_spread_rad = columns
        return MeasuredDensity(at_members, best_at_members, at_gt, best_at_gt, spread_rad, best_spread_rad, in_regions)

    def _measure_image(
        self, i: int, indices: npt.NDArray[np.int64], stored: npt.NDArray[Any]
    ) -> tuple[tuple[float, ...], Values]:
        """Return what is measured of one image, in the order of `MeasuredDensity`, and what its regions hold."""
        size = len(self._grid)
        log_probability = stored.astype(np.float64)
        listed = np.exp(log_probability)
        rest = (1.0 - listed.sum()) / (size - len(listed)) if len(listed) < size else 1.0
        angles_rad, cells = self._set_on_grid(i)
        cell_of_gt = self._grid.nearest(self._truth.labels.rotation[i][None])
        best_cells, shares = np.unique(cells, return_counts=True)
        best = shares / len(cells)
        at_members, at_gt = (_looked_up(indices, log_probability, at, np.log(rest)) for at in (cells, cell_of_gt))
        best_at_members, best_at_gt = (_looked_up(best_cells, np.log(best), at, 0.0) for at in (cells, cell_of_gt))
        figures = (
            *(metrics.log_likelihood(p, size) for p in (at_members, best_at_members, at_gt, best_at_gt)),
            metrics.spread(listed, angles_rad[indices], angles_rad),
            float(best @ angles_rad[best_cells]),
        )
        of_members = _looked_up(indices, listed, cells, -1.0)
        return figures, metrics.share_in_regions(of_members, listed, size, np.array(REGIONS) / 100.0)

    def _set_on_grid(self, i: int) -> tuple[Angles, npt.NDArray[np.int64]]:
        """Return the angles from the grid (N,) to an image's set, and the cells (|S|,) of what the set consists of."""
        labels, is_counted = self._truth.labels, self._counted.is_counted[i]
        volume = labels.volume_of(i)
        if volume is None:
            symmetry_set = labels.symmetry_set(i)
            return symmetry_set.distance(self._grid.rotations), self._grid.nearest(symmetry_set.members)
        angles_rad, inside = grid_distances(volume, self._level), grid_inside(volume, self._level)
        if not is_counted.any():
            return angles_rad, inside
        members = labels.candidates(i)[is_counted]
        to_members = nearest_angles(self._grid.rotations, members)
        return np.minimum(angles_rad, to_members), np.concatenate([self._grid.nearest(members), inside])

    def chance_and_best(self, over_all: Mapping[str, Figure]) -> tuple[float, float]:
        """Return the log-likelihood of the uniform density, and that of the best density on this grid."""
        return -2.0 * float(np.log(np.pi)), over_all["log_likelihood_ceiling"].value

    def notes(self) -> tuple[str, ...]:
        """Return what its author should know: that another convention fits far better."""
        return self._conventions.notes(ASKED_OTHERWISE)


def _looked_up(
    indices: npt.NDArray[np.int64], values: npt.NDArray[np.float64], wanted: npt.NDArray[np.int64], otherwise: float
) -> npt.NDArray[np.float64]:
    """Return the values at wanted indices, and `otherwise` where one is not among the ascending `indices`."""
    place = np.searchsorted(indices, wanted)
    padded_indices, padded_values = np.append(indices, -1), np.append(values, otherwise)
    return np.where(padded_indices[place] == wanted, padded_values[place], otherwise)


def _caption(entry: Mapping[str, Any]) -> Iterator[str]:
    if entry.get(DENSITY_FLOOR, 0.0) > _LOWEST_FLOOR:
        yield f"  probabilities of cells under {entry[DENSITY_FLOOR]:g} were not told apart by its writer"


def _is_exact(figures: Mapping[str, Any]) -> bool:
    value, ceiling = (figures[name]["value"] for name in ("log_likelihood", "log_likelihood_ceiling"))
    return value is not None and ceiling is not None and value > ceiling - EXACT_NATS


DENSITY_SCORING = TrackScoring(
    track=DENSITY,
    open=DensityScorer,
    metrics=METRICS,
    caption=_caption,
    beside_rank=("log_likelihood_ceiling", "spread_rad"),
    is_exact=_is_exact,
)
