"""Predictions against the truth: figures per image, track by track, and then figures per stratum."""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.reader import Predictions, open_predictions
from symsol_annot.bench.predictions.tracks import ClassifierTrack, DensityTrack, HypothesesTrack, Track
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.averages import Figure, PerImage, figures, merge
from symsol_annot.bench.scoring.scorers import ClassifierScorer, DensityScorer, Facts, HypothesesScorer, Row, Scorer

OnImages = Callable[[int], object]


@dataclass(frozen=True, eq=False)
class TrackScores:
    """A track's scores.

    Attributes:
        name: of the result, like "hypotheses (M = 30)".
        per_image: figures of every image.
        figures: stratum to metric to figure.
        facts: what else belongs to the result: M, the grid's level, the floor.
        warnings: why it does not rank, in plain words.
        notes: what its author should know of it, though it ranks.
    """

    name: str
    per_image: PerImage
    figures: dict[str, dict[str, Figure]]
    facts: Facts
    warnings: tuple[str, ...]
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class ObjectScores:
    """The scores of one predictions file.

    Attributes:
        method: what it calls itself.
        truth: what it was held against.
        tracks: name to scores.
    """

    method: str
    truth: Truth
    tracks: dict[str, TrackScores]


def score_file(
    path: str | os.PathLike[str], data: str | os.PathLike[str], on_images: OnImages = lambda _: None
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


def score(predictions: Predictions, on_images: OnImages = lambda _: None) -> ObjectScores:
    """Score predictions, whose contents are checked on the way.

    Raises:
        PredictionsError: with all faults of the file.
    """
    truth = predictions.truth
    if predictions.faults:
        predictions.check()
    tables = {track.name: _per_image(track, predictions, on_images) for track in predictions.tracks}
    predictions.raise_faults()
    tracks = {}
    for name, (scorer, table) in tables.items():
        result = figures(table, truth.strata)
        warnings, notes = scorer.warnings(result["all"]), scorer.notes()
        tracks[name] = TrackScores(scorer.name, table, result, scorer.facts, warnings, notes)
    return ObjectScores(predictions.method, truth, tracks)


def _per_image(track: Track, predictions: Predictions, on_images: OnImages) -> tuple[Scorer, PerImage]:
    """Return a track's figures of every image; incomplete where the file has faults."""
    scorer: Any = scorer_of(track, predictions.truth)
    parts = []
    for block in predictions.blocks(track):
        count = len(block.image_index)
        if not predictions.faults:
            parts.append(table_of(block.image_index, scorer.score_block(block)))
        on_images(count)
    return scorer, merge(parts)


def scorer_of(track: Track, truth: Truth) -> Scorer:
    """Return what scores a track."""
    match track:
        case HypothesesTrack():
            return HypothesesScorer(track, truth)
        case ClassifierTrack():
            return ClassifierScorer(track, truth)
        case DensityTrack():
            return DensityScorer(track, truth)


def table_of(image_index: npt.NDArray[np.int64], rows: list[Row]) -> PerImage:
    """Return one image's figures after another's as columns."""
    names = list(rows[0])
    columns = {name: np.array([row[name] for row in rows], dtype=np.float64) for name in names}
    return PerImage(
        image_index,
        {name: column[:, 0] for name, column in columns.items()},
        {name: column[:, 1] for name, column in columns.items()},
    )
