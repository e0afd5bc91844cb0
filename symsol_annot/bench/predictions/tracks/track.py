"""What a track is: its data sets and attributes, what reads it, what writes it, and what it ranks by."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Container, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Answers, Column
from symsol_annot.bench.predictions.proposals import Predicted
from symsol_annot.bench.predictions.structure import Structure
from symsol_annot.bench.predictions.truth import Subject, Truth
from symsol_annot.sets.dataset import Dataset

Indices = npt.NDArray[np.int64]
Flags = npt.NDArray[np.bool_]


class TrackReader(ABC):
    """One track of an open predictions file: checked, and read in blocks of bounded size.

    A block has `image_index` (b,), which images it is about, and what the track says of them.

    Attributes:
        name: of the track.
        block_bytes: how many bytes of values are read at once, unless one image has more.
    """

    block_bytes: ClassVar[int] = 2**24
    name: ClassVar[str]

    def __init__(self, structure: Structure) -> None:
        self._structure, self._faults, self._file = structure, structure.faults, structure.file

    @abstractmethod
    def is_sound(self) -> bool:
        """Check what can be known before the track is read; faults go to the file's log."""

    @abstractmethod
    def blocks(self, image_index: Indices) -> Iterator[Any]:
        """Yield blocks, from which images or whole blocks with a fault are left out; faults go to the file's log.

        Args:
            image_index: (N,) which image each row of the file is about.

        Raises:
            PredictionsError: the file cannot be read.
        """

    @abstractmethod
    def proposals(self, truth: Truth) -> Callable[[Any, int], Predicted]:
        """Return what takes a block and a row of it to the rotations that pictures show for that image."""


@dataclass(frozen=True)
class Track:
    """All that is known of a track but how it is scored, which `bench.scoring` adds.

    Attributes:
        reader: what checks and reads it.
        title: what pictures show of it, in words.
        datasets: the names of its data sets; the first tells in a message what is missing.
        attributes: the names and types of those attributes of the file that a writer of this track may give.
        defaults: from the dataset and the attributes that a writer was given to the values of those left out.
        columns: from what was answered about each image to the track's data sets.
        ranked_by: the metric by which results rank, its name in scores.json.
        ranked_by_if_there: the metric that takes its place in the scores that have it; empty for none.
        why_not_sealed: why it cannot be asked about the images of a sealed test; empty where it can.
    """

    reader: type[TrackReader]
    title: str
    datasets: tuple[str, ...]
    attributes: Mapping[str, type]
    defaults: Callable[[Dataset, Mapping[str, Any]], dict[str, Any]]
    columns: Callable[[Answers], dict[str, Column]]
    ranked_by: str
    ranked_by_if_there: str = ""
    why_not_sealed: str = ""

    def fault_of_sealing(self, about: Subject) -> str:
        """Say why the track cannot be about a split; empty where it can."""
        if not (about.is_sealed and self.why_not_sealed):
            return ""
        return f"the track {self.name!r} is not offered on sealed images: {self.why_not_sealed} (docs/sealed.md)"

    def ranked_among(self, names: Container[str]) -> str:
        """Return the metric by which scores that have metrics of these names rank."""
        return self.ranked_by_if_there if self.ranked_by_if_there in names else self.ranked_by

    @property
    def name(self) -> str:
        """Its name, in messages, in scores.json and as a choice on the command line."""
        return self.reader.name
