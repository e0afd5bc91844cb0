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
    facts: dict[str, float | int]
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


def score(predictions: Predictions, on_images: OnImages = ignore_images) -> ObjectScores:
    """Score predictions, whose contents are checked on the way.

    Args:
        predictions: of one file.
        on_images: called with a count whenever so many images of a track were scored.

    Raises:
        PredictionsError: with all faults of the file.
    """
    truth = predictions.truth
    if predictions.faults:
        predictions.check()
    scored = {reader.name: _per_image(reader, predictions, on_images) for reader in predictions.readers}
    predictions.raise_faults()
    tracks = {name: _track_scores(name, scorer, table, truth) for name, (scorer, table) in scored.items()}
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


def _track_scores(track: str, scorer: Scorer, per_image: PerImage, truth: Truth) -> TrackScores:
    result = figures(per_image, truth.strata)
    return TrackScores(
        name=SCORINGS[track].name_of(scorer.facts),
        per_image=per_image,
        figures=result,
        facts=scorer.facts,
        warnings=scorer.warnings(result["all"]),
        notes=scorer.notes(),
    )
