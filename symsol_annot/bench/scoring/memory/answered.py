"""Answers about single images, held in memory and scored as they come."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.contents import HeldArrays, filled, said_of
from symsol_annot.bench.predictions.format import IMAGE_INDEX
from symsol_annot.bench.predictions.predictions_reader import Predictions
from symsol_annot.bench.predictions.tracks.density import DENSITY_FLOOR
from symsol_annot.bench.predictions.tracks.track import Track
from symsol_annot.bench.predictions.truth import Truth, part_of
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.scoring.averages import PerImage, merge
from symsol_annot.bench.scoring.scorers.table import SCORINGS
from symsol_annot.bench.scoring.scoring import TrackScores, track_scores


class HeldAnswers:
    """What was answered about some images, in memory, as a track makes columns of it."""

    def __init__(self, answers: Sequence[Answer]) -> None:
        self._answers = answers

    @property
    def images(self) -> int:
        """How many images there are."""
        return len(self._answers)

    def first(self, name: str) -> Array:
        """Return what the first image has under a name, for its shape and type."""
        return self._answers[0][name]

    def each(self, name: str) -> Iterator[Array]:
        """Yield what each image has under a name."""
        return (answer[name] for answer in self._answers)

    def lengths(self, name: str) -> npt.NDArray[np.int64]:
        """Return how many entries each image has under a name, (n,)."""
        return np.array([len(answer[name]) for answer in self._answers], dtype=np.int64)


@dataclass(frozen=True)
class _AskedOnGrid:
    """What a scorer asks of a track's reader before there is an answer."""

    grid_level: int
    floor: float | None
    density_floor: float | None


class GridRun:
    """A classifier or a density that is scored as its answers come; of each image its figures are kept alone.

    Attributes:
        truth: of all images.
    """

    def __init__(self, track: Track, truth: Truth, attributes: Mapping[str, Any]) -> None:
        """Begin a run.

        Args:
            track: "classifier" or "density".
            truth: of all images that may be asked about.
            attributes: what a predictions file would say of the method and the grid.
        """
        self.truth, self._track, self._attributes = truth, track, attributes
        found = (attributes.get(name) for name in ("floor", DENSITY_FLOOR))
        self._scorer = SCORINGS[track.name].open(_AskedOnGrid(attributes["grid_level"], *found), truth)
        self._figures: PerImage | None = None

    @property
    def rows(self) -> npt.NDArray[np.int64]:
        """(n,) the places in `truth` of the images that were scored, ascending."""
        return np.zeros(0, dtype=np.int64) if self._figures is None else self._figures.image_index

    def add(self, answers: Mapping[int, Answer]) -> None:
        """Score what was answered about images that were not scored yet.

        Args:
            answers: an image's place in `truth` to its answer.

        Raises:
            PredictionsError: with all faults of the answers.
        """
        rows = np.array(list(answers), dtype=np.int64)
        columns = self._track.columns(HeldAnswers(list(answers.values())))
        arrays = {IMAGE_INDEX: np.arange(len(rows)), **{name: filled(column) for name, column in columns.items()}}
        held = HeldArrays("predictions", {**said_of(self.truth), **self._attributes}, arrays)
        predictions = Predictions(held, part_of(self.truth, rows))
        found = [self._scorer.score_block(block) for reader in predictions.readers for block in reader.blocks(rows)]
        predictions.raise_faults()
        self._take(found)

    def scores(self, *, intervals: bool = True) -> TrackScores:
        """Return the scores of the images that were added.

        Args:
            intervals: whether figures get their bootstrap intervals.
        """
        truth = part_of(self.truth, self.rows)
        return track_scores(self._track.name, self._scorer, self._taken(), truth, intervals=intervals)

    def state(self) -> dict[str, Any]:
        """Return the figures up to now, and what notes are made of, for another process's run."""
        return {"figures": self._taken(), "tried": self._scorer.tried()}

    def join(self, state: Mapping[str, Any]) -> None:
        """Take what another process's run has of the same truth; images that were scored here stay as they are."""
        theirs: PerImage = state["figures"]
        new = ~np.isin(theirs.image_index, self.rows)
        if new.any():
            values, weights = (
                {name: column[new] for name, column in columns.items()} for columns in (theirs.values, theirs.weights)
            )
            self._take([PerImage(theirs.image_index[new], values, weights)])
            self._scorer.try_too(state["tried"])

    def _take(self, found: Sequence[PerImage]) -> None:
        self._figures = merge([*([] if self._figures is None else [self._figures]), *found])

    def _taken(self) -> PerImage:
        return merge([]) if self._figures is None else self._figures
