"""A split of a set for torch's DataLoader.

train = SymsolDataset("data/cylO", split="train")
loader = DataLoader(train, batch_size=64, sampler=ShuffledShards(train, seed=0), num_workers=2)
for batch in loader:
    batch["image"], batch["rotation"]  # (B, 3, H, W) uint8, (B, 3, 3) float32
"""

import os
from collections.abc import Callable, Iterator
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import MissingExtraError, SettingsError
from symsol_annot.sets.dataset import Dataset, Sample, load
from symsol_annot.sets.epoch_order import shuffled_order

try:
    import torch
    from torch import Tensor
    from torch.utils.data import Dataset as TorchDataset
    from torch.utils.data import Sampler
except ModuleNotFoundError as error:
    raise MissingExtraError("symsol_annot.torch", str(error.name), "bench") from None

__all__ = ["ShuffledShards", "SymsolDataset", "padded_symmetry_sets"]

LAYOUTS = ("chw", "hwc")
Item: TypeAlias = dict[str, Any]


class SymsolDataset(TorchDataset[Item]):
    """A split of a set as a map from indices to dicts of tensors, which torch's own collate function stacks.

    An item holds:
        image: (3, H, W) uint8, or (H, W, 3); whatever `transform` makes of it.
        rotation: (3, 3), R_m2c, of `dtype`.
        index: within the split, int.
        symmetry_mask: (G,) bool over `symmetry_group`, in annotated splits.
        marking_pixels, marking_visible: float and bool, in rendered sets.
        volume: which of `Labels.volumes` belongs to the set besides, -1 for none; of objects whose sets can have one.
        part_pixels: (P,) float32, in rendered sets but for those of format version 1.
        segmentation: (H, W) uint8: 0 background, 1 body, 2 marking; where asked for.
        depth: (H, W) float32, as `Sample.depth`; where asked for.

    It can be pickled and handed to worker processes, forked or spawned.

    Attributes:
        samples: the `symsol_annot.Dataset` that it reads.
    """

    def __init__(
        self,
        source: Dataset | str | os.PathLike[str],
        split: str = "train",
        *,
        layout: str = "chw",
        dtype: torch.dtype = torch.float32,
        transform: Callable[[Tensor], Any] | None = None,
        segmentation: bool = False,
        depth: bool = False,
    ) -> None:
        """Open a split.

        Args:
            source: a set's folder, or what `symsol_annot.load` made of one, or a slice of that; `split` then means
                nothing.
            split: "train" or "test".
            layout: "chw", as torch's layers have images, or "hwc", as they are stored.
            dtype: of rotations, which are stored in float64.
            transform: applied to the image, like torchvision's. It may change colours; a turned or mirrored image would
                no longer be one of its rotation.
            segmentation: whether items hold it.
            depth: whether items hold it.

        Raises:
            SettingsError: an unknown layout, or a segmentation or a depth asked of a set that has none.
            DataError: the folder holds no such split, or shards of it are missing.
        """
        if layout not in LAYOUTS:
            raise SettingsError(f"layout: expected one of {', '.join(LAYOUTS)}, found {layout!r}")
        self.samples = source if isinstance(source, Dataset) else load(source, split)
        if segmentation and not self.samples.parts:
            why = "is sealed" if self.samples.manifest.is_sealed else "was imported"
            raise SettingsError(f"segmentation: {self.samples.folder} {why}, and has none")
        if depth and not self.samples.has_depth:
            raise SettingsError(
                f"depth: {self.samples.folder} has none; `symsol-annot render --depth` makes sets with it"
            )
        self._layout, self._dtype, self._transform = layout, dtype, transform
        self._segmentation, self._depth = segmentation, depth

    @property
    def symmetry_group(self) -> Tensor:
        """The (G, 3, 3) symmetries of the object's body, identity first, of the rotations' type."""
        return torch.tensor(self.samples.symmetry_group, dtype=self._dtype)

    @cached_property
    def _volumes(self) -> tuple[Volume, ...]:
        """The volumes that `volume` of an item points into: those of `Dataset.labels()`."""
        return self.samples.labels().volumes

    def __len__(self) -> int:
        return len(self.samples)

    def __repr__(self) -> str:
        width, height = self.samples.image_size
        asked = {"segmentation": self._segmentation, "depth": self._depth}
        maps = "".join(f", {name}" for name, is_asked in asked.items() if is_asked)
        return f"<SymsolDataset of {self.samples!r}: {width}x{height}, {self._layout}, {self._dtype}{maps}>"

    def __getitem__(self, index: int) -> Item:
        sample = self.samples[index]
        image = torch.from_numpy(sample.image)
        if self._layout == "chw":
            image = image.permute(2, 0, 1).contiguous()
        item = {
            "image": self._transform(image) if self._transform else image,
            "rotation": torch.from_numpy(sample.rotation).to(self._dtype),
            "index": sample.index,
        }
        return item | self._annotation(sample)

    def _annotation(self, sample: Sample) -> Item:
        item: Item = {}
        if sample.symmetry_mask is not None:
            item["symmetry_mask"] = torch.from_numpy(sample.symmetry_mask)
        if self.samples.has_volumes:
            item["volume"] = -1 if sample.volume is None else self._volumes.index(sample.volume)
        if sample.marking_visible is not None:
            item |= {"marking_pixels": sample.marking_pixels, "marking_visible": sample.marking_visible}
        if sample.part_pixels is not None:
            item["part_pixels"] = torch.from_numpy(sample.part_pixels)
        if self._segmentation:
            item["segmentation"] = torch.from_numpy(np.asarray(sample.segmentation))
        if self._depth:
            item["depth"] = torch.from_numpy(np.asarray(sample.depth))
        return item


class ShuffledShards(Sampler[int]):
    """The images of an epoch in the order of `symsol_annot.shuffled_order`, so that a reader opens each shard once.

    As with torch's DistributedSampler, `set_epoch` gives each epoch its order; but nothing is read twice to fill up.
    """

    def __init__(self, dataset: SymsolDataset, seed: int = 0, rank: int = 0, ranks: int = 1) -> None:
        """Take a rank's share of a dataset.

        Raises:
            SettingsError: a number is out of its range.
        """
        self._samples, self._seed, self._rank, self._ranks = dataset.samples, seed, rank, ranks
        self._epoch = 0
        self._length = len(self._order())

    def set_epoch(self, epoch: int) -> None:
        """Say which epoch, from 0, the next pass is; also where workers stay."""
        self._epoch = epoch

    def __len__(self) -> int:
        return self._length

    def __iter__(self) -> Iterator[int]:
        return iter(self._order())

    def _order(self) -> list[int]:
        rows: list[int] = shuffled_order(self._samples, self._seed, self._epoch, self._rank, self._ranks).tolist()
        return rows


def padded_symmetry_sets(rotation: Tensor, symmetry_mask: Tensor, symmetry_group: Tensor) -> tuple[Tensor, Tensor]:
    """Return the symmetry sets of a batch as one tensor; they differ in size, so the smaller ones are filled up.

    They are filled with the image's own rotation, a member of its set: a minimum over a set, like the distance to its
    nearest member, needs no mask.

    Args:
        rotation: (B, 3, 3) R_m2c.
        symmetry_mask: (B, G) bool.
        symmetry_group: (G, 3, 3), identity first, on any device.

    Returns:
        (B, K, 3, 3) rotations R_m2c, K the size of the largest set; and (B,) how many of each row are the set's. The
        set comes first, in the group's order.
    """
    sizes = symmetry_mask.sum(dim=1)
    order = torch.argsort(symmetry_mask.to(torch.uint8), dim=1, descending=True, stable=True)
    elements = order[:, : int(sizes.max())]
    is_member = torch.arange(elements.shape[1], device=elements.device) < sizes[:, None]
    elements = torch.where(is_member, elements, 0)
    return rotation[:, None] @ symmetry_group.to(rotation)[elements], sizes
