"""What a gallery shows: splits of sets, each with its truth."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from symsol_annot.bench.predictions.truth import Truth, truth_of
from symsol_annot.errors import DataError
from symsol_annot.sets.dataset import Dataset, load
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.system.text.names import SPLITS

_NOT_IN_FILE_NAMES = re.compile(r"[^A-Za-z0-9._-]+")


@dataclass(frozen=True, eq=False)
class Source:
    """One split of one set.

    Attributes:
        dataset: its images that are shown: the whole split, or the first of it.
        truth: of the whole split.
        folder: where the gallery keeps what belongs to it, relative to its own folder.
    """

    dataset: Dataset
    truth: Truth
    folder: str


def open_sources(data: Path, splits: Sequence[str] = ("test",), limit: int | None = None) -> list[Source]:
    """Open a set, or every set in a folder of sets.

    Args:
        data: a set's folder, or a folder of sets.
        splits: those that are wanted; a set that lacks one of them gives the others.
        limit: how many images of each split are shown, from its beginning; None for all.

    Raises:
        DataError: no set is there, none has such a split, or one is damaged.
        NotAnnotatedError: a split was rendered without symmetry sets.
    """
    found = [
        (folder, split)
        for folder in set_folders(data) or [data]
        for split, images in ((split, read_manifest(folder).images(split)) for split in SPLITS)
        if images and split in splits
    ]
    if not found:
        raise DataError(f"{data}: has no split {' or '.join(splits)}; `symsol-annot info` says what a set has")
    datasets = [load(folder, split) for folder, split in found]
    return [
        Source(dataset[:limit], truth_of(dataset), folder_name(number, dataset.object, dataset.split))
        for number, dataset in enumerate(datasets)
    ]


def folder_name(number: int, object_name: str, split: str) -> str:
    """Return where a gallery keeps a source; whatever the object's name, it is one folder in sets/."""
    return f"sets/{number:02d}-{_NOT_IN_FILE_NAMES.sub('-', object_name)[:40]}-{split}"
