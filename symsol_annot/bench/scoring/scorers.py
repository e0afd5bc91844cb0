"""A scorer a track: from one image's predictions and its truth to that image's figures."""

from functools import cached_property
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.advice.normalisation_tried import NormalisationTried
from symsol_annot.bench.predictions.format import STANDARD_THRESHOLD
from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks import (
    ClassifierBlock,
    ClassifierTrack,
    DensityBlock,
    DensityTrack,
    HypothesesBlock,
    HypothesesTrack,
)
from symsol_annot.bench.predictions.truth import Truth, near_elements
from symsol_annot.bench.scoring import metrics
from symsol_annot.bench.scoring.averages import Figure
from symsol_annot.bench.scoring.conventions_tried import ConventionsTried
from symsol_annot.bench.scoring.metric_table import ANGLES_DEG, F_UNWEIGHTED, RANKED_ANGLE_DEG, SWEPT_THRESHOLDS
from symsol_annot.rotations.grid import STANDARD_LEVEL, GridIndex, grid_size
from symsol_annot.rotations.nearest import angles_to_arcs, nearest_angles, nearest_angles_on_circles
from symsol_annot.rotations.so3 import Angles, Rotations

NEAR_SET_RAD = float(np.radians(0.5))
# Neighbours on the lattice are 1, 2, .. degrees apart, which is where the thresholds lie. An angle to a rotation that
# was rounded to float32, or multiplied in it, is off by less than the slack (docs/metrics.md, "Angles").
SLACK_RAD = 1e-6
_LABELS_SLACK_RAD = 1e-9  # between labels, which are float64
HARD_NEGATIVE_RAD = float(np.radians(5.0)) + _LABELS_SLACK_RAD
_MANY_MEMBERS = 24  # from where the circles are faster than all pairs
_DECOY_FACTOR, _DECOY_SLACK = 3.0, 0.01

_PAIRS_AT_ONCE = 2**20

Indices = npt.NDArray[np.int64]
Weights = npt.NDArray[np.float64]
Row = dict[str, tuple[float, float]]  # metric to value and weight
Facts = dict[str, float | int]
Warnings = tuple[str, ...]
Notes = tuple[str, ...]
FAVOURED_CELLS = 16
_ASKED_OTHERWISE = "where it is asked about the rotations R, answer about {code}"


def hypotheses_name(count: int) -> str:
    """Return how a result with M hypotheses per image is named, for its best possible recall depends on M."""
    return f"hypotheses (M = {count})"


class HypothesesScorer:
    """Recall and precision of hypotheses (section 5.2)."""

    def __init__(self, track: HypothesesTrack, truth: Truth) -> None:
        self._truth, self._conventions = truth, ConventionsTried(truth)
        self._thresholds_rad = np.radians(ANGLES_DEG) + SLACK_RAD
        self.name = hypotheses_name(track.count)
        self.facts: Facts = {"M": track.count}

    def score_block(self, block: HypothesesBlock) -> list[Row]:
        """Return the figures of each image."""
        for row, i in enumerate(block.image_index):
            if self._conventions.wants(int(i)):
                used = slice(None) if block.weights is None else block.weights[row] > 0
                self._conventions.add(int(i), block.hypotheses[row][used])
        if block.weights is not None:  # a hypothesis of weight 0 is absent, so that images differ in their counts
            rows = zip(block.image_index, block.hypotheses, block.weights, strict=True)
            return [self._score_image(int(i), h[w > 0], w[w > 0]) for i, h, w in rows]
        errors = self.errors(block.image_index, block.hypotheses)
        rows = zip(block.image_index, block.hypotheses, errors, strict=True)
        return [self._figures(int(i), h, None, *error) for i, h, error in rows]

    def _score_image(self, i: int, hypotheses: Rotations, weights: Weights) -> Row:
        errors = metrics.recall_and_precision_errors(self._truth.labels.symmetry_set(i), hypotheses)
        return self._figures(i, hypotheses, weights, *errors)

    def errors(self, image_index: Indices, hypotheses: Rotations) -> list[tuple[Angles, Angles]]:
        """Return both kinds of errors of each image; images with sets of one size go together, which is faster."""
        errors: list[tuple[Angles, Angles]] = [(np.zeros(0), np.zeros(0))] * len(image_index)
        sizes = self._truth.set_sizes[image_index]
        for size in np.unique(sizes):
            (alike,) = np.nonzero(sizes == size)
            step = max(1, _PAIRS_AT_ONCE // (int(size) * hypotheses.shape[1]))
            for rows in (alike[start : start + step] for start in range(0, len(alike), step)):
                sets = np.stack([self._truth.labels.symmetry_set(i) for i in image_index[rows]])
                both = metrics.recall_and_precision_errors(sets, hypotheses[rows])
                for row, *error in zip(rows, *both, strict=True):
                    errors[row] = (error[0], error[1])
        return errors

    def _figures(
        self, i: int, hypotheses: Rotations, weights: Weights | None, recall_errors: Angles, precision_errors: Angles
    ) -> Row:
        coverage = metrics.share_within(recall_errors, self._thresholds_rad)
        accuracy = metrics.share_within(precision_errors, self._thresholds_rad, weights)
        f_measure = metrics.harmonic_mean(coverage, accuracy)
        recall_error = metrics.mean_error(recall_errors)
        row: Row = {
            "recall_mean_error_rad": (recall_error, len(recall_errors)),
            "recall_mean_error_image_mean_rad": (recall_error, 1),
            "precision_mean_error_rad": (metrics.mean_error(precision_errors, weights), 1),
        }
        if self._truth.circles:
            mask = self._truth.labels.symmetry_mask[i]
            R_gt = self._truth.labels.rotation[i]
            to_arcs = angles_to_arcs(self._truth.circles, R_gt, mask, hypotheses, precision_errors)
            row["precision_mean_error_continuous_rad"] = (metrics.mean_error(to_arcs, weights), 1)
        for t, degrees in enumerate(ANGLES_DEG):
            row[f"coverage_at_{degrees}_deg"] = (coverage[t], len(recall_errors))
            row[f"coverage_image_mean_at_{degrees}_deg"] = (coverage[t], 1)
            row[f"accuracy_at_{degrees}_deg"] = (accuracy[t], 1)
            row[f"f_measure_at_{degrees}_deg"] = (f_measure[t], 1)
        if weights is not None:  # what ranks: small weights must not make many guesses free
            accuracy = metrics.share_within(precision_errors, self._thresholds_rad)
            row[F_UNWEIGHTED] = (metrics.harmonic_mean(coverage, accuracy)[ANGLES_DEG.index(RANKED_ANGLE_DEG)], 1)
        return row

    def warnings(self, over_all: dict[str, Figure]) -> Warnings:  # noqa: ARG002 - the scorers' common form
        """Return why the score does not rank: there is no such reason."""
        return ()

    def notes(self) -> Notes:
        """Return what its author should know: that another convention fits far better."""
        return self._conventions.notes("write {code} in place of the rotations R")


class _OnGrid:
    """What is scored on a grid, which is made when it is first needed."""

    def __init__(self, level: int) -> None:
        self._level = level

    @cached_property
    def _grid(self) -> GridIndex:
        return GridIndex(self._level)

    def _likeliest(self, indices: Indices, values: npt.NDArray[Any]) -> Rotations:
        """Return the rotations of the few cells that an image's answers favour; none where it favours none."""
        order = np.argsort(-values, kind="stable")[:FAVOURED_CELLS]
        return self._grid.rotations[indices[order]]


class ClassifierScorer(_OnGrid):
    """Recall, precision and F-measure of a classifier (section 7.2)."""

    name = "classifier"

    def __init__(self, track: ClassifierTrack, truth: Truth) -> None:
        super().__init__(track.grid_level)
        self._truth = truth
        self._thresholds = np.array([t for t in SWEPT_THRESHOLDS if t >= track.floor])
        self._standard = int(np.searchsorted(self._thresholds, STANDARD_THRESHOLD))
        self._queries = Queries(truth.fingerprint, truth.labels.symmetry_group)
        self._near = near_elements(truth.labels.symmetry_group, HARD_NEGATIVE_RAD)
        self.facts: Facts = {"floor": track.floor, "threshold": STANDARD_THRESHOLD, "grid_level": self._level}
        self._conventions, self._normalisation = ConventionsTried(truth), NormalisationTried(self._level)

    def score_block(self, block: ClassifierBlock) -> list[Row]:
        """Return the figures of each image."""
        for row, i in enumerate(block.image_index):
            if self._conventions.wants(int(i)):
                self._conventions.add(int(i), self._likeliest(*block.on_grid.row(row)))
        return [self._score_image(block, r) for r in range(len(block.image_index))]

    def _score_image(self, block: ClassifierBlock, r: int) -> Row:
        i = int(block.image_index[r])
        mask = self._truth.labels.symmetry_mask[i]
        asked = self._queries.unshuffle(i, block.query_probability[r])
        candidates, decoys = asked[0], asked[1:]
        self._normalisation.add(asked)
        grid_indices, grid_probability = block.on_grid.row(r)
        size, set_size, s = grid_size(self._level), int(mask.sum()), self._standard
        tp = _count_above(candidates[mask], self._thresholds)
        fp = _count_above(grid_probability, self._thresholds)
        recall, precision = metrics.recall(tp, set_size), metrics.precision(tp, fp)
        f_measure = metrics.f_measure(tp, fp, set_size)
        claimed = grid_indices[grid_probability > STANDARD_THRESHOLD]
        rejected = ~mask & ~(self._near @ mask)
        row: Row = {
            "recall": (recall[s], 1),
            "precision": (precision[s], 1),
            "f_measure": (f_measure[s], 1),
            "accuracy": (metrics.classifier_accuracy(tp, fp, set_size, size)[s], 1),
            "precision_beyond_half_degree": (self._precision_beyond(i, tp[s], claimed), 1),
            "nothing_predicted_rate": (float(tp[s] + fp[s] == 0), 1),
            "grid_positive_rate": (fp[s] / size, 1),
            "decoy_false_positive_rate": (float((decoys > STANDARD_THRESHOLD).mean()), 1),
            "hard_negative_rate": _share((candidates > STANDARD_THRESHOLD)[rejected]),
        }
        for t, threshold in enumerate(self._thresholds):
            row[f"recall_above_{threshold:g}"] = (recall[t], 1)
            row[f"precision_above_{threshold:g}"] = (precision[t], 1)
            row[f"f_measure_above_{threshold:g}"] = (f_measure[t], 1)
        return row

    def _precision_beyond(self, i: int, true_positives: int, claimed: npt.NDArray[np.int64]) -> float:
        """Return the precision without the grid rotations within half a degree of the symmetry set."""
        far = len(claimed)
        if far:
            near = self._grid.within(self._truth.labels.symmetry_set(i), NEAR_SET_RAD)
            far -= len(np.intersect1d(claimed, near, assume_unique=True))
        return float(metrics.precision(np.array(true_positives), np.array(far)))

    def warnings(self, over_all: dict[str, Figure]) -> Warnings:
        """Return why the score does not rank: another grid, or it says yes to what it is asked."""
        decoys, grid = (over_all[name].value for name in ("decoy_false_positive_rate", "grid_positive_rate"))
        if decoys <= _DECOY_FACTOR * grid + _DECOY_SLACK:
            return _grid_warnings(self._level)
        warning = (
            f"it claims {decoys:.2%} of the decoys, random rotations that it was asked about, but {grid:.3%} of the "
            "grid: its answers depend on being asked, and this score does not rank"
        )
        return (warning, *_grid_warnings(self._level))

    def notes(self) -> Notes:
        """Return what its author should know: that answers look normalised, or fit far better in another convention."""
        return (*self._normalisation.notes(), *self._conventions.notes(_ASKED_OTHERWISE))


class DensityScorer(_OnGrid):
    """Log-likelihood and spread of a density on the grid, each beside that of the best density there."""

    name = "density"

    def __init__(self, track: DensityTrack, truth: Truth) -> None:
        super().__init__(track.grid_level)
        self._truth, self._conventions = truth, ConventionsTried(truth)
        floor = track.density_floor
        self.facts: Facts = {"grid_level": self._level, **({} if floor is None else {"density_floor": floor})}

    def score_block(self, block: DensityBlock) -> list[Row]:
        """Return the figures of each image."""
        for row, i in enumerate(block.image_index):
            if self._conventions.wants(int(i)):
                self._conventions.add(int(i), self._likeliest(*block.on_grid.row(row)))
        return [self._score_image(block, r) for r in range(len(block.image_index))]

    def _score_image(self, block: DensityBlock, r: int) -> Row:
        i, size, labels = int(block.image_index[r]), len(self._grid), self._truth.labels
        members = labels.symmetry_set(i)
        indices, stored = block.on_grid.row(r)
        log_probability = stored.astype(np.float64)
        listed = np.exp(log_probability)
        rest = (1.0 - listed.sum()) / (size - len(listed)) if len(listed) < size else 1.0
        angles = self._angles_to_set(i, members)
        cells, cell_of_gt = self._grid.nearest(members), self._grid.nearest(labels.rotation[i][None])
        best_cells, shares = np.unique(cells, return_counts=True)
        best = shares / len(members)
        at_members, at_gt = (_looked_up(indices, log_probability, at, np.log(rest)) for at in (cells, cell_of_gt))
        best_at_members, best_at_gt = (_looked_up(best_cells, np.log(best), at, 0.0) for at in (cells, cell_of_gt))
        return {
            "log_likelihood": (metrics.log_likelihood(at_members, size), 1),
            "log_likelihood_ceiling": (metrics.log_likelihood(best_at_members, size), 1),
            "log_likelihood_at_gt": (metrics.log_likelihood(at_gt, size), 1),
            "log_likelihood_at_gt_ceiling": (metrics.log_likelihood(best_at_gt, size), 1),
            "spread_rad": (metrics.spread(listed, angles[indices], angles), 1),
            "spread_at_ceiling_rad": (float(best @ angles[best_cells]), 1),
        }

    def _angles_to_set(self, i: int, members: Rotations) -> Angles:
        """Return the angle in rad from every grid rotation to the nearest member."""
        circles, labels = self._truth.circles, self._truth.labels
        if circles and len(members) > _MANY_MEMBERS:
            return nearest_angles_on_circles(circles, labels.rotation[i], labels.symmetry_mask[i], self._grid.rotations)
        return nearest_angles(self._grid.rotations, members)

    def warnings(self, over_all: dict[str, Figure]) -> Warnings:  # noqa: ARG002 - the scorers' common form
        """Return why the score does not rank: another grid."""
        return _grid_warnings(self._level)

    def notes(self) -> Notes:
        """Return what its author should know: that another convention fits far better."""
        return self._conventions.notes(_ASKED_OTHERWISE)


Scorer = HypothesesScorer | ClassifierScorer | DensityScorer


def _share(flags: npt.NDArray[np.bool_]) -> tuple[float, float]:
    """Return the share of flags that are set and weight 1; of none, NaN and weight 0."""
    return (float(flags.mean()), 1) if len(flags) else (np.nan, 0)


def _count_above(probability: npt.NDArray[Any], thresholds: npt.NDArray[np.float64]) -> npt.NDArray[np.int64]:
    """Return how many probabilities are above each threshold, compared in the type that they are stored in."""
    in_order = np.sort(probability)
    return len(in_order) - np.searchsorted(in_order, thresholds.astype(in_order.dtype), side="right")


def _looked_up(
    indices: npt.NDArray[np.int64], values: npt.NDArray[np.float64], wanted: npt.NDArray[np.int64], otherwise: float
) -> npt.NDArray[np.float64]:
    """Return the values at wanted indices, and `otherwise` where one is not among the ascending `indices`."""
    place = np.searchsorted(indices, wanted)
    padded_indices, padded_values = np.append(indices, -1), np.append(values, otherwise)
    return np.where(padded_indices[place] == wanted, padded_values[place], otherwise)


def _grid_warnings(level: int) -> Warnings:
    if level == STANDARD_LEVEL:
        return ()
    return (f"it is on the grid of level {level}; scores on other levels than {STANDARD_LEVEL} do not rank",)
