"""Predictions against the truth: figures per image, track by track, and then figures per stratum."""

import os
from dataclasses import dataclass

from symsol_annot.bench.predictions.predictions_reader import Predictions, open_predictions
from symsol_annot.bench.predictions.tracks.track import TrackReader
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.averages import Figure, PerImage, figures, merge
from symsol_annot.bench.scoring.scorers.scorer import Scorer
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.system.progress import OnImages, ignore_images


@dataclass(frozen=True)
class Headline:
    """The figure of a track by which results rank, over all images.

    Attributes:
        metric: its name.
        value: NaN where no image defines it.
        chance: what is had without looking at the images; NaN where that is not known.
        best_possible: what no answer of this form is above; NaN where that is not known.
    """

    metric: str
    value: float
    chance: float
    best_possible: float


@dataclass(frozen=True, eq=False)
class TrackScores:
    """A track's scores.

    Attributes:
        name: of the result, like "hypotheses (M = 30)".
        per_image: figures of every image.
        figures: stratum to metric to figure.
        facts: what else belongs to the result: M, the grid's level, the floor.
        headline: the figure that ranks, beside chance and the best possible.
        warnings: why it does not rank, in plain words.
        notes: what its author should know of it, though it ranks.
    """

    name: str
    per_image: PerImage
    figures: dict[str, dict[str, Figure]]
    facts: dict[str, float | int]
    headline: Headline
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ObjectScores:
    """The scores of one predictions file.

    Attributes:
        file: its name, without the folder.
        sha256: of the file, as hexadecimal; empty where `open_predictions` did not open it.
        method: what the method calls itself.
        truth: what it was held against.
        tracks: name to scores.
    """

    file: str
    sha256: str
    method: str
    truth: Truth
    tracks: dict[str, TrackScores]


def score_file(
    path: str | os.PathLike[str], data: str | os.PathLike[str], on_images: OnImages = ignore_images
) -> ObjectScores:
    """Score a predictions file.

    Args:
        path: of the predictions.
        data: a set's folder, or the folder of sets.
        on_images: called with a count whenever so many images of a track were scored.

    Raises:
        PredictionsError: with all faults of the file.
        DataError: the set that it is about is not there or damaged.
    """
    with open_predictions(path, data) as predictions:
        return score(predictions, on_images)


def score(predictions: Predictions, on_images: OnImages = ignore_images, *, intervals: bool = True) -> ObjectScores:
    """Score predictions, whose contents are checked on the way.

    Args:
        predictions: of one file.
        on_images: called with a count whenever so many images of a track were scored.
        intervals: whether figures get their bootstrap intervals.

    Raises:
        PredictionsError: with all faults of the file.
    """
    truth = predictions.truth
    if predictions.faults:
        predictions.check()
    scored = {reader.name: _per_image(reader, predictions, on_images) for reader in predictions.readers}
    predictions.raise_faults()
    tracks = {
        name: track_scores(name, scorer, table, truth, intervals=intervals) for name, (scorer, table) in scored.items()
    }
    return ObjectScores(predictions.path.name, predictions.sha256, predictions.method, truth, tracks)


def _per_image(reader: TrackReader, predictions: Predictions, on_images: OnImages) -> tuple[Scorer, PerImage]:
    """Return a track's figures of every image; incomplete where the file has faults."""
    scorer = SCORINGS[reader.name].open(reader, predictions.truth)
    parts = []
    for block in predictions.blocks(reader):
        if not predictions.faults:
            parts.append(scorer.score_block(block))
        on_images(len(block.image_index))
    return scorer, merge(parts)


def track_scores(
    track: str, scorer: Scorer, per_image: PerImage, truth: Truth, *, intervals: bool = True
) -> TrackScores:
    """Return a track's scores.

    Args:
        track: its name.
        scorer: that scored it.
        per_image: figures of every image of `truth`, in its order.
        truth: what it was held against.
        intervals: whether figures get their bootstrap intervals.
    """
    result = figures(per_image, truth.strata, intervals=intervals)
    return TrackScores(
        name=SCORINGS[track].name_of(scorer.facts),
        per_image=per_image,
        figures=result,
        facts=scorer.facts,
        headline=_headline(track, scorer, result["all"]),
        warnings=scorer.warnings(result["all"]),
        notes=scorer.notes(),
    )


def _headline(track: str, scorer: Scorer, over_all: dict[str, Figure]) -> Headline:
    metric = SCORINGS[track].track.ranked_among(over_all)
    chance, best_possible = scorer.chance_and_best(over_all)
    return Headline(metric, over_all[metric].value, chance, best_possible)
