"""Loading a set: shards as samples, with numpy and h5py alone.

test = symsol_annot.load("data/cylO", split="test")
sample = test[0]
sample.image, sample.symmetry_set
"""

import os
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self, overload

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError, NotAnnotatedError
from symsol_annot.manifest import SPLITS, Manifest, read_manifest
from symsol_annot.shards import HDF5_ERRORS, header_mismatches, open_shard_file
from symsol_annot.so3 import Rotations, turned

_MAX_OPEN_SHARDS = 8


@dataclass(frozen=True, eq=False)
class Sample:
    """One image and what is known of it.

    Attributes:
        index: within the split.
        image: (H, W, 3) u8 RGB.
        segmentation: (H, W) u8: 0 background, 1 body, 2 marking.
        rotation: (3, 3) f8, R_m2c, the rotation that the image was drawn at.
        marking_pixels: the marking's visible area in pixels; 0 without a marking.
        marking_visible: whether that is at least the object's tolerance; False without a marking.
        symmetry_mask: (G,) bool over `symmetry_group`, or None where the split has no symmetry sets.
        symmetry_group: (G, 3, 3) f8, the body's symmetries.
    """

    index: int
    image: npt.NDArray[np.uint8]
    segmentation: npt.NDArray[np.uint8]
    rotation: Rotations
    marking_pixels: float
    marking_visible: bool
    symmetry_mask: npt.NDArray[np.bool_] | None
    symmetry_group: Rotations

    @property
    def symmetry_set(self) -> Rotations:
        """All (k, 3, 3) rotations R_m2c that draw this image, `rotation` among them.

        Raises:
            NotAnnotatedError: the split was rendered without symmetry sets.
        """
        if self.symmetry_mask is None:
            raise NotAnnotatedError(
                f"image {self.index} has no symmetry set: its split was rendered without; "
                "`symsol-annot render --annotate all` gives every split its sets"
            )
        return self.rotation @ self.symmetry_group[self.symmetry_mask]


@dataclass(frozen=True, eq=False)
class Labels:
    """What is known of a split's N images, without the images.

    Attributes:
        rotation: (N, 3, 3) f8, R_m2c.
        symmetry_mask: (N, G) bool over `symmetry_group`.
        symmetry_group: (G, 3, 3) f8, the body's symmetries, identity first.
        marking_pixels: (N,) f4, the marking's visible area in pixels; 0 without a marking.
        marking_visible: (N,) bool, whether that is at least the object's tolerance.
    """

    rotation: Rotations
    symmetry_mask: npt.NDArray[np.bool_]
    symmetry_group: Rotations
    marking_pixels: npt.NDArray[np.float32]
    marking_visible: npt.NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.rotation)

    def symmetry_set(self, row: int) -> Rotations:
        """Return all (k, 3, 3) rotations R_m2c that draw image `row`."""
        return turned(self.rotation[row], self.symmetry_group[self.symmetry_mask[row]])


class Dataset(Sequence[Sample]):
    """A split of a set as a sequence of samples, read when asked for.

    Files are opened at first use, separately in each process, so that a dataset can be pickled and handed to
    worker processes, forked or spawned. A slice is a dataset over the same files.
    """

    def __init__(self, folder: Path, split: str, manifest: Manifest, rows: range | None = None) -> None:
        self.folder, self.split, self.manifest = folder, split, manifest
        self._entries = manifest.of_split(split)
        self._starts = [entry.first_index for entry in self._entries]
        self._rows = range(manifest.images(split)) if rows is None else rows
        self._open: OrderedDict[int, _OpenShard] = OrderedDict()
        self._owner = os.getpid()

    @property
    def object(self) -> str:
        """The object's name."""
        return str(self.manifest.recipe["object"])

    @property
    def is_annotated(self) -> bool:
        """Whether samples have symmetry sets."""
        return self.manifest.is_annotated(self.split)

    @property
    def has_marking(self) -> bool:
        """Whether the object has a marking."""
        return self.manifest.recipe["tolerance_px"] is not None

    @property
    def fingerprint(self) -> str:
        """The SHA-256 that names the split by its contents, whether or not it was rendered with the other split."""
        return str(self.manifest.split_fingerprint(self.split))

    @property
    def symmetry_group(self) -> Rotations:
        """The (G, 3, 3) symmetries of the object's body, identity first."""
        return self._shard(0).symmetry_group

    def labels(self) -> Labels:
        """Read the labels of all images at once, without the images.

        Raises:
            NotAnnotatedError: the split was rendered without symmetry sets.
            DataError: a shard is missing or damaged.
        """
        if not self.is_annotated:
            raise NotAnnotatedError(
                f"{self.folder}: the {self.split} split was rendered without symmetry sets; "
                "`symsol-annot render --annotate all` gives every split its sets"
            )
        rows = list(self._rows)
        columns = [self._labels_of(number) for number in range(len(self._entries))]
        rotation, mask, pixels, visible = (np.concatenate(column)[rows] for column in zip(*columns, strict=True))
        return Labels(rotation, mask, self.symmetry_group, pixels, visible)

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, item: int) -> Sample: ...

    @overload
    def __getitem__(self, item: slice) -> "Dataset": ...

    def __getitem__(self, item: int | slice) -> "Sample | Dataset":
        if isinstance(item, slice):
            return Dataset(self.folder, self.split, self.manifest, self._rows[item])
        try:
            index = self._rows[item]
        except IndexError:
            raise IndexError(f"index {item} is out of range: {self!r} has {len(self)} images") from None
        number = bisect_right(self._starts, index) - 1
        return self._shard(number).sample(index)

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        return f"<{self.object} {self.split}: {len(self)} images in {self.folder}>"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict()}

    def _labels_of(self, number: int) -> tuple[npt.NDArray[Any], ...]:
        shard = self._shard(number)
        if not np.array_equal(shard.symmetry_group, self.symmetry_group):
            raise DataError(f"{self.folder / self._entries[number].file}: its symmetry_group is not the first shard's")
        return self._shard(number).labels()

    def close(self) -> None:
        """Close the files; the next access opens them again."""
        while self._open:
            self._open.popitem()[1].close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _shard(self, number: int) -> "_OpenShard":
        if self._owner != os.getpid():  # an HDF5 handle must not cross a fork: drop it without closing
            self._open, self._owner = OrderedDict(), os.getpid()
        if number not in self._open:
            while len(self._open) >= _MAX_OPEN_SHARDS:
                self._open.popitem(last=False)[1].close()
            entry = self._entries[number]
            expected = self.manifest.expected_attributes(entry)
            self._open[number] = _OpenShard(self.folder / entry.file, entry.images, expected)
        self._open.move_to_end(number)
        return self._open[number]


class _OpenShard:
    """One open file and the small arrays of it that every sample needs."""

    def __init__(self, path: Path, images: int, expected: dict[str, Any]) -> None:
        self._file = open_shard_file(path)
        faults = header_mismatches(self._file, expected)
        if len(self._file["rotation"]) != images:
            faults.append(f"expected {images} images, found {len(self._file['rotation'])}")
        if faults:
            self._file.close()
            raise DataError(f"{path}: is no shard of this set:\n" + "\n".join(f"  - {fault}" for fault in faults))
        self._first_index = int(self._file.attrs["first_index"])
        self._tolerance_px = float(self._file.attrs["tolerance_px"])
        try:
            self.symmetry_group: Rotations = self._file["symmetry_group"][...]
        except HDF5_ERRORS as error:
            raise DataError(f"{path}: symmetry_group cannot be read: {error}") from None
        self.symmetry_group.setflags(write=False)  # all samples share it

    def sample(self, index: int) -> Sample:
        row = index - self._first_index
        try:
            pixels = float(self._file["marking_pixels"][row])
            mask = self._file["symmetry_mask"][row] if "symmetry_mask" in self._file else None
            return Sample(
                index=index,
                image=self._file["image"][row],
                segmentation=self._file["segmentation"][row],
                rotation=self._file["rotation"][row],
                marking_pixels=pixels,
                marking_visible=pixels >= self._tolerance_px,  # False where the tolerance is NaN: no marking
                symmetry_mask=mask,
                symmetry_group=self.symmetry_group,
            )
        except HDF5_ERRORS as error:
            raise DataError(
                f"{self._file.filename}: row {row} cannot be read: {error}. `symsol-annot verify` checks the whole set"
            ) from None

    def labels(self) -> tuple[npt.NDArray[Any], ...]:
        """Return rotation, symmetry_mask, marking_pixels and whether the marking shows, of all rows."""
        try:
            rotation, mask, pixels = (self._file[name][...] for name in ("rotation", "symmetry_mask", "marking_pixels"))
        except HDF5_ERRORS as error:
            raise DataError(f"{self._file.filename}: labels cannot be read: {error}") from None
        return rotation, mask, pixels, pixels >= self._tolerance_px

    def close(self) -> None:
        self._file.close()


def load(folder: str | os.PathLike[str], split: str = "test") -> Dataset:
    """Open a split of a set, like `load("data/cylO", split="test")`.

    Args:
        folder: the set's folder, which holds its manifest.json.
        split: "train" or "test".

    Raises:
        DataError: the folder holds no set, the split is not in it, or shards of it are missing.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    there = [name for name in SPLITS if manifest.images(name)]
    if split not in there:
        raise DataError(f"{path}: has no split {split!r}; it has {', '.join(there)}")
    entries = manifest.of_split(split)
    missing = [entry.file for entry in entries if not entry.is_finished or not (path / entry.file).is_file()]
    if missing:
        raise DataError(
            f"{path}: {len(missing)} of {len(entries)} {split} shards are missing, the first {missing[0]}; "
            "the same `symsol-annot render` command as before makes them"
        )
    return Dataset(path, split, manifest)
