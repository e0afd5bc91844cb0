"""What predictions are held against: a split's symmetry sets, and its strata.

Of a sealed split, which has no labels, anybody knows enough to write and to check predictions: it is a `Subject`.
"""

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.counted import Counted, counted
from symsol_annot.errors import DataError, first_of
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.rotations.nearest import Circles
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sealing.labels import labelled_split
from symsol_annot.sets.dataset import Dataset, load
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import Manifest, read_manifest
from symsol_annot.sets.sample_set import SAMPLE_OBJECTS, sample_folder
from symsol_annot.sets.shard.labels import Labels
from symsol_annot.system.text.names import SPLITS

HARD_NEGATIVE_RAD = float(np.radians(5.0)) + 1e-9  # the slack is for labels, which are float64
BARELY_PX = 20  # at an image size of 224; scaled by area
_REFERENCE_AREA_PX = 224 * 224
_SHOWN = 8  # sets, in a message


class Subject(Protocol):
    """A split that predictions are about, as far as a file of them is checked against it."""

    @property
    def object(self) -> str:
        """The object's name."""

    @property
    def split(self) -> str:
        """Whether it is "train" or "test"."""

    @property
    def fingerprint(self) -> str:
        """The SHA-256 that names the split."""

    @property
    def other_fingerprints(self) -> Mapping[str, str]:
        """Those that the split's may be mistaken for, to what they are of: the whole set, the other split."""

    @property
    def folder(self) -> str:
        """Of the set, as the command line would name it; empty where it is not known."""

    @property
    def is_sealed(self) -> bool:
        """Whether those who predict it have no labels."""

    @property
    def symmetry_group(self) -> Rotations:
        """The (G, 3, 3) symmetries of the object's body, identity first."""

    def __len__(self) -> int:
        """How many images it has."""


@dataclass(frozen=True, eq=False)
class SealedSplit:
    """A split whose labels are not known here.

    Attributes:
        object: the object's name.
        split: "test".
        fingerprint: of the split.
        images: how many it has.
        symmetry_group: (G, 3, 3), the body's symmetries, identity first.
        other_fingerprints: as `Subject` has them.
        folder: of the set.
    """

    object: str
    split: str
    fingerprint: str
    images: int
    symmetry_group: Rotations
    other_fingerprints: Mapping[str, str]
    folder: str
    is_sealed = True

    def __len__(self) -> int:
        return self.images


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
        other_fingerprints: those that the split's may be mistaken for, to what they are of: the whole set, the other
            split.
        folder: of the set, as the command line would name it; empty where it is not known.
        is_sealed: whether those who predicted it had no labels; they are then of the sealed test's own set.
    """

    object: str
    split: str
    fingerprint: str
    has_marking: bool
    image_area_px: int
    labels: Labels
    other_fingerprints: Mapping[str, str] = field(default_factory=dict)
    folder: str = ""
    is_sealed: bool = False

    def __len__(self) -> int:
        return len(self.labels)

    @property
    def symmetry_group(self) -> Rotations:
        """The (G, 3, 3) symmetries of the object's body, identity first."""
        return self.labels.symmetry_group

    @cached_property
    def set_sizes(self) -> npt.NDArray[np.int64]:
        """(N,) |S|: how many members each image's set has, each rotation of the standard grid in its volume for one."""
        return self.counted_on(STANDARD_LEVEL).set_sizes

    def counted_on(self, level: int) -> Counted:
        """Return what the sets consist of where volumes are counted by the rotations of a grid in them."""
        return counted(self.labels, level)

    @property
    def circles(self) -> Circles | None:
        """The circles that the body's group discretises; None for a group of isolated rotations."""
        return self.labels.circles

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
        _other_fingerprints(dataset.manifest, dataset.split),
        str(dataset.folder),
    )


def part_of(truth: Truth, rows: npt.NDArray[np.int64]) -> Truth:
    """Return the truth of some of a split's images alone, in the order of `rows` (n,)."""
    labels = truth.labels
    part = replace(
        labels,
        rotation=labels.rotation[rows],
        symmetry_mask=labels.symmetry_mask[rows],
        marking_pixels=labels.marking_pixels[rows],
        marking_visible=labels.marking_visible[rows],
        part_pixels=None if labels.part_pixels is None else labels.part_pixels[rows],
        volume=None if labels.volume is None else labels.volume[rows],
    )
    return replace(truth, labels=part)


def subject_of(dataset: Dataset) -> Truth | SealedSplit:
    """Return what predictions about a split are checked against: its truth or, where it is sealed, what is known of it.

    Raises:
        NotAnnotatedError: it is not sealed, and has no symmetry sets.
        DataError: a shard is damaged.
    """
    if not dataset.manifest.is_sealed:
        return truth_of(dataset)
    return SealedSplit(
        dataset.object,
        dataset.split,
        dataset.fingerprint,
        len(dataset),
        dataset.symmetry_group,
        _other_fingerprints(dataset.manifest, dataset.split),
        str(dataset.folder),
    )


def opened_truth(dataset: Dataset, secrets: Sequence[Path]) -> Truth:
    """Return the truth of a sealed split, its labels from the set beside that of the secrets which is its own.

    Raises:
        SealError: none of the secrets is that of this sealed set, or the labels are not there or not of its images.
        DataError: a shard is damaged.
    """
    with labelled_split(dataset, secrets) as labelled:
        return replace(
            truth_of(labelled),
            fingerprint=dataset.fingerprint,
            other_fingerprints=_other_fingerprints(dataset.manifest, dataset.split),
            folder=str(dataset.folder),
            is_sealed=True,
        )


def find_set(data: str | os.PathLike[str], object_name: str, split: str = "test", fingerprint: str = "") -> Path:
    """Return the folder of an object's set, whatever it is called: `data` itself where it is a set, else one in it.

    Where none of them has the fingerprint, and the set that comes with the package has it, it is that one.

    Args:
        data: a set's folder, or the folder of sets.
        object_name: which object the set's manifest must name.
        split: whose fingerprint tells several sets of the object apart.
        fingerprint: of that split; where none of the sets has it, or it is empty, the folder that has the object's
            name is taken.

    Raises:
        DataError: there is none, or there are several that nothing tells apart.
    """
    folder = Path(data)
    folders = set_folders(folder)
    if folders == [folder]:
        return folder
    manifests = {place: _manifest(place) for place in folders}
    of_object = [place for place, found in manifests.items() if found and found.settings.object == object_name]
    by_content = [p for p in of_object if fingerprint and _split_fingerprint(manifests[p], split) == fingerprint]
    of_sample = [] if by_content else _sample_with(object_name, split, fingerprint)
    by_name = [place for place in folders if place.name == object_name and place in (of_object or folders)]
    for chosen in (by_content, of_sample, by_name, of_object):
        if len(chosen) == 1 or (chosen and chosen is by_content):  # sets of the same contents serve alike
            return chosen[0]
    if of_object:
        names = ", ".join(str(place) for place in of_object)
        raise DataError(
            f"{folder}: holds several sets of the object {object_name!r}, and their {split} fingerprints are none of "
            f"the wanted one: {names}; --data names the one that is meant"
        )
    raise DataError(f"{folder}: holds no set of the object {object_name!r}: {_in_words(folder, manifests)}")


def read_subject(
    data: str | os.PathLike[str], object_name: str, split: str, fingerprint: str = "", secrets: Sequence[Path] = ()
) -> Truth | SealedSplit:
    """Read what predictions are about from the set under `data`, which `find_set` finds by the same arguments.

    Args:
        data: a set's folder, or the folder of sets.
        object_name: the object's name.
        split: "train" or "test".
        fingerprint: of that split.
        secrets: files of sealed tests' secrets, with which the truth of a sealed split is read; without, it is not.

    Raises:
        DataError: there is no such set or split, or it is damaged or, not being sealed, without symmetry sets.
        SealError: none of the secrets given is that of the sealed set.
    """
    with load(find_set(data, object_name, split, fingerprint), split) as dataset:
        if secrets and dataset.manifest.is_sealed:
            return opened_truth(dataset, secrets)
        return subject_of(dataset)


def _sample_with(object_name: str, split: str, fingerprint: str) -> list[Path]:
    """Return the folder of the package's own set of an object, if the split's fingerprint is this one."""
    folder = sample_folder() / object_name
    is_it = (
        fingerprint and object_name in SAMPLE_OBJECTS and _split_fingerprint(_manifest(folder), split) == fingerprint
    )
    return [folder] if is_it else []


def _manifest(folder: Path) -> Manifest | None:
    """Return a set's manifest; None where it cannot be read, so that a broken set does not hide the others."""
    try:
        return read_manifest(folder)
    except DataError:
        return None


def _split_fingerprint(manifest: Manifest | None, split: str) -> str | None:
    return manifest.split_fingerprint(split) if manifest else None


def _other_fingerprints(manifest: Manifest, split: str) -> dict[str, str]:
    """Return what else of a set has a fingerprint: fingerprint to words."""
    found = {manifest.split_fingerprint(other): f"the {other} split's" for other in SPLITS if other != split}
    found[manifest.fingerprint] = "the whole set's"
    return {fingerprint: words for fingerprint, words in found.items() if fingerprint is not None}


def _in_words(folder: Path, manifests: Mapping[Path, Manifest | None]) -> str:
    """Say which sets there are instead, and what to do."""
    if not folder.is_dir():
        return "there is no such folder; --data names the folder of the sets"
    if not manifests:
        return "there is no set in it; --data names the folder of the sets, `symsol-annot render` makes one"
    lines = [
        f"{place.name} ({found.settings.object if found else 'its manifest cannot be read'})"
        for place, found in manifests.items()
    ]
    return f"its sets are {first_of(lines, _SHOWN)}; --data names the folder of the set that is meant"
