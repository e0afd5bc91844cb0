"""What views are compared by: the pixels of a small image, in which colour counts for more than shade."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError, SettingsError
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.machine import cores

COLOUR_WEIGHT = 6.0  # a marking is few pixels of another colour; shades tell of the whole body
MAX_SIZE = 64
_IMAGES_AT_ONCE = 64

Embeddings = npt.NDArray[np.float32]


def embed(images: npt.NDArray[np.uint8], size: int) -> Embeddings:
    """Return the embeddings (n, size, size, 3) of images (n, H, W, 3), with values of each channel from 0 to 1.

    Each pixel is the mean of the area that it covers; with g the mean of its channels c, its value is g + 6 (c - g).
    """
    rows = _window_means(images, size)
    means = _window_means(rows.swapaxes(1, 2), size).swapaxes(1, 2) / np.float32(255.0)
    grey = means.mean(axis=-1, keepdims=True)
    return grey + np.float32(COLOUR_WEIGHT) * (means - grey)


def embed_dataset(
    dataset: Dataset, size: int, on_images: Callable[[int], object] = int
) -> tuple[Embeddings, Rotations]:
    """Return the embeddings (N, size, size, 3) of a split's images and their rotations (N, 3, 3).

    They are read by as many threads as cores. The rotations of a sealed split are NaN.

    Args:
        dataset: whose images they are.
        size: of an embedding, in pixels.
        on_images: is told how many more images are done.

    Raises:
        DataError: an image is damaged, or images are not square, so that they cannot be turned.
        SettingsError: the size is more than an image has, or than 64.
    """
    width, height = dataset.image_size
    if width != height:
        raise DataError(f"{dataset.folder}: expected square images, which can be turned, found {width}x{height} pixels")
    if not 1 <= size <= min(width, MAX_SIZE):
        raise SettingsError(f"size: expected 1 to {min(width, MAX_SIZE)} for images of {width} pixels, found {size}")
    embeddings, R_gt = np.empty((len(dataset), size, size, 3), dtype=np.float32), np.empty((len(dataset), 3, 3))

    def read(start: int) -> None:
        rows = range(start, min(start + _IMAGES_AT_ONCE, len(dataset)))
        samples = [dataset[row] for row in rows]
        embeddings[start : rows.stop] = embed(np.stack([one.image for one in samples]), size)
        R_gt[start : rows.stop] = [one.rotation for one in samples]
        on_images(len(rows))

    with ThreadPoolExecutor(cores()) as pool:
        list(pool.map(read, range(0, len(dataset), _IMAGES_AT_ONCE)))
    return embeddings, R_gt


def _window_means(images: npt.NDArray[Any], size: int) -> Embeddings:
    """Return the means (n, size, ...) over `size` windows of axis 1; no threads of BLAS beside those that read."""
    side = images.shape[1]
    starts, ends = np.arange(size) * side // size, -(-np.arange(1, size + 1) * side // size)
    means = [images[:, a:b].sum(axis=1, dtype=np.float32) / (b - a) for a, b in zip(starts, ends, strict=True)]
    return np.stack(means, axis=1)
