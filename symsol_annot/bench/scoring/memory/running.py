"""A metric for a training loop: predictions in batches, on one process or on several, scored at the end."""

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.contents import filled
from symsol_annot.bench.predictions.truth import part_of, truth_of
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.predictions.writing.asked import DEFAULT_BATCH, columns_of_array
from symsol_annot.bench.scoring.memory.answered import GridRun, HeldAnswers
from symsol_annot.bench.scoring.memory.in_memory import (
    Asking,
    answers_of,
    grid_attributes,
    known_track,
    mend_of_answer,
    mend_of_row,
    plain,
    refuse_no_dataset,
    refuse_slice,
    score_arrays,
)
from symsol_annot.bench.scoring.memory.scores import Scores
from symsol_annot.bench.scoring.scoring import ObjectScores
from symsol_annot.errors import ScoresError, SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets.dataset import Dataset

_STATE = ("track", "fingerprint", "answers", "run")


class Metric:
    """Scores of predictions that come in batches, with the habits of torchmetrics: update, compute, reset.

    ::

        metric = symsol_annot.bench.Metric(test)
        for batch in loader:
            metric.update(model(batch["image"]), batch["index"])
        scores = metric.compute()

    An image counts once, however often it is given: a sampler that fills up the last batch, or gives two ranks one
    image, changes no figure. The figures of a whole split are those of `symsol_annot.score`, to the bit.

    Over ranks, gather what `state` returns, and `merge` it; neither torch nor a group of processes is needed for that.
    """

    def __init__(
        self,
        dataset: Dataset,
        track: str = "hypotheses",
        *,
        method: str = "in memory",
        level: int = STANDARD_LEVEL,
        floor: float | None = None,
        batch_size: int = DEFAULT_BATCH,
        intervals: bool = False,
    ) -> None:
        """Read the truth of a split.

        Args:
            dataset: the split, or a slice of it, as `symsol_annot.load` returns it.
            track: "hypotheses", "classifier" or "density".
            method: what the method calls itself.
            level: of the grid on which a classifier or a density is asked.
            floor: as `symsol_annot.score` takes it.
            batch_size: how many rotations a classifier or a density is asked about at once.
            intervals: whether figures get bootstrap intervals.

        Raises:
            SettingsError: there is no such track, a number is out of its range, or a classifier is to be scored on a
                slice.
            NotAnnotatedError: the split has no symmetry sets.
        """
        refuse_no_dataset(dataset)
        self._dataset, self._track, self._method, self._intervals = dataset, known_track(track), method, intervals
        refuse_slice(self._track, dataset)
        self._asking = Asking(level, floor, batch_size)
        self._truth = truth_of(dataset)
        self._places = {int(index): place for place, index in enumerate(dataset.indices)}
        self.reset()

    def reset(self) -> None:
        """Forget all predictions."""
        self._answers: dict[int, Answer] = {}  # of hypotheses, by the image's place in the dataset
        self._run: GridRun | None = None
        if self._track.name != "hypotheses":
            attributes = grid_attributes(self._track, self._dataset, self._asking, self._method)
            self._run = GridRun(self._track, self._truth, attributes)

    def update(self, predictions: Any, index: Any) -> None:
        """Take the predictions of some images; those of an image that was given before are left out.

        Args:
            predictions: hypotheses R_m2c as an array or a tensor (b, M, 3, 3), or a list of b of them (M_i, 3, 3); of a
                classifier or a density, a callable from an image's index and rotations (n, 3, 3) to probabilities or
                log-densities (n,).
            index: (b,) the images' indices within the split, like `batch["index"]` of `symsol_annot.torch`.

        Raises:
            SettingsError: a wrong shape or type, or an index that the split does not have. Where what was meant can be
                told, the message ends with a line of code that mends it.
            RotationError: a matrix is no rotation; the message names the image.
            PredictionsError: a callable's answers have faults.
        """
        images = self._checked(index)
        mend: Callable[[Any], str] = mend_of_answer
        if self._run is None and not callable(predictions):
            given = dict(zip(images, self._of_batch(predictions, len(images)), strict=True))
            predictions, mend = given.__getitem__, mend_of_row
        done = set(self._done().tolist())
        new = [i for i in dict.fromkeys(images) if self._places[i] not in done]
        answer = answers_of(self._track, predictions, self._dataset, self._asking, mend)
        found = {self._places[i]: answer(i) for i in new}
        if self._run is None:
            self._answers |= found
        elif found:
            self._run.add(found)

    def compute(self) -> Scores:
        """Return the scores of the images that were given, by now or over all states that were merged.

        Raises:
            ScoresError: none was given.
            PredictionsError: the predictions have faults, all of which it lists.
        """
        places = self._done()
        if not len(places):
            raise ScoresError(
                "no image was given yet: call `metric.update(predictions, index)` before `metric.compute()`"
            )
        truth = part_of(self._truth, places)
        if self._run is None:
            columns = self._track.columns(HeldAnswers([self._answers[place] for place in places.tolist()]))
            arrays = {name: filled(column) for name, column in columns.items()}
            scored = score_arrays(truth, {"method": self._method}, arrays, intervals=self._intervals)
        else:
            tracks = {self._track.name: self._run.scores(intervals=self._intervals)}
            scored = ObjectScores("", "", self._method, truth, tracks)
        is_whole = self._dataset.is_whole and len(places) == len(self._dataset)
        return Scores(self._dataset.indices[places], is_whole, scored)

    def state(self) -> dict[str, Any]:
        """Return all that was given, in plain arrays that can be pickled and sent to other ranks.

        With `torch.distributed`, on every rank::

            states = [None] * torch.distributed.get_world_size()
            torch.distributed.all_gather_object(states, metric.state())
            metric.merge(*states)
        """
        return {
            "track": self._track.name,
            "fingerprint": self._truth.fingerprint,
            "answers": self._answers,
            "run": None if self._run is None else self._run.state(),
        }

    def merge(self, *states: Mapping[str, Any]) -> None:
        """Take what other ranks were given; an image that several have counts once.

        A rank's own state may be among them.

        Raises:
            SettingsError: a state is none, or is of another split or another track.
        """
        for state in states:
            self._refuse_another(state)
        for state in states:
            self._answers = {**state["answers"], **self._answers}
            if self._run is not None:
                self._run.join(state["run"])

    def __len__(self) -> int:
        return len(self._done())

    def __repr__(self) -> str:
        return f"<Metric {self._track.name}: {len(self)} of {len(self._dataset)} images of {self._dataset!r}>"

    def _done(self) -> npt.NDArray[np.int64]:
        """Return the places (n,) of the images that were given, ascending."""
        return np.array(sorted(self._answers), dtype=np.int64) if self._run is None else self._run.rows

    def _checked(self, index: Any) -> list[int]:
        found = np.asarray(plain(index))
        if found.ndim != 1 or found.dtype.kind not in "iu":
            raise SettingsError(
                f"index: expected whole numbers (b,), the indices of the batch's images within the split, found "
                f'{found.dtype} of shape {found.shape}; of a batch of symsol_annot.torch they are batch["index"]'
            )
        images: list[int] = found.tolist()
        strange = [i for i in images if i not in self._places]
        if strange:
            raise SettingsError(
                f"index: {self._dataset!r} has no image {strange[0]}; indices are within the split, from 0"
            )
        return images

    def _of_batch(self, predictions: Any, count: int) -> list[Array]:
        """Return a batch's hypotheses image by image; what is wrong with one image's is found later."""
        given = plain(predictions)
        if isinstance(given, list) and len(given) == count and all(np.ndim(rows) == 3 for rows in given):
            return given
        array = filled(columns_of_array(given, None, count, "predictions")["hypotheses"])
        if len(array) != count:
            raise SettingsError(
                f"predictions: expected one row per index, {count} of them, found the shape {array.shape}"
            )
        return list(array)

    def _refuse_another(self, state: Any) -> None:
        if not isinstance(state, Mapping) or set(state) != set(_STATE):
            raise SettingsError(f"merge: expected what Metric.state returns, found {type(state).__name__}")
        for name, mine in (("track", self._track.name), ("fingerprint", self._truth.fingerprint)):
            if state[name] != mine:
                raise SettingsError(f"merge: a state is of the {name} {state[name]!r}, this metric of {mine!r}")
