"""What is measured of a set for its card."""

from dataclasses import dataclass

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
        barely: how many images show the marking by less than 20 pixels at a size of 224; None where that has no sense.
        shard_bytes: the size of its shards.
        parquet_bytes: the size of the same as Parquet.
    """

    group_order: int
    statistics: SplitStatistics
    barely: int | None
    shard_bytes: int
    parquet_bytes: int


def measure(published: PublishedSet, split: str, bundle: Bundle) -> SplitFigures:
    """Count what a split of a set in a bundle holds.

    Raises:
        DataError: a shard is missing or damaged.
    """
    statistics = split_statistics(published.folder, published.manifest, split)
    barely = None
    with load(published.folder, split) as dataset:
        group_order = len(dataset.symmetry_group)
        if dataset.is_annotated and dataset.has_marking:
            barely = int(np.count_nonzero(truth_of(dataset).strata["barely"]))
    entries = published.manifest.of_split(split)
    shard_bytes = sum(bundle.size(published.shard_name(entry)) for entry in entries)
    parquet_bytes = sum(bundle.size(published.parquet_name(entry)) for entry in entries)
    return SplitFigures(group_order, statistics, barely, shard_bytes, parquet_bytes)
