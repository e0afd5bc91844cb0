"""How a classifier is scored: recall, precision and F-measure of what it claims (section 7.2)."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.bench.predictions.advice.normalisation_tried import NormalisationTried
from symsol_annot.bench.predictions.counted import grid_distances, grid_inside
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER, ClassifierBlock, ClassifierReader
from symsol_annot.bench.predictions.tracks.track import Indices
from symsol_annot.bench.predictions.truth import HARD_NEGATIVE_RAD, Truth
from symsol_annot.bench.scoring import metrics
from symsol_annot.bench.scoring.averages import Figure
from symsol_annot.bench.scoring.metric import HIGHER, LOWER, NEITHER, Metric, Place, Values
from symsol_annot.bench.scoring.scorers.scorer import ASKED_OTHERWISE, GridScorer, TrackScoring

SWEPT_THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
EXACT_F = 0.999  # the members and next to nothing beside them: no function of R that is continuous ends so sharply
NEAR_SET_RAD = float(np.radians(0.5))
F_NOTE = (
    "  F is not compared from one stratum to another: a set of 720 has more grid rotations around it than a set of 1, "
    "but not 720 times as many, so that equally tight answers have other precisions."
)
_DECOY_FACTOR, _DECOY_SLACK = 3.0, 0.01


@dataclass(frozen=True, eq=False)
class MeasuredClassifier:
    """What is measured of a classifier's answers about b images, at T thresholds.

    Attributes:
        thresholds: (T,) the swept ones that are not below the file's floor.
        set_size: (b,) |S|.
        negatives: (b,) how many rotations the grid has outside the set's volume: |G| of a set without.
        true_positives: (b, T) members of the set that are claimed, and grid rotations inside its volume.
        false_positives: (b, T) other grid rotations that are claimed.
        far_positives: (b,) those beyond half a degree of the set, at the standard threshold.
        decoy_rate: (b,) the share of decoys that are claimed, at the standard threshold, of those outside the set's
            volume; NaN where there are none.
        hard_negative_rate: (b,) the share of the body's other candidates that are claimed, at the standard threshold;
            NaN where there are none that are far enough from the set.
    """

    thresholds: npt.NDArray[np.float64]
    set_size: metrics.Counts
    negatives: metrics.Counts
    true_positives: metrics.Counts
    false_positives: metrics.Counts
    far_positives: metrics.Counts
    decoy_rate: Values
    hard_negative_rate: Values

    @property
    def claimed_members(self) -> metrics.Counts:
        """(b,) true positives at the standard threshold."""
        return self.true_positives[:, self._number_of(STANDARD_THRESHOLD)]

    @property
    def claimed_of_grid(self) -> metrics.Counts:
        """(b,) false positives at the standard threshold."""
        return self.false_positives[:, self._number_of(STANDARD_THRESHOLD)]

    @cached_property
    def recall(self) -> Values:
        """(b, T)."""
        return metrics.recall(self.true_positives, self.set_size[:, None])

    @cached_property
    def precision(self) -> Values:
        """(b, T)."""
        return metrics.precision(self.true_positives, self.false_positives)

    @cached_property
    def f_measure(self) -> Values:
        """(b, T)."""
        return metrics.f_measure(self.true_positives, self.false_positives, self.set_size[:, None])

    def at(self, threshold: float, ratios: Values) -> Values | None:
        """Return the column (b,) of ratios (b, T) at a threshold; None where the file says nothing of it."""
        return ratios[:, self._number_of(threshold)] if threshold in self.thresholds else None

    def _number_of(self, threshold: float) -> int:
        return int(np.searchsorted(self.thresholds, threshold))


def _metrics_above(threshold: float) -> tuple[Metric[MeasuredClassifier], ...]:
    """Return the metrics of the sweep at a threshold."""
    name, words = f"above_{threshold:g}", f"of p > {threshold:g}"
    return (
        Metric(f"recall_{name}", HIGHER, Place.FILE, lambda of: of.at(threshold, of.recall), f"recall {words}", "7.5"),
        Metric(
            f"precision_{name}",
            HIGHER,
            Place.FILE,
            lambda of: of.at(threshold, of.precision),
            f"precision {words}",
            "7.6",
        ),
        Metric(
            f"f_measure_{name}",
            HIGHER,
            Place.FILE,
            lambda of: of.at(threshold, of.f_measure),
            f"F-measure {words}",
            "7.8",
        ),
    )


def _standard(ratios_of: Callable[[MeasuredClassifier], Values]) -> Callable[[MeasuredClassifier], Values | None]:
    """Return what takes a measurement to some ratio's column at the standard threshold."""
    return lambda of: of.at(STANDARD_THRESHOLD, ratios_of(of))


METRICS: tuple[Metric[MeasuredClassifier], ...] = (
    Metric("recall", HIGHER, Place.SUMMARY, _standard(lambda of: of.recall), "recall", "7.5", row=1),
    Metric(
        "precision",
        HIGHER,
        Place.SUMMARY,
        _standard(lambda of: of.precision),
        "precision",
        "7.6",
        row=2,
    ),
    Metric(
        "f_measure",
        HIGHER,
        Place.SUMMARY,
        _standard(lambda of: of.f_measure),
        "F-measure",
        "7.8",
        row=4,
    ),
    Metric(
        "accuracy",
        HIGHER,
        Place.TABLES,
        lambda of: metrics.classifier_accuracy(of.claimed_members, of.claimed_of_grid, of.set_size, of.negatives),
        "accuracy",
        "7.7",
        row=5,
    ),
    Metric(
        "precision_beyond_half_degree",
        HIGHER,
        Place.TABLES,
        lambda of: metrics.precision(of.claimed_members, of.far_positives),
        "beyond 0.5 deg of the set",
        row=3,
        is_detail=True,
    ),
    Metric(
        "nothing_predicted_rate",
        NEITHER,
        Place.LEADERBOARD,
        lambda of: (of.claimed_members + of.claimed_of_grid == 0).astype(np.float64),
        "images without a positive",
        row=9,
    ),
    Metric(
        "grid_positive_rate",
        NEITHER,
        Place.TABLES,
        lambda of: metrics.share_of(of.claimed_of_grid, of.negatives),
        "grid positive rate",
        row=8,
    ),
    Metric(
        "decoy_false_positive_rate",
        LOWER,
        Place.TABLES,
        lambda of: of.decoy_rate,
        "decoy false positive rate",
        row=7,
    ),
    Metric("hard_negative_rate", LOWER, Place.SUMMARY, lambda of: of.hard_negative_rate, "hard negative rate", row=6),
    *(metric for threshold in SWEPT_THRESHOLDS for metric in _metrics_above(threshold)),
)


class ClassifierScorer(GridScorer):
    """Scores a classifier's answers at the queries and on the grid."""

    metrics = METRICS

    def __init__(self, reader: ClassifierReader, truth: Truth) -> None:
        super().__init__(truth, reader.grid_level)
        self._thresholds = np.array([t for t in SWEPT_THRESHOLDS if t >= reader.floor])
        self._queries = Queries(truth.fingerprint, truth.labels.symmetry_group)
        self._counted = truth.counted_on(self._level)
        self._rejected = truth.labels.rejected_beyond(HARD_NEGATIVE_RAD)
        self._normalisation = NormalisationTried(self._level)
        self.facts = {"floor": reader.floor, "threshold": STANDARD_THRESHOLD, "grid_level": self._level}

    def _measure(self, block: ClassifierBlock) -> MeasuredClassifier:
        self._try_conventions(block)
        images = len(block.image_index)
        true_positives, false_positives = np.zeros((2, images, len(self._thresholds)), dtype=np.int64)
        far_positives = np.zeros(images, dtype=np.int64)
        decoy_rate, hard_negative_rate = np.zeros((2, images))
        for row, i in enumerate(block.image_index.tolist()):
            asked = self._queries.unshuffle(i, block.query_probability[row])
            self._normalisation.add(asked)
            indices, probability = block.on_grid.row(row)
            true_positives[row] = _count_above(asked[0][self._counted.is_counted[i]], self._thresholds)
            volume = self._truth.labels.volume_of(i)
            if volume is not None:
                is_inside = np.isin(indices, grid_inside(volume, self._level), assume_unique=True)
                true_positives[row] += _count_above(probability[is_inside], self._thresholds)
                indices, probability = indices[~is_inside], probability[~is_inside]
            false_positives[row] = _count_above(probability, self._thresholds)
            far_positives[row] = self._count_far(i, indices[probability > STANDARD_THRESHOLD])
            decoy_rate[row] = _share(self._decoys(i, volume, asked[1:]) > STANDARD_THRESHOLD)
            hard_negative_rate[row] = _share(asked[0][self._rejected[i]] > STANDARD_THRESHOLD)
        return MeasuredClassifier(
            self._thresholds,
            self._counted.set_sizes[block.image_index],
            self._counted.negatives[block.image_index],
            true_positives,
            false_positives,
            far_positives,
            decoy_rate,
            hard_negative_rate,
        )

    def _decoys(self, i: int, volume: Volume | None, probability: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the probabilities (d,) of the decoys that are outside of the set, given those of all (8, G)."""
        if volume is None:
            return probability.ravel()
        return probability.ravel()[~volume.contains(self._queries.decoys(i).reshape(-1, 3, 3))]

    def _count_far(self, i: int, claimed: Indices) -> int:
        """Return how many of the claimed grid rotations are beyond half a degree of the symmetry set."""
        volume = self._truth.labels.volume_of(i)
        if volume is not None:
            claimed = claimed[grid_distances(volume, self._level)[claimed] > NEAR_SET_RAD]
        if not len(claimed):
            return 0
        near = self._grid.within(self._truth.labels.members(i), NEAR_SET_RAD)
        return len(claimed) - len(np.intersect1d(claimed, near, assume_unique=True))

    def chance_and_best(self, over_all: Mapping[str, Figure]) -> tuple[float, float]:  # noqa: ARG002 - as others need it
        """Return the F-measure of claiming everything, the most that chance gives, and that of the members alone."""
        sizes = self._counted.set_sizes
        everything = metrics.f_measure(sizes, self._counted.negatives, sizes)
        return float(everything.mean()), 1.0

    def tried(self) -> dict[str, Any]:
        """Return what notes are made of."""
        return {**super().tried(), "normalisation": self._normalisation.seen()}

    def try_too(self, tried: Mapping[str, Any]) -> None:
        """Take what another process's scorer has tried."""
        super().try_too(tried)
        self._normalisation.see(tried["normalisation"])

    def warnings(self, over_all: Mapping[str, Figure]) -> tuple[str, ...]:
        """Return why the result does not rank: it says yes to what it is asked, or is on another grid."""
        decoys, grid = (over_all[name].value for name in ("decoy_false_positive_rate", "grid_positive_rate"))
        if not decoys > _DECOY_FACTOR * grid + _DECOY_SLACK:  # NaN where all of SO(3) is in the sets
            return super().warnings(over_all)
        warning = (
            f"it claims {decoys:.2%} of the decoys, random rotations that it was asked about, but {grid:.3%} of the "
            "grid: its answers depend on being asked, and this score does not rank"
        )
        return (warning, *super().warnings(over_all))

    def notes(self) -> tuple[str, ...]:
        """Return what its author should know: that answers look normalised, or fit far better in another convention."""
        return (*self._normalisation.notes(), *self._conventions.notes(ASKED_OTHERWISE))


def _share(flags: npt.NDArray[np.bool_]) -> float:
    """Return the share of flags that are set; of none, NaN."""
    return float(flags.mean()) if len(flags) else np.nan


def _count_above(probability: npt.NDArray[Any], thresholds: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return how many probabilities are above each threshold, compared in the type that they are stored in."""
    in_order = np.sort(probability)
    return len(in_order) - np.searchsorted(in_order, thresholds.astype(in_order.dtype), side="right")


def _caption(entry: Mapping[str, Any]) -> Iterator[str]:
    yield f"  p > {entry['threshold']}, grid of level {entry['grid_level']}; the sweep is in --json"
    if "hidden" in entry:
        yield F_NOTE


def _is_exact(figures: Mapping[str, Any]) -> bool:
    value = figures["f_measure"]["value"]
    return value is not None and value > EXACT_F


CLASSIFIER_SCORING = TrackScoring(
    track=CLASSIFIER,
    open=ClassifierScorer,
    metrics=METRICS,
    caption=_caption,
    beside_rank=("recall", "precision", "hard_negative_rate"),
    is_exact=_is_exact,
)
