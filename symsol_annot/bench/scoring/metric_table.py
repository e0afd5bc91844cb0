"""All that is known of a metric but its formula: title, which way is better, what an image weighs, where it is shown.

Tables, the leaderboard's columns and order, `compare`, and what scores.json lists of each image follow from here.
"""

from dataclasses import dataclass
from enum import IntEnum

HIGHER, LOWER, NEITHER = "higher", "lower", ""  # is better
ANGLES_DEG = (1, 2, 5, 10, 15, 30)
RANKED_ANGLE_DEG = 5
F_UNWEIGHTED = f"f_measure_unweighted_at_{RANKED_ANGLE_DEG}_deg"
SWEPT_THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 0.95, 0.99)
_ARROWS = {HIGHER: " ↑", LOWER: " ↓", NEITHER: ""}


class Place(IntEnum):
    """Where metrics are shown; a metric that is shown in one place is shown in those before as well."""

    FILE = 0  # scores.json alone
    TABLES = 1  # of `score`, of `compare`, and each image's figures
    LEADERBOARD = 2
    SUMMARY = 3  # of all objects


@dataclass(frozen=True)
class Metric:
    """A metric of a track.

    Attributes:
        name: in scores.json.
        better: "higher", "lower", or "" where neither is.
        place: the last one that shows it.
        title: in tables; empty for those of scores.json alone.
        is_pooled: whether an image weighs |S|, so that every member of every set weighs the same; else 1.
        is_detail: whether it is a variant of the metric before it, below which tables indent it.
    """

    name: str
    better: str
    place: Place
    title: str = ""
    is_pooled: bool = False
    is_detail: bool = False

    @property
    def label(self) -> str:
        """The title as it stands in a column of titles."""
        return f"  {self.title}" if self.is_detail else self.title

    @property
    def arrow(self) -> str:
        """A blank and an arrow to the better side; empty where neither is better."""
        return _ARROWS[self.better]


METRICS = {
    "hypotheses": (
        Metric("recall_mean_error_rad", LOWER, Place.SUMMARY, "recall mean error, rad (5.7)", is_pooled=True),
        Metric("recall_mean_error_image_mean_rad", LOWER, Place.LEADERBOARD, "mean of images, rad", is_detail=True),
        Metric("coverage_at_5_deg", HIGHER, Place.SUMMARY, "coverage at 5 deg", is_pooled=True),
        Metric("precision_mean_error_rad", LOWER, Place.SUMMARY, "precision mean error, rad (5.9)"),
        Metric("precision_mean_error_continuous_rad", LOWER, Place.TABLES, "to the arcs, rad", is_detail=True),
        Metric("accuracy_at_5_deg", HIGHER, Place.SUMMARY, "accuracy at 5 deg"),
        Metric("f_measure_at_5_deg", HIGHER, Place.LEADERBOARD, "F-measure at 5 deg"),
        Metric(F_UNWEIGHTED, HIGHER, Place.TABLES, "all hypotheses alike", is_detail=True),  # of files with weights
        *(Metric(f"coverage_at_{t}_deg", HIGHER, Place.FILE, is_pooled=True) for t in ANGLES_DEG if t != 5),
        *(Metric(f"coverage_image_mean_at_{t}_deg", HIGHER, Place.FILE) for t in ANGLES_DEG),
        *(Metric(f"accuracy_at_{t}_deg", HIGHER, Place.FILE) for t in ANGLES_DEG if t != 5),
        *(Metric(f"f_measure_at_{t}_deg", HIGHER, Place.FILE) for t in ANGLES_DEG if t != 5),
    ),
    "classifier": (
        Metric("recall", HIGHER, Place.SUMMARY, "recall (7.5)"),
        Metric("precision", HIGHER, Place.SUMMARY, "precision (7.6)"),
        Metric("precision_beyond_half_degree", HIGHER, Place.TABLES, "beyond 0.5 deg of the set", is_detail=True),
        Metric("f_measure", HIGHER, Place.SUMMARY, "F-measure (7.8)"),
        Metric("accuracy", HIGHER, Place.TABLES, "accuracy (7.7)"),
        Metric("hard_negative_rate", LOWER, Place.SUMMARY, "hard negative rate"),
        Metric("decoy_false_positive_rate", LOWER, Place.TABLES, "decoy false positive rate"),
        Metric("grid_positive_rate", NEITHER, Place.TABLES, "grid positive rate"),
        Metric("nothing_predicted_rate", NEITHER, Place.LEADERBOARD, "images without a positive"),
        *(Metric(f"recall_above_{t:g}", HIGHER, Place.FILE) for t in SWEPT_THRESHOLDS),
        *(Metric(f"precision_above_{t:g}", HIGHER, Place.FILE) for t in SWEPT_THRESHOLDS),
        *(Metric(f"f_measure_above_{t:g}", HIGHER, Place.FILE) for t in SWEPT_THRESHOLDS),
    ),
    "density": (
        Metric("log_likelihood", HIGHER, Place.SUMMARY, "log-likelihood"),
        Metric("log_likelihood_ceiling", NEITHER, Place.SUMMARY, "ceiling", is_detail=True),
        Metric("log_likelihood_at_gt", HIGHER, Place.TABLES, "log-likelihood at R_gt"),
        Metric("log_likelihood_at_gt_ceiling", NEITHER, Place.TABLES, "ceiling", is_detail=True),
        Metric("spread_rad", LOWER, Place.SUMMARY, "spread, rad"),
        Metric("spread_at_ceiling_rad", NEITHER, Place.TABLES, "at the ceiling, rad", is_detail=True),
    ),
}
RANKED_BY = {"hypotheses": "f_measure_at_5_deg", "classifier": "f_measure", "density": "log_likelihood"}


def metric_of(track: str, name: str) -> Metric:
    """Return a track's metric by its name."""
    return next(metric for metric in METRICS[track] if metric.name == name)


def metrics_shown(track: str, place: Place) -> list[Metric]:
    """Return the metrics of a track that a place shows, in its order."""
    return [metric for metric in METRICS[track] if metric.place >= place]


def pooled_metrics(track: str) -> set[str]:
    """Return the names of a track's metrics in which an image weighs |S|."""
    return {metric.name for metric in METRICS[track] if metric.is_pooled}
