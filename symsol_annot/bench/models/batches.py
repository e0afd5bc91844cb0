"""Batches: images on a device, and what is known of them."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import torch
from torch import Tensor
from torch.nn import functional

from symsol_annot.bench.models.volumes import ImageVolumes
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.machine import cores

_IMAGES_AT_ONCE = 64  # decoded by one thread in one go
_MOST_ROWS = 128  # of pixels whose sum is an int16


class Batch(NamedTuple):
    """Images on a device, and what is known of them.

    Attributes:
        images: (B, H, W, 3) uint8.
        R_gt: (B, 3, 3) float32, R_m2c.
        is_rejected: (B, G) bool, which candidates R_gt g are hard negatives; None where nothing asks for them.
        is_member: (B, G) bool, which candidates are in the symmetry set; None where nothing asks for them.
        volumes: of the symmetry sets; None where nothing asks for them.
    """

    images: Tensor
    R_gt: Tensor
    is_rejected: Tensor | None = None
    is_member: Tensor | None = None
    volumes: ImageVolumes | None = None

    def rows(self, chosen: Tensor | slice) -> "Batch":
        """Return some of its images, by their indices (b,)."""
        return self._each(lambda part: part[chosen])

    def to(self, device: torch.device) -> "Batch":
        """Return it on a device; from pinned memory the copy goes on while the network is at work."""
        return self._each(lambda part: part.to(device, non_blocking=True))

    def pinned(self) -> "Batch":
        """Return it in memory that a GPU reads by itself."""
        return self._each(lambda part: part.pin_memory())

    def _each(self, change: Callable[[Any], Any]) -> "Batch":
        return Batch(*(None if part is None else change(part) for part in self))  # type: ignore[arg-type]


def rolled(batch: Batch) -> Batch:
    """Return a batch turned about the camera's axis: its first quarter by 0 degrees, the next by 90, 180 and 270.

    The light stands on that axis, so a square image at R, turned by 90 degrees, is what is seen at Rz(90) R, to the
    last lattice point. The candidates R g of a turned image are the turned candidates, so what is said of them holds.
    """
    images, R_gt = list(batch.images.chunk(4)), list(batch.R_gt.chunk(4))
    quarter = R_gt[0].new_tensor([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    for turns in range(1, len(images)):
        images[turns] = torch.rot90(images[turns], -turns, (1, 2))
        R_gt[turns] = torch.linalg.matrix_power(quarter, turns) @ R_gt[turns]
    return batch._replace(images=torch.cat(images), R_gt=torch.cat(R_gt))


def reduced(images: Tensor, size: int) -> Tensor:
    """Return images (B, H, W, 3), uint8, with `size` pixels a side, each the mean of the area that it covers.

    Args:
        images: of any size.
        size: 0 for images as they are.
    """
    if not size or images.shape[1:3] == (size, size):
        return images
    (count, height, width, _), down, right = images.shape, *(side // size for side in images.shape[1:3])
    if height % size or width % size or down > _MOST_ROWS:
        means = functional.adaptive_avg_pool2d(images.permute(0, 3, 1, 2).float(), size)
        return means.round().to(torch.uint8).permute(0, 2, 3, 1).contiguous()
    rows = images.reshape(count, size, down, width * 3)  # whole areas: sums of integers are nine times as fast
    strips = rows[:, :, 0].to(torch.int16)
    for i in range(1, down):
        strips += rows[:, :, i]
    columns = strips.view(count, size, size, right, 3)
    sums = columns[:, :, :, 0].to(torch.int32)
    for i in range(1, right):
        sums += columns[:, :, :, i]
    return (sums / (down * right)).round().to(torch.uint8)


def decode_images(dataset: Dataset, size: int = 0, workers: int | None = None) -> Batch:
    """Return all images of a dataset and their rotations, on the CPU, read by several threads.

    Args:
        dataset: whose images they are.
        size: the side in pixels that they are `reduced` to; 0 for images as they are.
        workers: how many threads; as many as cores by default.

    Raises:
        DataError: an image is damaged.
    """
    width, height = (size, size) if size else dataset.image_size
    images = torch.empty((len(dataset), height, width, 3), dtype=torch.uint8)
    R_gt = torch.empty((len(dataset), 3, 3))

    def read(rows: range) -> None:
        samples = [dataset[row] for row in rows]
        images[rows.start : rows.stop] = reduced(torch.stack([torch.from_numpy(one.image) for one in samples]), size)
        R_gt[rows.start : rows.stop] = torch.stack([torch.from_numpy(one.rotation) for one in samples])

    everything = range(len(dataset))
    parts = [everything[start : start + _IMAGES_AT_ONCE] for start in range(0, len(dataset), _IMAGES_AT_ONCE)]
    with ThreadPoolExecutor(workers or cores()) as pool:
        list(pool.map(read, parts))
    return Batch(images, R_gt)
