"""Which rotations are inside the volumes of a batch's images, on the device that trains."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from symsol_annot.annotation.volume import TILTS, Volume, ring_edges
from symsol_annot.sets.shard.labels import Labels


@dataclass(frozen=True, eq=False)
class ImageVolumes:
    """The volumes of the sets of some images; like a tensor, it has rows and can be taken to a device.

    Attributes:
        index: (B,) int64, which of `volumes` each image's set has, -1 for none.
        volumes: the distinct ones.
    """

    index: Tensor
    volumes: tuple[Volume, ...]

    @classmethod
    def of(cls, labels: Labels) -> "ImageVolumes":
        """Return those of labels."""
        index = torch.full((len(labels),), -1) if labels.volume is None else torch.from_numpy(labels.volume).long()
        return cls(index, labels.volumes)

    def __getitem__(self, rows: Tensor | slice) -> "ImageVolumes":
        return ImageVolumes(self.index[rows], self.volumes)

    def to(self, device: torch.device, *, non_blocking: bool = False) -> "ImageVolumes":
        """Return them on a device."""
        return ImageVolumes(self.index.to(device, non_blocking=non_blocking), self.volumes)

    def pin_memory(self) -> "ImageVolumes":
        """Return them in memory that a GPU reads by itself."""
        return ImageVolumes(self.index.pin_memory(), self.volumes)

    def measures(self) -> Tensor:
        """Return the shares of SO(3) that the images' volumes have, (B,) float32, 0 for none."""
        return self.index.new_tensor([*(v.measure for v in self.volumes), 0.0], dtype=torch.float32)[self.index]

    def draw(self, count: int, rng: torch.Generator) -> Tensor:
        """Draw rotations (B, count, 3, 3), float32, uniformly from the volumes of images that all have one."""
        seed = int(torch.randint(2**62, (1,), generator=rng, device=rng.device))
        numbers, by_numpy = self.index.cpu().numpy(), np.random.default_rng(seed)
        R = np.empty((len(numbers), count, 3, 3))
        for number in np.unique(numbers):
            (rows,) = np.nonzero(numbers == number)
            R[rows] = self.volumes[number].sample(len(rows) * count, by_numpy).reshape(-1, count, 3, 3)
        return torch.from_numpy(R).float().to(self.index.device)

    def contain(self, R: Tensor) -> Tensor:
        """Tell which rotations (B, K, 3, 3) are inside the volume of their image's set, (B, K) bool.

        A rotation that float32 cannot tell from the edge of a volume may be on either side of it.
        """
        found = torch.zeros(R.shape[:2], dtype=torch.bool, device=R.device)
        for number, volume in enumerate(self.volumes):
            if volume.is_of_directions:
                inside = _of_directions(volume, R)
            else:
                inside = torch.from_numpy(volume.contains(R.double().cpu().numpy().reshape(-1, 3, 3))).to(R.device)
            found |= inside.reshape(found.shape) & (self.index == number)[:, None]
        return found


def _of_directions(volume: Volume, R: Tensor) -> Tensor:
    """Tell which rotations (B, K, 3, 3) see the object from a region of directions, (B, K) bool."""
    inside, edges = _table(volume, R.device)
    polar = torch.acos(R[..., 2, 2].clamp(-1.0, 1.0))
    ring = (torch.searchsorted(edges, polar.contiguous(), right=True) - 1).clamp(0, len(inside) - 1)
    tilt = (torch.atan2(R[..., 2, 1], -R[..., 2, 0]) * (TILTS / (2.0 * torch.pi))).round().long() % TILTS
    return inside[ring, tilt]


@lru_cache(maxsize=16)
def _table(volume: Volume, device: torch.device) -> tuple[Tensor, Tensor]:
    """Return which tilts of each ring are inside (127, 192), and the polar angles between the rings' bands (128,)."""
    edges: Sequence[float] = ring_edges().tolist()
    return torch.from_numpy(volume.rings.copy()).to(device), torch.tensor(edges, dtype=torch.float32, device=device)
