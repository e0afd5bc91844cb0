"""A split's images and rotations in batches on a device: from memory where they fit, else from worker processes.

The order of an epoch follows from seed and epoch alone, so that training goes on after any epoch as if it had never
stopped. An epoch's last images, if fewer than a batch, are left out: every step then has the same shape.
"""

import hashlib
import math
from collections.abc import Iterator
from functools import partial
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from symsol_annot.bench.models.batches import Batch, reduced
from symsol_annot.bench.models.devices import free_bytes
from symsol_annot.bench.models.training.split_reader import SplitReader
from symsol_annot.bench.models.volumes import ImageVolumes
from symsol_annot.bench.predictions.truth import HARD_NEGATIVE_RAD
from symsol_annot.sets.dataset import Dataset, Sample
from symsol_annot.sets.epoch_order import shuffled_order
from symsol_annot.system.machine import cores

_DEVICE_SHARE, _HOST_SHARE = 0.5, 0.6  # of free memory that images may take; a network needs the rest
_MAX_WORKERS = 8  # unless more are asked for
_AS_THEY_ARE = SplitReader()


class BatchSource(Protocol):
    """Batches on a device, by epochs.

    Attributes:
        where: the images are, in words.
        batch_size: of a batch, in images.
    """

    where: str
    batch_size: int

    def batches(self, epoch: int) -> Iterator[Batch]:
        """Return the batches of an epoch, in its order."""

    def batches_per_epoch(self) -> int:
        """Return how many batches an epoch has."""


class InMemory:
    """All images decoded: in the device's memory, or in the host's, pinned for a GPU."""

    def __init__(self, images: Batch, batch_size: int, seed: int, device: torch.device, *, on_device: bool) -> None:
        self._all = images.to(device) if on_device else images
        self.batch_size, self._seed, self._device = min(batch_size, len(images.images)), seed, device
        self._has_to_move = device.type != "cpu" and not on_device
        self.where = "GPU memory" if on_device and device.type != "cpu" else "memory"

    def batches(self, epoch: int) -> Iterator[Batch]:
        """Return the batches of an epoch, shuffled over all images."""
        images = self._all.images
        order = torch.randperm(len(images), generator=generator("cpu", self._seed, epoch, "order"))
        for rows in torch.split(order[: self.batches_per_epoch() * self.batch_size], self.batch_size):
            batch = self._all.rows(rows.to(images.device))
            yield batch.pinned().to(self._device) if self._has_to_move else batch

    def batches_per_epoch(self) -> int:
        """Return how many batches an epoch has."""
        return len(self._all.images) // self.batch_size


class _Labels(NamedTuple):
    """What is known of all images, as in a batch: which candidates (N, G) are what, and volumes; each or None."""

    is_rejected: Tensor | None = None
    is_member: Tensor | None = None
    volumes: ImageVolumes | None = None


_NO_LABELS = _Labels()


class Streamed:
    """Images read by worker processes, each a part of `shuffled_order`."""

    where = "worker processes"

    def __init__(
        self,
        dataset: Dataset,
        batch_size: int,
        seed: int,
        device: torch.device,
        workers: int,
        input_size: int = 0,
        labels: _Labels = _NO_LABELS,
    ) -> None:
        self._dataset, self._seed, self._device, self._labels = dataset, seed, device, labels
        self._input_size = input_size
        self._workers = max(1, min(workers, len(dataset) // batch_size))
        self.batch_size = min(batch_size, len(dataset))

    def batches(self, epoch: int) -> Iterator[Batch]:
        """Return the batches of an epoch, a worker's one after the other's."""
        loader = DataLoader(
            _Part(self._dataset, self._seed, epoch),
            batch_size=self.batch_size,
            drop_last=True,
            num_workers=self._workers,
            collate_fn=partial(_collate, self._input_size),
            pin_memory=self._device.type == "cuda",
            multiprocessing_context="spawn",  # a fork may inherit locks that torch's threads hold
        )
        for rows, images, R_gt in loader:
            known = {name: part[rows] for name, part in self._labels._asdict().items() if part is not None}
            yield Batch(images, R_gt, **known).to(self._device)

    def batches_per_epoch(self) -> int:
        """Return how many batches an epoch has: whole ones of each worker's part."""
        n, parts = len(self._dataset), self._workers
        return sum((n * (part + 1) // parts - n * part // parts) // self.batch_size for part in range(parts))


def open_batches(
    dataset: Dataset,
    batch_size: int,
    seed: int,
    device: torch.device,
    *,
    reader: SplitReader = _AS_THEY_ARE,
    with_rejected: bool = False,
    with_members: bool = False,
    with_volumes: bool = False,
) -> BatchSource:
    """Return a split's batches from the nearest memory that holds its images; else from worker processes.

    Args:
        dataset: its images.
        batch_size: of a batch, in images.
        seed: of their order.
        device: where they are needed.
        reader: reads the images.
        with_rejected: whether batches say which candidates are rejected, `is_rejected`.
        with_members: whether batches say which candidates are in the symmetry set, `is_member`.
        with_volumes: whether batches have the volumes of their symmetry sets.

    Raises:
        NotAnnotatedError: rejected candidates, members, or volumes, of a split without symmetry sets.
        DataError: a shard is damaged.
    """
    is_rejected = _rejected(dataset) if with_rejected else None
    is_member = torch.from_numpy(dataset.labels().symmetry_mask) if with_members else None
    volumes = ImageVolumes.of(dataset.labels()) if with_volumes else None
    needed = len(dataset) * (reader.input_size**2 or math.prod(dataset.image_size)) * 3
    is_free = needed <= _HOST_SHARE * free_bytes(torch.device("cpu"))
    if not is_free:
        labels = _Labels(is_rejected, is_member, volumes)
        workers = reader.workers or min(cores(), _MAX_WORKERS)
        return Streamed(dataset, batch_size, seed, device, workers, reader.input_size, labels)
    fits_device = device.type == "cpu" or needed <= _DEVICE_SHARE * free_bytes(device)
    images = reader.read(dataset)._replace(is_rejected=is_rejected, is_member=is_member, volumes=volumes)
    return InMemory(images, batch_size, seed, device, on_device=fits_device)


def _rejected(dataset: Dataset) -> Tensor:
    """Return which candidates (N, G) are hard negatives, as `score` counts them."""
    return torch.from_numpy(dataset.labels().rejected_beyond(HARD_NEGATIVE_RAD))


def generator(device: torch.device | str, seed: int, epoch: int, purpose: str) -> torch.Generator:
    """Return a generator of random numbers of its own for each seed, epoch and purpose."""
    digest = hashlib.sha256(f"symsol-annot training 1/{seed}/{epoch}/{purpose}".encode()).digest()
    return torch.Generator(device).manual_seed(int.from_bytes(digest[:7], "little"))


_Numbered: TypeAlias = tuple[int, Sample]


class _Part(IterableDataset[_Numbered]):
    """What one worker reads in an epoch: rows of the dataset, with their samples."""

    def __init__(self, dataset: Dataset, seed: int, epoch: int) -> None:
        self._dataset, self._seed, self._epoch = dataset, seed, epoch

    def __iter__(self) -> Iterator[_Numbered]:
        worker = get_worker_info()
        part, parts = (worker.id, worker.num_workers) if worker else (0, 1)
        rows = map(int, shuffled_order(self._dataset, self._seed, self._epoch, part, parts))
        return ((row, self._dataset[row]) for row in rows)


def _collate(input_size: int, pairs: list[_Numbered]) -> tuple[Tensor, Tensor, Tensor]:
    rows, samples = zip(*pairs, strict=True)
    images = np.stack([sample.image for sample in samples])
    R_gt = np.stack([sample.rotation for sample in samples]).astype(np.float32)
    return torch.tensor(rows), reduced(torch.from_numpy(images), input_size), torch.from_numpy(R_gt)
