"""What a scorer is: from blocks of predictions, and the truth, to columns of figures, a value per image."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from symsol_annot.bench.predictions.tracks.track import Indices, Track
from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.averages import Figure, PerImage
from symsol_annot.bench.scoring.conventions_tried import ConventionsTried
from symsol_annot.bench.scoring.metric import Metric
from symsol_annot.rotations.grid import STANDARD_LEVEL, GridIndex, grid_index
from symsol_annot.rotations.so3 import Rotations

ASKED_OTHERWISE = "where it is asked about the rotations R, answer about {code}"
_FAVOURED_CELLS = 16


class Scorer(ABC):
    """Scores one track of one file.

    Attributes:
        metrics: what it gives of each image, in the order of scores.json.
        facts: what else belongs to the result: M, the grid's level, the floor.
    """

    metrics: ClassVar[Sequence[Metric[Any]]]
    facts: dict[str, float | int]

    def __init__(self, truth: Truth) -> None:
        self._truth, self._conventions = truth, ConventionsTried(truth)

    def score_block(self, block: Any) -> PerImage:
        """Return the figures of a block's images, as columns."""
        return columns_of(self.metrics, self._measure(block), block.image_index, self._truth)

    @abstractmethod
    def _measure(self, block: Any) -> Any:
        """Return what the metrics of a block's images are computed from."""

    def warnings(self, over_all: Mapping[str, Figure]) -> tuple[str, ...]:  # noqa: ARG002 - some scorers need it
        """Return why the result does not rank, in plain words.

        Args:
            over_all: metric to figure over all images.
        """
        return ()

    def chance_and_best(self, over_all: Mapping[str, Figure]) -> tuple[float, float]:  # noqa: ARG002 - as others need it
        """Return what the figure that ranks is without looking at the images, and what it is at best.

        NaN stands for what is not known.

        Args:
            over_all: metric to figure over all images.
        """
        return np.nan, np.nan

    def tried(self) -> dict[str, Any]:
        """Return what notes are made of, in a form that another process's scorer of the same truth takes."""
        return {"conventions": self._conventions.found}

    def try_too(self, tried: Mapping[str, Any]) -> None:
        """Take what another process's scorer has tried."""
        for image, rotations in tried["conventions"].items():
            self._conventions.add(image, rotations)

    @abstractmethod
    def notes(self) -> tuple[str, ...]:
        """Return what the result's author should know of it, though it ranks, once all blocks were scored."""


class GridScorer(Scorer, ABC):
    """Scores what is on a grid, which is made when it is first needed."""

    def __init__(self, truth: Truth, level: int) -> None:
        super().__init__(truth)
        self._level = level

    def warnings(self, over_all: Mapping[str, Figure]) -> tuple[str, ...]:  # noqa: ARG002 - some scorers need it
        """Return why the result does not rank: it is on another grid than the standard one."""
        if self._level == STANDARD_LEVEL:
            return ()
        return (f"it is on the grid of level {self._level}; scores on other levels than {STANDARD_LEVEL} do not rank",)

    @cached_property
    def _grid(self) -> GridIndex:
        return grid_index(self._level)

    def _try_conventions(self, block: Any) -> None:
        """Keep the rotations of the few cells that some images' answers favour, to be tried in other conventions."""
        for row, i in enumerate(block.image_index):
            if self._conventions.wants(int(i)):
                indices, values = block.on_grid.row(row)
                order = np.argsort(-values, kind="stable")[:_FAVOURED_CELLS]
                favoured: Rotations = self._grid.rotations[indices[order]]
                self._conventions.add(int(i), favoured)


def columns_of(metrics: Sequence[Metric[Any]], measured: Any, image_index: Indices, truth: Truth) -> PerImage:
    """Return the figures of some images as columns.

    Args:
        metrics: in their order; those that have no value here are left out.
        measured: of b images, what the metrics are computed from.
        image_index: (b,) which images.
        truth: for the sizes of their sets.
    """
    found = [(metric, metric.value(measured)) for metric in metrics]
    values = {metric.name: value for metric, value in found if value is not None}
    sizes = truth.set_sizes[image_index]
    weights = {metric.name: metric.weights(value, sizes) for metric, value in found if value is not None}
    return PerImage(image_index, values, weights)


def _nothing(_scores: Mapping[str, Any]) -> Iterator[str]:
    return iter(())


def _never(_figures: Mapping[str, Any]) -> bool:
    return False


@dataclass(frozen=True)
class TrackScoring:
    """All that scoring knows of a track.

    Attributes:
        track: what it is about.
        open: from the track's reader and the truth to what scores it.
        metrics: in the order of scores.json.
        shown_facts: names of facts without which results cannot be compared, to how tables call them.
        result_name: from a track's entry in scores.json, or facts alone, to how such a result is named; None where
            the track's name says enough.
        faults_of_facts: says what is wrong with the facts in such an entry.
        caption: yields lines for below the table of such an entry.
        beside_rank: names of the metrics that the leaderboard's tables show beside the one that ranks.
        is_exact: whether such an entry's figures of all images are what the labels themselves have, and no method.
    """

    track: Track
    open: Callable[[Any, Truth], Scorer]
    metrics: Sequence[Metric[Any]]
    shown_facts: Mapping[str, str] = field(default_factory=dict)
    result_name: Callable[[Mapping[str, Any]], str] | None = None
    faults_of_facts: Callable[[Mapping[str, Any]], Iterator[str]] = _nothing
    caption: Callable[[Mapping[str, Any]], Iterator[str]] = _nothing
    beside_rank: tuple[str, ...] = ()
    is_exact: Callable[[Mapping[str, Any]], bool] = _never

    def name_of(self, entry: Mapping[str, Any]) -> str:
        """Return how a result is named, given the facts of it: the track's name, but for tracks with a rule."""
        return self.track.name if self.result_name is None else self.result_name(entry)
