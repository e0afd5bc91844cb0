"""What is measured of a set for its card, and how it is kept as JSON."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from symsol_annot.bench.predictions.truth import truth_of
from symsol_annot.publish.bundle import Bundle
from symsol_annot.publish.sets import PublishedSet
from symsol_annot.sets.dataset import load
from symsol_annot.sets.statistics import SplitStatistics, split_statistics


@dataclass(frozen=True)
class SplitFigures:
    """What was counted of a split.

    Attributes:
        group_order: how many symmetries the object's body has.
        statistics: images, markings, set sizes, candidates.
        barely: how many images show the marking by less than 20 pixels at a size of 224; None without a marking, or
            without symmetry sets.
        shard_bytes: the size of its shards; None where only labels were measured.
        parquet_bytes: the size of the same images as Parquet; None where only labels were measured.
    """

    group_order: int
    statistics: SplitStatistics
    barely: int | None
    shard_bytes: int | None
    parquet_bytes: int | None


Figures: TypeAlias = Mapping[tuple[str, str], SplitFigures]  # by the set's name and the split


def measure(published: PublishedSet, split: str, bundle: Bundle) -> SplitFigures:
    """Return what a split of a set in a bundle holds.

    Raises:
        DataError: a shard is missing or damaged.
    """
    entries = published.manifest.of_split(split)
    shard_bytes = sum(bundle.size(published.shard_name(entry)) for entry in entries)
    parquet_bytes = sum(bundle.size(published.parquet_name(entry)) for entry in entries)
    return replace(measure_labels(published, split), shard_bytes=shard_bytes, parquet_bytes=parquet_bytes)


def measure_labels(published: PublishedSet, split: str) -> SplitFigures:
    """Return what the labels of a split say: everything but the sizes of its files.

    Raises:
        DataError: a shard is missing or damaged.
    """
    statistics = split_statistics(published.folder, published.manifest, split)
    with load(published.folder, split) as dataset:
        barely = None
        if dataset.is_annotated and dataset.has_marking:
            barely = int(np.count_nonzero(truth_of(dataset).strata["barely"]))
        return SplitFigures(len(dataset.symmetry_group), statistics, barely, None, None)


def to_document(figures: Figures) -> dict[str, Any]:
    """Return figures as JSON data: by the set's name, then by the split."""
    document: dict[str, Any] = {}
    for (name, split), found in figures.items():
        sizes = {str(size): images for size, images in sorted(found.statistics.set_sizes.items())}
        statistics = {**asdict(found.statistics), "set_sizes": sizes}
        for left_out in ("measures", "parts_shown", "breaking", "sizes_by_parts"):  # a card tells nothing of parts
            del statistics[left_out]
        if measures := found.statistics.measures:
            statistics["measures"] = {repr(share): images for share, images in sorted(measures.items())}
        document.setdefault(name, {})[split] = {**asdict(found), "statistics": statistics}
    return document


def from_document(document: Mapping[str, Any]) -> Figures:
    """Return the figures that `to_document` gave."""
    figures = {}
    for name, splits in document.items():
        for split, kept in splits.items():
            sizes = Counter({int(size): images for size, images in kept["statistics"]["set_sizes"].items()})
            measures = Counter({float(share): count for share, count in kept["statistics"].get("measures", {}).items()})
            statistics = SplitStatistics(**{**kept["statistics"], "set_sizes": sizes, "measures": measures})
            figures[name, split] = SplitFigures(**{**kept, "statistics": statistics})
    return figures
