"""Readers of an epoch in worker processes; a module of its own, as a spawned process imports it."""

import numpy as np
import torch
from torch.utils.data import IterableDataset, get_worker_info

from symsol_annot import load, shuffled_order
from symsol_annot.sets import dataset as dataset_module
from symsol_annot.sets.shard import reader as shards

OPENED = []  # by this process, from `record_opens` on


class RecordedFile(dataset_module.ByteFile):
    """Notes its name."""

    def __init__(self, path):
        super().__init__(path)
        OPENED.append(path.name)


def record_opens(*_):
    """Begin to note the shards that this process opens."""
    OPENED.clear()
    shards.ByteFile = dataset_module.ByteFile = RecordedFile


def collate(samples):
    """Return a batch as tensors; torch knows no way from dataclasses to them. And who read it, and what that opened."""
    batch = {
        name: torch.from_numpy(np.stack([getattr(sample, name) for sample in samples]))
        for name in ("index", "image", "rotation", "symmetry_mask")
    }
    return {**batch, "worker": get_worker_info().id, "opened": list(OPENED)}


class Part(IterableDataset):
    """A rank's share of an epoch, of which each worker reads a part of its own."""

    def __init__(self, dataset, seed, rank=0, ranks=1):
        self.dataset, self.seed, self.rank, self.ranks = dataset, seed, rank, ranks

    def __iter__(self):
        worker = get_worker_info()
        part, parts = self.rank * worker.num_workers + worker.id, self.ranks * worker.num_workers
        order = shuffled_order(self.dataset, self.seed, part=part, parts=parts)
        return (self.dataset[row] for row in order)


def read_part(folder, part, parts):
    """Read a part; return the order of its rows, the indices of its samples and the shards that were opened."""
    record_opens()
    with load(folder) as dataset:
        order = shuffled_order(dataset, seed=3, epoch=1, part=part, parts=parts)
        return order, [dataset[row].index for row in order], list(OPENED)
