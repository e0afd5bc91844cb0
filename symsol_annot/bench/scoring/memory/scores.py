"""Scores of predictions in memory, as Python has them: figures by track and metric, columns of images, a table."""

import os
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.bench.scoring.averages import Figure, Values
from symsol_annot.bench.scoring.reports import report, tables
from symsol_annot.bench.scoring.scorers.table import metric_of
from symsol_annot.bench.scoring.scoring import ObjectScores, TrackScores
from symsol_annot.errors import ScoresError
from symsol_annot.system.files import write_atomically
from symsol_annot.system.text.names import did_you_mean


@dataclass(frozen=True, eq=False, repr=False)
class Scores:
    """What `symsol_annot.score` and `symsol_annot.bench.Metric` return.

    In a session it shows itself as the table that `symsol-annot score` prints. `scores["hypotheses"]` is the same as
    `scores.figures["hypotheses"]`.

    Attributes:
        image_index: (n,) the index within the split of each image that was scored, ascending.
        is_whole: whether these are all images of the split.
        scored: what the figures are taken from.
    """

    image_index: npt.NDArray[np.int64]
    is_whole: bool
    scored: ObjectScores

    @property
    def object(self) -> str:
        """The object's name."""
        return self._truth.object

    @property
    def split(self) -> str:
        """Whether it is "train" or "test"."""
        return self._truth.split

    @property
    def tracks(self) -> Mapping[str, TrackScores]:
        """Name to scores: figures of each stratum, facts like M or the grid's level, warnings and notes."""
        return self.scored.tracks

    @cached_property
    def figures(self) -> dict[str, dict[str, float]]:
        """Track to metric to the figure over all images, by the names of docs/metrics.md; NaN where undefined."""
        return {
            track: {metric: figure.value for metric, figure in scores.figures["all"].items()}
            for track, scores in self.tracks.items()
        }

    @property
    def headline(self) -> dict[str, float]:
        """Track to the one figure by which its results rank."""
        return {track: scores.headline.value for track, scores in self.tracks.items()}

    @property
    def strata(self) -> dict[str, npt.NDArray[np.bool_]]:
        """Stratum to which of the images (n,) are in it: all; for a marked object also shown, hidden and barely."""
        return self._truth.strata

    @property
    def set_sizes(self) -> npt.NDArray[np.int64]:
        """(n,) how many members the symmetry set of each image has."""
        return self._truth.set_sizes

    @property
    def per_image(self) -> dict[str, dict[str, Values]]:
        """Track to metric to the values (n,) of the images, in the order of `image_index`; NaN where undefined."""
        return {track: dict(scores.per_image.values) for track, scores in self.tracks.items()}

    def figure(self, track: str, metric: str, stratum: str = "all") -> Figure:
        """Return a figure with its interval, and over how many images it is.

        Args:
            track: its name, like "hypotheses".
            metric: its name, like "f_measure_at_5_deg".
            stratum: "all"; "shown", "hidden" or "barely" of a marked object.

        Raises:
            ScoresError: there is none of that name; the message says which there are.
        """
        found: Any = {name: scores.figures for name, scores in self.tracks.items()}
        for what, name in (("track", track), ("stratum", stratum), ("metric", metric)):
            if name not in found:
                raise ScoresError(f"there is no {what} {name!r} in these scores{did_you_mean(name, list(found))}")
            found = found[name]
        figure: Figure = found
        return figure

    def worst(self, track: str, count: int = 10) -> list[int]:
        """Return the indices within the split of the worst images by the figure that ranks, the worst first."""
        metric = metric_of(track, self.tracks[track].headline.metric)
        rows = tables.worst_rows(self.tracks[track].per_image.values[metric.name], metric.better, count)
        return [int(self.image_index[row]) for row in rows]

    def document(self) -> dict[str, Any]:
        """Return what `symsol-annot score --json` writes, for `symsol-annot compare`.

        Raises:
            ScoresError: these are the scores of some of the split's images, where a scores file is about all.
        """
        if not self.is_whole:
            raise ScoresError(
                f"these are the scores of {len(self.image_index)} images of the {self.split} split, where a scores "
                "file is about all of them: score predictions of the whole split"
            )
        return report.to_document([self.scored])

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write `document()` to a file, which is replaced where it is there.

        Raises:
            ScoresError: these are the scores of some of the split's images.
            OutputError: the file cannot be written.
        """
        write_atomically(Path(path), report.to_json(self.document()).encode())

    def table(self, *, intervals: bool = False, width: int | None = None) -> str:
        """Return the table that `symsol-annot score` prints.

        Args:
            intervals: whether figures stand with their 95% intervals.
            width: in characters; the terminal's where it is not given.
        """
        document = report.to_document([self.scored])
        document["objects"][self.object]["image_index"] = self.image_index.tolist()
        return tables.tables(document, intervals=intervals, width=tables.room() if width is None else width)

    def __getitem__(self, track: str) -> dict[str, float]:
        return self.figures[track]

    def __repr__(self) -> str:
        return self.table()

    @property
    def _truth(self) -> Truth:
        return self.scored.truth
