"""Counts over a split: how often the marking shows, how large the symmetry sets are."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from symsol_annot.manifest import Manifest
from symsol_annot.shards import open_shard


@dataclass
class SplitStatistics:
    """Counts over the finished shards of a split.

    Attributes:
        has_marking: whether the object has one.
        is_annotated: whether the split has symmetry sets.
        images: how many images were counted.
        shown: how many of them show the marking.
        set_sizes: |S|: how many images have a set of this size.
        candidates_drawn: of how many candidates the marking's area was needed.
        candidates_within_tolerance: of how many of these it was below the tolerance but not 0.
    """

    has_marking: bool
    is_annotated: bool
    images: int = 0
    shown: int = 0
    set_sizes: Counter[int] = field(default_factory=Counter)
    candidates_drawn: int = 0
    candidates_within_tolerance: int = 0


def split_statistics(folder: Path, manifest: Manifest, split: str) -> SplitStatistics:
    """Count over the finished shards of a split, without reading its images.

    Raises:
        DataError: a shard is missing or broken.
    """
    statistics = SplitStatistics(manifest.recipe["tolerance_px"] is not None, manifest.is_annotated(split))
    for entry in manifest.of_split(split):
        if not entry.is_finished:
            continue
        with open_shard(folder / entry.file) as shard:
            statistics.images += len(shard["rotation"])
            shown = shard["marking_pixels"][...] >= float(shard.attrs["tolerance_px"])
            statistics.shown += int(np.count_nonzero(shown))
            statistics.candidates_drawn += int(shard.attrs["candidates_drawn"])
            statistics.candidates_within_tolerance += int(shard.attrs["candidates_within_tolerance"])
            if "symmetry_mask" in shard:
                statistics.set_sizes.update(shard["symmetry_mask"][...].sum(axis=1).tolist())
    return statistics
