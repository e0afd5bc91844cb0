"""The table of how tracks are scored, by the track's name, and what is looked up in it."""

from typing import Any

from symsol_annot.bench.scoring.metric import Metric, Place
from symsol_annot.bench.scoring.scorers.classifier import CLASSIFIER_SCORING
from symsol_annot.bench.scoring.scorers.density import DENSITY_SCORING
from symsol_annot.bench.scoring.scorers.hypotheses import HYPOTHESES_SCORING
from symsol_annot.bench.scoring.scorers.scorer import TrackScoring

SCORINGS: dict[str, TrackScoring] = {
    scoring.track.name: scoring for scoring in (HYPOTHESES_SCORING, CLASSIFIER_SCORING, DENSITY_SCORING)
}


def metric_of(track: str, name: str) -> Metric[Any]:
    """Return a track's metric by its name.

    Raises:
        KeyError: it has none of that name.
    """
    return {metric.name: metric for metric in SCORINGS[track].metrics}[name]


def metrics_shown(track: str, place: Place) -> list[Metric[Any]]:
    """Return the metrics of a track that a place shows, in the order of tables."""
    shown = [metric for metric in SCORINGS[track].metrics if metric.place >= place]
    return sorted(shown, key=lambda metric: metric.row)
