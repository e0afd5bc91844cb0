"""What predictions are held against: a split's symmetry sets, and its strata."""

import math
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.nearest import Circles, find_circles
from symsol_annot.dataset import Dataset, Labels, load
from symsol_annot.errors import DataError
from symsol_annot.set_folders import set_folders
from symsol_annot.so3 import Rotations, angle_between

BARELY_PX = 20  # at an image size of 224; scaled by area
_REFERENCE_AREA_PX = 224 * 224


@dataclass(frozen=True, eq=False)
class Truth:
    """The symmetry sets of a split, and what scoring derives from them once.

    Attributes:
        object: the object's name.
        split: "train" or "test".
        fingerprint: of the split.
        has_marking: whether the object has one.
        image_area_px: width x height.
        labels: rotations, symmetry masks, and whether the marking shows.
    """

    object: str
    split: str
    fingerprint: str
    has_marking: bool
    image_area_px: int
    labels: Labels

    def __len__(self) -> int:
        return len(self.labels)

    @cached_property
    def set_sizes(self) -> npt.NDArray[np.int64]:
        """(N,) how many members each image's set has."""
        return self.labels.symmetry_mask.sum(axis=1)

    @cached_property
    def circles(self) -> Circles | None:
        """The circles that the body's group discretises; None for a group of isolated rotations."""
        return find_circles(self.labels.symmetry_group)

    @cached_property
    def strata(self) -> dict[str, npt.NDArray[np.bool_]]:
        """Name to (N,) images: all; for a marked object also shown and hidden, which part it, and barely, in shown."""
        everything = np.ones(len(self), dtype=bool)
        if not self.has_marking:
            return {"all": everything}
        shown = self.labels.marking_visible
        barely_px = BARELY_PX * self.image_area_px / _REFERENCE_AREA_PX
        return {
            "all": everything,
            "shown": shown,
            "hidden": ~shown,
            "barely": shown & (self.labels.marking_pixels < barely_px),
        }


def near_elements(group: Rotations, angle_rad: float) -> npt.NDArray[np.bool_]:
    """Return which elements of a group (G, 3, 3) lie within an angle of each other, (G, G); so do R g and R g'."""
    return np.stack([angle_between(g, group) <= angle_rad for g in group])


def truth_of(dataset: Dataset) -> Truth:
    """Read the truth of a split.

    Raises:
        NotAnnotatedError: it has no symmetry sets.
        DataError: a shard is damaged.
    """
    return Truth(
        dataset.object,
        dataset.split,
        dataset.fingerprint,
        dataset.has_marking,
        math.prod(dataset.image_size),
        dataset.labels(),
    )


def find_set(data: Path, object_name: str) -> Path:
    """Return the folder of an object's set: `data` itself where it is a set, else the folder of that name in it.

    Raises:
        DataError: there is none.
    """
    for folder in set_folders(data):
        if folder == data or folder.name == object_name:
            return folder
    raise DataError(f"{data}: holds no set of the object {object_name!r}; --data names the folder that does")


def read_truth(data: Path, object_name: str, split: str) -> Truth:
    """Read the truth of an object's split from the set under `data`.

    Raises:
        DataError: there is no such set or split, or it is damaged or without symmetry sets.
    """
    with load(find_set(data, object_name), split) as dataset:
        return truth_of(dataset)
