"""Predictions in a gallery: each image's scores, and the rotations that were predicted for it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.predictions_reader import Predictions, open_predictions
from symsol_annot.bench.predictions.proposals import Predicted
from symsol_annot.bench.predictions.tracks.track import TrackReader
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.metric import NEITHER, Place
from symsol_annot.bench.scoring.scorers.table import metrics_shown
from symsol_annot.bench.scoring.scoring import TrackScores, score
from symsol_annot.errors import PredictionsError, ScoresError
from symsol_annot.gallery.sources import Source
from symsol_annot.system.progress import OnImages, ignore_images

_SAME_OF_ONE_IMAGE = "recall_mean_error_image_mean_rad"  # as recall_mean_error_rad; their means differ


@dataclass(frozen=True, eq=False)
class ShownMetric:
    """A metric of every image, as the page shows it.

    Attributes:
        name: as in scores.json.
        title: in words.
        better: "higher", "lower", or "" where neither is.
        values: (N,), NaN where undefined.
        means: stratum to the figure over its images.
    """

    name: str
    title: str
    better: str
    values: npt.NDArray[np.float64]
    means: dict[str, float]


@dataclass(frozen=True, eq=False)
class Run:
    """One track of a predictions file.

    Attributes:
        source: the number of the source that it is about.
        method: what the method calls itself.
        track: "hypotheses", "classifier" or "density".
        name: of the result, like "hypotheses (M = 30)".
        warnings: why it does not rank.
        metrics: those of the scorer's table.
        predicted: for each image that is shown, the first of the split.
    """

    source: int
    method: str
    track: str
    name: str
    warnings: tuple[str, ...]
    metrics: tuple[ShownMetric, ...]
    predicted: tuple[Predicted, ...]

    @property
    def leading(self) -> ShownMetric:
        """The first metric that tells good from bad."""
        return next(metric for metric in self.metrics if metric.better != NEITHER)

    def worst_first(self) -> npt.NDArray[np.int64]:
        """Return the split's images from worst to best by the leading metric, undefined ones last."""
        sign = 1.0 if self.leading.better == "higher" else -1.0
        return np.argsort(sign * self.leading.values, kind="stable")  # NaN comes last


def read_runs(
    paths: Sequence[Path], data: Path, sources: Sequence[Source], on_images: OnImages = ignore_images
) -> list[Run]:
    """Read and score predictions files: one run per track.

    Args:
        paths: predictions files of any number of methods.
        data: a set's folder, or a folder of sets.
        sources: what the gallery shows.
        on_images: called with a count whenever so many images of a track were scored.

    Raises:
        PredictionsError: with all faults of a file, or it is about none of the sources.
        ScoresError: two files are the same track of the same method about the same images.
        DataError: the set that a file is about is not there or damaged.
    """
    runs: list[Run] = []
    for path in paths:
        with open_predictions(path, data) as predictions:
            number = _source_of(path, predictions.truth, sources)
            scores = score(predictions, on_images)
            shown = len(sources[number].dataset)
            runs += [
                _run(number, predictions, reader, scores.tracks[reader.name], shown) for reader in predictions.readers
            ]
    keys = [(run.source, run.method, run.track) for run in runs]
    if len(set(keys)) < len(keys):
        raise ScoresError("two of the predictions files are the same track of the same method; give each once")
    return runs


def _source_of(path: Path, truth: Truth, sources: Sequence[Source]) -> int:
    for number, source in enumerate(sources):
        if source.truth.fingerprint == truth.fingerprint:
            return number
    shown = ", ".join(f"{source.truth.object} {source.truth.split}" for source in sources)
    fault = f"the file: is about {truth.object} {truth.split}, which the gallery does not show; it shows {shown}"
    raise PredictionsError(str(path), [fault])


def _run(source: int, predictions: Predictions, reader: TrackReader, scores: TrackScores, shown: int) -> Run:
    predicted = tuple(predictions.proposals(reader, shown))
    metrics = tuple(_metrics(reader.name, scores))
    return Run(source, predictions.method, reader.name, scores.name, scores.warnings, metrics, predicted)


def _metrics(track: str, scores: TrackScores) -> list[ShownMetric]:
    """Return the table's metrics, each of which says something of a single image."""
    found: list[ShownMetric] = []
    over = ""
    for metric in metrics_shown(track, Place.TABLES):
        over = over if metric.is_detail else metric.title
        values = scores.per_image.values.get(metric.name)
        if values is None or metric.name == _SAME_OF_ONE_IMAGE:
            continue
        title = f"{over}: {metric.title}" if metric.is_detail else metric.title
        means = {stratum: figures[metric.name].value for stratum, figures in scores.figures.items()}
        found.append(ShownMetric(metric.name, title, metric.better, values, means))
    return found
