"""Batches: images on a device, and what is known of them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import torch
from torch import Tensor

from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.machine import cores

_IMAGES_AT_ONCE = 64  # decoded by one thread in one go


class Batch(NamedTuple):
    """Images on a device, and what is known of them.

    Attributes:
        images: (B, H, W, 3) uint8.
        R_gt: (B, 3, 3) float32, R_m2c.
        is_rejected: (B, G) bool, which candidates R_gt g are hard negatives; None where nothing asks for them.
    """

    images: Tensor
    R_gt: Tensor
    is_rejected: Tensor | None = None

    def rows(self, chosen: Tensor | slice) -> "Batch":
        """Return some of its images, by their indices (b,)."""
        return self._each(lambda part: part[chosen])

    def to(self, device: torch.device) -> "Batch":
        """Return it on a device; from pinned memory the copy goes on while the network is at work."""
        return self._each(lambda part: part.to(device, non_blocking=True))

    def pinned(self) -> "Batch":
        """Return it in memory that a GPU reads by itself."""
        return self._each(Tensor.pin_memory)

    def _each(self, change: Callable[[Tensor], Tensor]) -> "Batch":
        is_rejected = None if self.is_rejected is None else change(self.is_rejected)
        return Batch(change(self.images), change(self.R_gt), is_rejected)


def decode_images(dataset: Dataset) -> Batch:
    """Return all images of a dataset and their rotations, on the CPU, read by as many threads as cores.

    Raises:
        DataError: an image is damaged.
    """
    width, height = dataset.image_size
    images = torch.empty((len(dataset), height, width, 3), dtype=torch.uint8)
    R_gt = torch.empty((len(dataset), 3, 3))

    def read(rows: range) -> None:
        for row in rows:
            sample = dataset[row]
            images[row], R_gt[row] = torch.from_numpy(sample.image), torch.from_numpy(sample.rotation)

    everything = range(len(dataset))
    parts = [everything[start : start + _IMAGES_AT_ONCE] for start in range(0, len(dataset), _IMAGES_AT_ONCE)]
    with ThreadPoolExecutor(cores()) as pool:
        list(pool.map(read, parts))
    return Batch(images, R_gt)
