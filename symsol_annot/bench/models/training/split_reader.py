"""Reading a split's images: decoded by threads, and those that a recipe reduces kept for the next training."""

import hashlib
import json
import math
import re
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.batches import Batch, decode_images
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.cache import Cache

_WAY_OF_REDUCING = 1  # a new number where `reduced` gives other bytes, so that none of before are taken
_FINGERPRINT = re.compile(r"[0-9a-f]{64}")
_ROTATION_BYTES = 9 * 4


@dataclass(frozen=True)
class SplitReader:
    """Reads images as a recipe wants them.

    Attributes:
        input_size: the side in pixels that images are reduced to, by area averages; 0 leaves them as they are.
        workers: how many threads decode, or processes where memory is too small; None for as many as cores.
        cache: keeps images that were reduced; None keeps none.
    """

    input_size: int = 0
    workers: int | None = None
    cache: Cache | None = None

    def read(self, dataset: Dataset) -> Batch:
        """Return all images of a dataset and their rotations, on the CPU.

        Raises:
            DataError: an image is damaged.
        """
        size = self.input_size
        is_reduced = size and (size, size) != dataset.image_size
        if self.cache is None or not is_reduced or not _FINGERPRINT.fullmatch(dataset.fingerprint):
            return decode_images(dataset, size, self.workers)
        key = _key(dataset, size)
        shape = (len(dataset), size, size, 3)
        found = self.cache.get(key)
        if found is not None and len(found) == math.prod(shape) + len(dataset) * _ROTATION_BYTES:
            images = torch.frombuffer(found, dtype=torch.uint8, count=math.prod(shape)).view(shape)
            R_gt = torch.frombuffer(found[math.prod(shape) :], dtype=torch.float32).view(-1, 3, 3)
            return Batch(images, R_gt)
        batch = decode_images(dataset, size, self.workers)
        self.cache.put(key, *(_bytes_of(part) for part in (batch.images, batch.R_gt)))
        return batch


def _key(dataset: Dataset, size: int) -> str:
    """Return the SHA-256 of all that reduced images follow from."""
    which = hashlib.sha256(dataset.indices.astype("<i8").tobytes()).hexdigest()
    named = ["reduced images", _WAY_OF_REDUCING, dataset.fingerprint, which, size]
    return hashlib.sha256(json.dumps(named).encode()).hexdigest()


def _bytes_of(tensor: Tensor) -> memoryview:
    return tensor.numpy().reshape(-1).view(np.uint8).data
