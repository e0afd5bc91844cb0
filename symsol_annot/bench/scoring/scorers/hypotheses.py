"""How hypotheses are scored: recall, precision, coverage and accuracy (section 5.2)."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.counted import Counted
from symsol_annot.bench.predictions.format import MAX_HYPOTHESES
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.predictions.tracks.hypotheses import HYPOTHESES, HypothesesBlock, HypothesesReader
from symsol_annot.bench.predictions.tracks.track import Indices
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring import metrics
from symsol_annot.bench.scoring.averages import Figure
from symsol_annot.bench.scoring.metric import HIGHER, LOWER, Metric, Place, Values
from symsol_annot.bench.scoring.scorers.around_hypotheses import distances_in_volume, share_of_ball
from symsol_annot.bench.scoring.scorers.scorer import Scorer, TrackScoring
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.rotations.so3 import Angles, Rotations, angle_between, uniform_rotations
from symsol_annot.sets.shard.labels import Labels

Weights: TypeAlias = npt.NDArray[np.float64]
EachWeights: TypeAlias = Sequence[Weights | None]

ANGLES_DEG = (1, 2, 5, 10, 15, 30)
RANKED_ANGLE_DEG = 5
F_UNWEIGHTED = HYPOTHESES.ranked_by_if_there
# Neighbours on the lattice are 1, 2, .. degrees apart, which is where the thresholds lie. An angle to a rotation that
# was rounded to float32, or multiplied in it, is off by less than the slack (docs/metrics.md, "Angles").
SLACK_RAD = 1e-6
EXACT_RAD = 1e-3  # 0.06 degrees, a tenth of the thesis's best; no method reads that from pixels
THRESHOLDS_RAD = np.radians(ANGLES_DEG) + SLACK_RAD
_RANKED_RAD = float(np.radians(RANKED_ANGLE_DEG)) + SLACK_RAD
_CHANCE_IMAGES, _CHANCE_HYPOTHESES = 64, 256  # are drawn at the most, to tell what chance gives
_PAIRS_AT_ONCE = 2**20


class Errors(NamedTuple):
    """How far an image's set and the hypotheses about it are from each other.

    Attributes:
        of_set: (k,) angles in rad from members, or from points that stand for a volume, to the nearest hypothesis.
        of_hypotheses: (M,) angles in rad from the hypotheses to the set.
        measures: (k,) what each of `of_set` counts: a member 1, a volume as many as the grid has rotations in its share
            of SO(3); None of a set without volume, in which all count 1.
    """

    of_set: Angles
    of_hypotheses: Angles
    measures: Weights | None = None


@dataclass(frozen=True, eq=False)
class MeasuredHypotheses:
    """What is measured of the hypotheses of b images, at the angles `ANGLES_DEG`.

    Attributes:
        recall_error: (b,) the mean angle in rad from the members to the nearest hypothesis.
        precision_error: (b,) the mean angle in rad from the hypotheses to the set, with their weights.
        arc_error: (b,) as `precision_error`, to the continuous set; None for an object without circles.
        coverage: (b, 6) the share of members within an angle of a hypothesis.
        accuracy: (b, 6) the share of hypotheses within an angle of the set, with their weights.
        unweighted_accuracy: (b, 6) as `accuracy`, all hypotheses counted alike; None for a file without weights.
    """

    recall_error: Values
    precision_error: Values
    arc_error: Values | None
    coverage: Values
    accuracy: Values
    unweighted_accuracy: Values | None

    @cached_property
    def f_measure(self) -> Values:
        """(b, 6) of coverage and accuracy."""
        return metrics.harmonic_mean(self.coverage, self.accuracy)

    @property
    def unweighted_f_measure(self) -> Values | None:
        """(b,) at the angle that ranks; None for a file without weights."""
        if self.unweighted_accuracy is None:
            return None
        return metrics.harmonic_mean(self.coverage, self.unweighted_accuracy)[:, ANGLES_DEG.index(RANKED_ANGLE_DEG)]


def _metrics_at(t: int, degrees: int) -> tuple[Metric[MeasuredHypotheses], ...]:
    """Return the metrics at angle number t; those at the angle that ranks are shown beside the mean errors."""
    is_ranked = degrees == RANKED_ANGLE_DEG
    summary, leaderboard = (Place.SUMMARY, Place.LEADERBOARD) if is_ranked else (Place.FILE, Place.FILE)
    at = f"at {degrees} deg"
    return (
        Metric(
            f"coverage_at_{degrees}_deg",
            HIGHER,
            summary,
            lambda of: of.coverage[:, t],
            f"coverage {at}",
            row=3,
            is_pooled=True,
        ),
        Metric(
            f"coverage_image_mean_at_{degrees}_deg",
            HIGHER,
            Place.FILE,
            lambda of: of.coverage[:, t],
            f"coverage {at}, mean of images",
        ),
        Metric(f"accuracy_at_{degrees}_deg", HIGHER, summary, lambda of: of.accuracy[:, t], f"accuracy {at}", row=6),
        Metric(
            f"f_measure_at_{degrees}_deg", HIGHER, leaderboard, lambda of: of.f_measure[:, t], f"F-measure {at}", row=7
        ),
    )


METRICS: tuple[Metric[MeasuredHypotheses], ...] = (
    Metric(
        "recall_mean_error_rad",
        LOWER,
        Place.SUMMARY,
        lambda of: of.recall_error,
        "recall mean error, rad",
        "5.7",
        row=1,
        is_pooled=True,
    ),
    Metric(
        "recall_mean_error_image_mean_rad",
        LOWER,
        Place.LEADERBOARD,
        lambda of: of.recall_error,
        "mean of images, rad",
        row=2,
        is_detail=True,
    ),
    Metric(
        "precision_mean_error_rad",
        LOWER,
        Place.SUMMARY,
        lambda of: of.precision_error,
        "precision mean error, rad",
        "5.9",
        row=4,
    ),
    Metric(
        "precision_mean_error_continuous_rad",
        LOWER,
        Place.TABLES,
        lambda of: of.arc_error,
        "to the arcs, rad",
        row=5,
        is_detail=True,
    ),
    *(metric for t, degrees in enumerate(ANGLES_DEG) for metric in _metrics_at(t, degrees)),
    Metric(
        F_UNWEIGHTED,
        HIGHER,
        Place.TABLES,
        lambda of: of.unweighted_f_measure,
        "all hypotheses alike",
        row=8,
        is_detail=True,
    ),
)


class HypothesesScorer(Scorer):
    """Scores hypotheses. One of weight 0 is absent, so that images of a file with weights differ in their counts."""

    metrics = METRICS

    def __init__(self, reader: HypothesesReader, truth: Truth) -> None:
        super().__init__(truth)
        self._counted = truth.counted_on(STANDARD_LEVEL)
        self.facts = {"M": reader.count}

    def _measure(self, block: HypothesesBlock) -> MeasuredHypotheses:
        if block.weights is None:
            found, weights = list(block.hypotheses), None
            errors = self.errors(block.image_index, block.hypotheses)
        else:
            found = [h[w > 0] for h, w in zip(block.hypotheses, block.weights, strict=True)]
            weights = [w[w > 0] for w in block.weights]
            both = zip(block.image_index, found, strict=True)
            errors = [errors_of_image(self._truth.labels, self._counted, int(i), h) for i, h in both]
        self._try_conventions(block.image_index, found)
        of_set, of_hypotheses = [e.of_set for e in errors], [e.of_hypotheses for e in errors]
        measures = [e.measures for e in errors]
        return MeasuredHypotheses(
            recall_error=_means(of_set, measures),
            precision_error=_means(of_hypotheses, weights),
            arc_error=self._arc_errors(block.image_index, found, of_hypotheses, weights),
            coverage=self._shares(of_set, measures),
            accuracy=self._shares(of_hypotheses, weights),
            unweighted_accuracy=None if weights is None else self._shares(of_hypotheses),
        )

    def _try_conventions(self, image_index: Indices, hypotheses: list[Rotations]) -> None:
        for i, of_image in zip(image_index, hypotheses, strict=True):
            if self._conventions.wants(int(i)):
                self._conventions.add(int(i), of_image)

    def errors(self, image_index: Indices, hypotheses: Rotations) -> list[Errors]:
        """Return both kinds of errors of each image; images with sets of one size go together, which is faster.

        Args:
            image_index: (b,) which images.
            hypotheses: (b, M, 3, 3) R_m2c.
        """
        errors = [Errors(np.zeros(0), np.zeros(0))] * len(image_index)
        labels = self._truth.labels
        sizes = labels.set_sizes[image_index]
        for size in np.unique(sizes):
            (alike,) = np.nonzero(sizes == size)
            step = max(1, _PAIRS_AT_ONCE // (int(size) * hypotheses.shape[1]))
            for rows in (alike[start : start + step] for start in range(0, len(alike), step)):
                sets = np.stack([labels.members(i) for i in image_index[rows]])
                both = metrics.recall_and_precision_errors(sets, hypotheses[rows])
                for row, of_members, of_hypotheses in zip(rows, *both, strict=True):
                    found = Errors(of_members, of_hypotheses)
                    errors[row] = _with_volume(labels, self._counted, int(image_index[row]), hypotheses[row], found)
        return errors

    def _arc_errors(
        self,
        image_index: Indices,
        hypotheses: list[Rotations],
        errors: list[Angles],
        weights: list[Weights] | None,
    ) -> Values | None:
        if self._truth.circles is None:
            return None
        images = zip(image_index, hypotheses, errors, strict=True)
        to_arcs = [self._truth.labels.symmetry_set(int(i)).distance_to_arcs(h, error) for i, h, error in images]
        return _means(to_arcs, weights)

    def _shares(self, errors: list[Angles], weights: EachWeights | None = None) -> Values:
        each = [None] * len(errors) if weights is None else weights
        shares = [metrics.share_within(e, THRESHOLDS_RAD, w) for e, w in zip(errors, each, strict=True)]
        return np.reshape(shares, (len(errors), len(ANGLES_DEG))).astype(np.float64)

    def chance_and_best(self, over_all: Mapping[str, Figure]) -> tuple[float, float]:  # noqa: ARG002 - as others need it
        """Return the F-measure of as many uniform rotations, drawn once, and a bound for as many hypotheses."""
        return self._chance(), self._best()

    def _best(self) -> float:
        """Return the mean F-measure, were all hypotheses right and each near as many members as one can be.

        A rotation within T of several has them within 2 T of each other. Members so close lie on one circle, of which
        the elements within 2 T of the identity are both sides: half of them, rounded up, fit. Of a volume it has at
        most what is within T of it.
        """
        sizes, group = self._truth.set_sizes, self._truth.symmetry_group
        near = np.count_nonzero(angle_between(group[0], group) <= 2.0 * _RANKED_RAD)
        ball = self._counted.grid_size * share_of_ball(np.array(_RANKED_RAD))
        most = (near + 1) // 2 + np.where(self._counted.inside_count > 0, ball, 0.0)
        coverage = np.minimum(1.0, self.facts["M"] * most / sizes)
        return float(metrics.harmonic_mean(coverage, np.ones(len(sizes))).mean())

    def _chance(self) -> float:
        """Return the mean F-measure of uniform rotations, over some images evenly spread."""
        count = min(int(self.facts["M"]), _CHANCE_HYPOTHESES)
        images = np.linspace(0, len(self._truth) - 1, min(len(self._truth), _CHANCE_IMAGES)).astype(np.int64)
        drawn = uniform_rotations(len(images) * count, np.random.default_rng(0)).reshape(-1, count, 3, 3)
        thresholds = np.array([_RANKED_RAD])
        errors = self.errors(images, drawn)
        coverage = np.array([metrics.share_within(e.of_set, thresholds, e.measures) for e in errors])
        accuracy = np.array([metrics.share_within(e.of_hypotheses, thresholds) for e in errors])
        return float(np.mean(metrics.harmonic_mean(coverage, accuracy)))

    def notes(self) -> tuple[str, ...]:
        """Return what its author should know: that another convention fits far better."""
        return self._conventions.notes("write {code} in place of the rotations R")


def errors_of_image(labels: Labels, on_grid: Counted, i: int, hypotheses: Rotations) -> Errors:
    """Return both kinds of errors of one image.

    Args:
        labels: of the split.
        on_grid: what its sets consist of on the grid of the standard level.
        i: the image's index.
        hypotheses: (M, 3, 3) R_m2c.
    """
    to_members = Errors(*metrics.recall_and_precision_errors(labels.members(i), hypotheses))
    return _with_volume(labels, on_grid, i, hypotheses, to_members)


def _with_volume(labels: Labels, on_grid: Counted, i: int, hypotheses: Rotations, to_members: Errors) -> Errors:
    """Return the errors of an image, given those with its members alone: they stay of a set without volume."""
    volume = labels.volume_of(i)
    if volume is None:
        return to_members
    counted = to_members.of_set[on_grid.is_counted[i][labels.symmetry_mask[i]]]
    of_volume, shares = distances_in_volume(volume, hypotheses, THRESHOLDS_RAD)
    return Errors(
        np.concatenate([counted, of_volume]),
        np.minimum(to_members.of_hypotheses, volume.distance(hypotheses)),
        np.concatenate([np.ones(len(counted)), on_grid.grid_size * shares]),
    )


def _means(errors: list[Angles], weights: EachWeights | None = None) -> Values:
    """Return the mean of each image's errors, (b,)."""
    each = [None] * len(errors) if weights is None else weights
    return np.array([metrics.mean_error(e, w) for e, w in zip(errors, each, strict=True)], dtype=np.float64)


def _result_name(facts: Mapping[str, Any]) -> str:
    """Return how a result with M hypotheses per image is named, for its best possible recall depends on M."""
    return f"hypotheses (M = {facts['M']})"


def _faults_of_facts(entry: Mapping[str, Any]) -> Iterator[str]:
    count = entry.get("M")
    if type(count) is not int or not 1 <= count <= MAX_HYPOTHESES:
        yield f".M: expected 1 to {MAX_HYPOTHESES} hypotheses per image, found {shown(count)}"


def _is_exact(figures: Mapping[str, Any]) -> bool:
    errors = (figures[name]["value"] for name in ("recall_mean_error_rad", "precision_mean_error_rad"))
    return any(error is not None and error < EXACT_RAD for error in errors)


HYPOTHESES_SCORING = TrackScoring(
    track=HYPOTHESES,
    open=HypothesesScorer,
    metrics=METRICS,
    shown_facts={"M": "M, hypotheses per image"},
    result_name=_result_name,
    faults_of_facts=_faults_of_facts,
    beside_rank=(f"coverage_at_{RANKED_ANGLE_DEG}_deg", f"accuracy_at_{RANKED_ANGLE_DEG}_deg"),
    is_exact=_is_exact,
)
