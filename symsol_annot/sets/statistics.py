"""Counts over a split: how often the marking shows, how large the symmetry sets are."""

from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.rendering.renderer import BODY
from symsol_annot.sets.manifest import Manifest
from symsol_annot.sets.membership import checked_shard
from symsol_annot.sets.shard.reader import Shard, ShardLabels

_FEW_SIZES = 12


@dataclass
class SplitStatistics:
    """Counts over the finished shards of a split.

    Attributes:
        has_marking: whether the object has one.
        is_annotated: whether the split has symmetry sets.
        is_imported: whether only the sets' sizes can be counted.
        images: how many images were counted.
        shown: how many of them show the marking.
        parts_shown: of an object of format version 2, how many images show each of its parts, by name, in order.
        breaking: of such an object, the names of the parts that break its symmetry.
        sizes_by_parts: of such an object, `set_sizes` by which of its parts an image shows: their names, in order.
        set_sizes: |S|: how many images have a set of this size, of the sets that are isolated rotations and circles.
        measures: how many images have a set that fills this share of all rotations, of the others.
        candidates_drawn: of how many candidates the marking's area was needed.
        candidates_within_tolerance: of how many of these it was below the tolerance but not 0.
    """

    has_marking: bool
    is_annotated: bool
    is_imported: bool = False
    images: int = 0
    shown: int = 0
    parts_shown: Counter[str] = field(default_factory=Counter)
    breaking: tuple[str, ...] = ()
    sizes_by_parts: dict[tuple[str, ...], Counter[int]] = field(default_factory=dict)
    set_sizes: Counter[int] = field(default_factory=Counter)
    measures: Counter[float] = field(default_factory=Counter)
    candidates_drawn: int = 0
    candidates_within_tolerance: int = 0

    @property
    def telling(self) -> tuple[str, ...]:
        """The names of the parts that not all images show alike, or that break the symmetry: what tells sets apart."""
        shown = self.parts_shown.items()
        return tuple(name for name, count in shown if name in self.breaking or 0 < count < self.images)

    @property
    def sizes_by_telling_parts(self) -> dict[tuple[str, ...], Counter[int]]:
        """`sizes_by_parts`, but by those of the parts that tell sets apart."""
        found: dict[tuple[str, ...], Counter[int]] = {}
        for names, sizes in self.sizes_by_parts.items():
            key = tuple(name for name in names if name in self.telling)
            found[key] = found.get(key, Counter()) + sizes
        return found


def split_statistics(folder: Path, manifest: Manifest, split: str) -> SplitStatistics:
    """Count over the finished shards of a split, without reading its images.

    Raises:
        DataError: a shard is missing or broken.
    """
    statistics = SplitStatistics(manifest.settings.has_marking, manifest.is_annotated(split), manifest.is_imported)
    for entry in manifest.of_split(split):
        if not entry.is_finished:
            continue
        shard, labels = checked_shard(folder, manifest, entry)
        statistics.images += len(shard)
        if labels.symmetry_mask is not None:
            statistics.set_sizes.update(labels.symmetry_mask[~_have_volume(labels)].sum(axis=1).tolist())
        if labels.volume is not None:
            statistics.measures.update(labels.volumes[place].measure for place in labels.volume[labels.volume >= 0])
        if labels.marking_pixels is not None:
            statistics.shown += int(np.count_nonzero(labels.marking_pixels >= shard.tolerance_px))
        _count_parts(statistics, shard, labels)
        statistics.candidates_drawn += shard.candidates_drawn
        statistics.candidates_within_tolerance += shard.candidates_within_tolerance
    return statistics


def _count_parts(statistics: SplitStatistics, shard: Shard, labels: ShardLabels) -> None:
    """Count which parts the images of a shard show, and the sizes of their sets by that."""
    if shard.equality is None or labels.part_pixels is None:
        return
    names = shard.equality.parts
    statistics.breaking = tuple(names[part - BODY] for part in shard.equality.breaking)
    shows = labels.part_pixels >= (shard.tolerance_px if statistics.breaking else np.finfo(np.float32).tiny)
    for name, count in zip(names, shows.sum(axis=0).tolist(), strict=True):
        statistics.parts_shown[name] += count
    if labels.symmetry_mask is None:
        return
    isolated = ~_have_volume(labels)
    for row, size in zip(shows[isolated], labels.symmetry_mask[isolated].sum(axis=1).tolist(), strict=True):
        shown = tuple(name for name, is_shown in zip(names, row, strict=True) if is_shown)
        statistics.sizes_by_parts.setdefault(shown, Counter())[size] += 1


def _have_volume(labels: ShardLabels) -> npt.NDArray[np.bool_]:
    """Tell which images (N,) have sets that fill a volume."""
    images = 0 if labels.symmetry_mask is None else len(labels.symmetry_mask)
    return np.zeros(images, dtype=bool) if labels.volume is None else labels.volume >= 0


def sizes_in_words(set_sizes: Counter[int], measures: Counter[float] | None = None) -> str:
    """Say which sizes symmetry sets have: each of a few, else the span and the median of those larger than 1.

    Args:
        set_sizes: how many images have a set of so many rotations.
        measures: how many have one that fills such a share of all rotations.
    """
    filling = [f"{share:.1%} of all rotations in {count}" for share, count in sorted((measures or {}).items())]
    if filling:
        return ", ".join([*filling, *([sizes_in_words(set_sizes)] if set_sizes else [])])
    if len(set_sizes) <= _FEW_SIZES:
        return ", ".join(f"{size} in {count}" for size, count in sorted(set_sizes.items()))
    several = sorted(size for size, count in set_sizes.items() for _ in range(count) if size > 1)
    single = f"1 in {set_sizes[1]}, else " if 1 in set_sizes else ""
    return f"{single}{several[0]} to {several[-1]}, median {several[len(several) // 2]}"
