"""A split's images and rotations in batches on a device: from memory where they fit, else from worker processes.

The order of an epoch follows from seed and epoch alone, so that training goes on after any epoch as if it had never
stopped. An epoch's last images, if fewer than a batch, are left out: every step then has the same shape.
"""

import hashlib
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import Protocol, TypeAlias

import numpy as np
import torch
from torch import Tensor
from torch.utils.data import DataLoader, IterableDataset, get_worker_info

from symsol_annot.bench.devices import cores, free_bytes
from symsol_annot.dataset import Dataset, Sample
from symsol_annot.order import shuffled_order

Batch: TypeAlias = tuple[Tensor, Tensor]

_DEVICE_SHARE, _HOST_SHARE = 0.5, 0.6  # of free memory that images may take; a network needs the rest
_MAX_WORKERS = 8
_IMAGES_AT_ONCE = 64  # decoded by one thread in one go


class TrainingData(Protocol):
    """Batches of images (B, H, W, 3) uint8 and rotations (B, 3, 3) float32, on a device.

    Attributes:
        where: the images are, in words.
        batch: how many a batch has.
    """

    where: str
    batch: int

    def batches(self, epoch: int) -> Iterator[Batch]:
        """Return the batches of an epoch, in its order."""

    def batches_an_epoch(self) -> int:
        """Return how many batches an epoch has."""


class InMemory:
    """All images decoded: in the device's memory, or in the host's, pinned for a GPU."""

    def __init__(self, dataset: Dataset, batch: int, seed: int, device: torch.device, *, on_device: bool) -> None:
        self.images, self.R_gt = decoded(dataset)
        self.batch, self._seed, self._device = min(batch, len(dataset)), seed, device
        self._has_to_move = device.type != "cpu" and not on_device
        if on_device:
            self.images, self.R_gt = self.images.to(device), self.R_gt.to(device)
        self.where = "GPU memory" if on_device and device.type != "cpu" else "memory"

    def batches(self, epoch: int) -> Iterator[Batch]:
        """Return the batches of an epoch, shuffled over all images."""
        order = torch.randperm(len(self.images), generator=generator("cpu", self._seed, epoch, "order"))
        for rows in torch.split(order[: self.batches_an_epoch() * self.batch], self.batch):
            there = rows.to(self.images.device)
            images, R_gt = self.images[there], self.R_gt[there]
            if self._has_to_move:  # from pinned memory the copy goes on while the network is at work
                images, R_gt = (part.pin_memory().to(self._device, non_blocking=True) for part in (images, R_gt))
            yield images, R_gt

    def batches_an_epoch(self) -> int:
        """Return how many batches an epoch has."""
        return len(self.images) // self.batch


class Streamed:
    """Images read by worker processes, each a part of `shuffled_order`."""

    where = "worker processes"

    def __init__(self, dataset: Dataset, batch: int, seed: int, device: torch.device, workers: int) -> None:
        self._dataset, self._seed, self._device = dataset, seed, device
        self._workers = max(1, min(workers, len(dataset) // batch))
        self.batch = min(batch, len(dataset))

    def batches(self, epoch: int) -> Iterator[Batch]:
        """Return the batches of an epoch, a worker's one after the other's."""
        loader = DataLoader(
            _Part(self._dataset, self._seed, epoch),
            batch_size=self.batch,
            drop_last=True,
            num_workers=self._workers,
            collate_fn=_collate,
            pin_memory=self._device.type == "cuda",
            multiprocessing_context="spawn",  # a fork may inherit locks that torch's threads hold
        )
        for images, R_gt in loader:
            yield images.to(self._device, non_blocking=True), R_gt.to(self._device, non_blocking=True)

    def batches_an_epoch(self) -> int:
        """Return how many batches an epoch has: whole ones of each worker's part."""
        n, parts = len(self._dataset), self._workers
        return sum((n * (part + 1) // parts - n * part // parts) // self.batch for part in range(parts))


def training_data(dataset: Dataset, batch: int, seed: int, device: torch.device) -> TrainingData:
    """Return a split's batches from the nearest memory that holds its images; else from worker processes."""
    camera = dataset.manifest.recipe["camera"]
    needed = len(dataset) * camera["width"] * camera["height"] * 3
    is_free = needed <= _HOST_SHARE * free_bytes(torch.device("cpu"))
    if is_free and (device.type == "cpu" or needed <= _DEVICE_SHARE * free_bytes(device)):
        return InMemory(dataset, batch, seed, device, on_device=True)
    if is_free:
        return InMemory(dataset, batch, seed, device, on_device=False)
    return Streamed(dataset, batch, seed, device, min(cores(), _MAX_WORKERS))


def decoded(dataset: Dataset) -> Batch:
    """Return all images (N, H, W, 3) uint8 and rotations (N, 3, 3) float32, read by as many threads as cores.

    Raises:
        DataError: an image is damaged.
    """
    camera = dataset.manifest.recipe["camera"]
    images = torch.empty((len(dataset), camera["height"], camera["width"], 3), dtype=torch.uint8)
    R_gt = torch.empty((len(dataset), 3, 3))

    def read(rows: range) -> None:
        for row in rows:
            sample = dataset[row]
            images[row], R_gt[row] = torch.from_numpy(sample.image), torch.from_numpy(sample.rotation)

    everything = range(len(dataset))
    parts = [everything[start : start + _IMAGES_AT_ONCE] for start in range(0, len(dataset), _IMAGES_AT_ONCE)]
    with ThreadPoolExecutor(cores()) as pool:
        list(pool.map(read, parts))
    return images, R_gt


def generator(device: torch.device | str, seed: int, epoch: int, purpose: str) -> torch.Generator:
    """Return a stream of random numbers of its own for each epoch and purpose."""
    digest = hashlib.sha256(f"symsol-annot training 1/{seed}/{epoch}/{purpose}".encode()).digest()
    return torch.Generator(device).manual_seed(int.from_bytes(digest[:7], "little"))


class _Part(IterableDataset[Sample]):
    """What one worker reads in an epoch."""

    def __init__(self, dataset: Dataset, seed: int, epoch: int) -> None:
        self._dataset, self._seed, self._epoch = dataset, seed, epoch

    def __iter__(self) -> Iterator[Sample]:
        worker = get_worker_info()
        part, parts = (worker.id, worker.num_workers) if worker else (0, 1)
        return (self._dataset[int(row)] for row in shuffled_order(self._dataset, self._seed, self._epoch, part, parts))


def _collate(samples: list[Sample]) -> Batch:
    images = np.stack([sample.image for sample in samples])
    R_gt = np.stack([sample.rotation for sample in samples]).astype(np.float32)
    return torch.from_numpy(images), torch.from_numpy(R_gt)
