"""Loading a set: shards as samples, without Blender or torch.

test = symsol_annot.load("data/cylO", split="test")
sample = test[0]
sample.image, sample.symmetry_set
"""

import contextlib
import copy
import os
from bisect import bisect_right
from collections import OrderedDict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.symmetry_set import SymmetrySet
from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import DamageError, DataError, NotAnnotatedError
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.manifest import Manifest, read_manifest
from symsol_annot.sets.membership import checked_shard
from symsol_annot.sets.shard.chunks import ByteFile
from symsol_annot.sets.shard.labels import Labels
from symsol_annot.sets.shard.reader import Shard, ShardLabels
from symsol_annot.sets.words import sample_in_words, without_sets
from symsol_annot.system.closing import Closing
from symsol_annot.system.text.names import SPLITS, nearest

MAX_OPEN_SHARDS = 8


@dataclass(frozen=True, eq=False)
class Sample:
    """One image and what is known of it.

    Attributes:
        index: within the split.
        image: (H, W, 3) u8 RGB.
        segmentation: (H, W) u8: 0 background, 1 body, 2 marking, as `Dataset.parts` names them. None in an imported
            or a sealed set, which has none.
        rotation: (3, 3) f8, R_m2c, the rotation that the image was drawn at; NaN in a sealed set, which does not say.
        marking_pixels: the marking's visible area in pixels at R_m2c; or the largest area of the coset R_m2c H, where
            only that reaches the object's tolerance. 0 without a marking, NaN in an imported or a
            sealed set.
        marking_visible: whether that is at least the object's tolerance; False without a marking, None in an imported
            or a sealed set.
        symmetry_mask: (G,) bool over `symmetry_group`, or None where the split has no symmetry sets.
        symmetry_group: (G, 3, 3) f8, the body's symmetries.
        part_pixels: (P,) f4, the visible area in pixels of each of `Dataset.parts`; None in an imported or a sealed
            set, and in one of format version 1, which does not say.
        depth: (H, W) f4, how far along the camera's axis what is seen at each pixel's centre lies from the camera, in
            bounding-sphere radii, 0 at the background; None in a set without depth.
        volume: the part of SO(3) that the set fills beside its members; None where it fills none.
    """

    index: int
    image: npt.NDArray[np.uint8]
    segmentation: npt.NDArray[np.uint8] | None
    rotation: Rotations
    marking_pixels: float
    marking_visible: bool | None
    symmetry_mask: npt.NDArray[np.bool_] | None
    symmetry_group: Rotations
    part_pixels: npt.NDArray[np.float32] | None = None
    depth: npt.NDArray[np.float32] | None = None
    volume: Volume | None = None

    def __repr__(self) -> str:
        return sample_in_words(self)

    @property
    def is_annotated(self) -> bool:
        """Whether the sample has a symmetry set."""
        return self.symmetry_mask is not None

    @property
    def symmetry_set(self) -> SymmetrySet:
        """All rotations R_m2c that draw this image, `rotation` the first; usable as the array (k, 3, 3) f8 of them.

        Raises:
            NotAnnotatedError: the split has no symmetry sets.
        """
        if self.symmetry_mask is None:
            is_sealed = not np.isfinite(self.rotation).all()
            why = without_sets(is_imported=self.segmentation is None, is_sealed=is_sealed)
            raise NotAnnotatedError(f"image {self.index} has no symmetry set: its split {why}")
        return SymmetrySet(self.rotation, self.symmetry_group, self.symmetry_mask, self.volume)


class Dataset(Closing, Sequence[Sample]):
    """A split of a set as a sequence of samples, read when asked for.

    At its first use a shard is checked, its SHA-256 and the laws of its labels too, and its labels are read; after that
    only an image's picture, segmentation and depth are read and inflated.
    A dataset may be used by several threads at once, pickled, and handed to worker processes, forked or spawned. A
    slice is a dataset over the same files.
    """

    def __init__(self, folder: Path, split: str, manifest: Manifest, *, check: bool = True) -> None:
        self.folder, self.split, self.manifest, self._check = folder, split, manifest, check
        self._place = Path(os.path.abspath(folder))  # noqa: PTH100 - stays right in another working folder
        self._entries = manifest.of_split(split)
        self._starts = [entry.first_index for entry in self._entries]
        self._rows = range(manifest.images(split))
        self._shards: dict[int, _Shard] = {}
        self._open: OrderedDict[int, ByteFile] = OrderedDict()  # of those, the files used last

    @property
    def object(self) -> str:
        """The object's name."""
        return self.manifest.settings.object

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of every image, in pixels."""
        return self.manifest.settings.image_size

    @property
    def is_annotated(self) -> bool:
        """Whether samples have symmetry sets."""
        return self.manifest.is_annotated(self.split)

    @property
    def has_marking(self) -> bool:
        """Whether the object has a marking that images of this set are divided by; no imported set is."""
        return self.manifest.settings.has_marking

    @property
    def parts(self) -> tuple[str, ...]:
        """The names of the object's parts in the order of their ids, the first of id 1; none in an imported set."""
        return self.manifest.settings.parts

    @property
    def has_depth(self) -> bool:
        """Whether samples have depth."""
        return self.manifest.settings.has_depth

    @property
    def has_volumes(self) -> bool:
        """Whether sets of the object can fill a volume, so that `Labels.volume` is there; whether any does is open."""
        equality = getattr(self.manifest.settings, "equality", None)
        return self.is_annotated and equality is not None and bool(equality.has_all_rotations)

    @property
    def fingerprint(self) -> str:
        """The SHA-256 that names the split by its contents, whether or not it was rendered with the other split."""
        return str(self.manifest.split_fingerprint(self.split))

    @property
    def symmetry_group(self) -> Rotations:
        """The (G, 3, 3) symmetries of the object's body, identity first."""
        return self._opened(0)[0].symmetry_group

    def labels(self) -> Labels:
        """Read the labels of all images at once, without the images.

        Raises:
            NotAnnotatedError: the split has no symmetry sets.
            DataError: a shard is missing or damaged.
        """
        if not self.is_annotated:
            manifest = self.manifest
            why = without_sets(is_imported=manifest.is_imported, is_sealed=manifest.is_sealed)
            raise NotAnnotatedError(f"{self.folder}: the {self.split} split {why}")
        rows = list(self._rows)
        shards = [self._labels_of(number) for number in range(len(self._entries))]
        self._refuse_another_stabiliser(shards)
        volumes = self._with_common_volumes(shards)
        columns = {name: np.concatenate([shard[name] for shard in shards])[rows] for name in shards[0]}
        return Labels(symmetry_group=self.symmetry_group, volumes=volumes, **columns)

    @property
    def indices(self) -> npt.NDArray[np.int64]:
        """(n,) the index of each image within the split: 0 to n - 1, but for a slice."""
        return np.arange(self._rows.start, self._rows.stop, self._rows.step, dtype=np.int64)

    @property
    def is_whole(self) -> bool:
        """Whether these are all images of the split in their order, and no slice of them."""
        return self._rows == range(self.manifest.images(self.split))

    def shard_numbers(self) -> npt.NDArray[np.int64]:
        """Return the number (n,) of the shard that holds each image, counted within the split; no file is read."""
        return np.searchsorted(self._starts, self.indices, side="right").astype(np.int64) - 1

    def __len__(self) -> int:
        return len(self._rows)

    @overload
    def __getitem__(self, item: int) -> Sample: ...

    @overload
    def __getitem__(self, item: slice) -> "Dataset": ...

    def __getitem__(self, item: int | slice) -> "Sample | Dataset":
        if isinstance(item, slice):
            part = copy.copy(self)
            part.__dict__ |= {"_rows": self._rows[item], "_shards": {}, "_open": OrderedDict()}
            return part
        try:
            index = self._rows[item]
        except IndexError:
            raise IndexError(f"index {item} is out of range: {self!r} has {len(self)} images") from None
        number = bisect_right(self._starts, index) - 1
        shard, file = self._opened(number)
        return shard.sample(index, file)

    def __iter__(self) -> Iterator[Sample]:
        return (self[i] for i in range(len(self)))

    def __repr__(self) -> str:
        return f"<{self.object} {self.split}: {len(self)} images in {self.folder}>"

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_shards": {}, "_open": OrderedDict()}

    def _labels_of(self, number: int) -> dict[str, npt.NDArray[Any]]:
        shard, _ = self._opened(number)
        if not np.array_equal(shard.symmetry_group, self.symmetry_group):
            path = self.folder / self._entries[number].file
            raise DataError(f"{path}: its symmetry_group is not the first shard's")
        return shard.labels()

    def _refuse_another_stabiliser(self, shards: list[dict[str, npt.NDArray[Any]]]) -> None:
        """Refuse labels of shards whose images that show the marking have not the same set in all of them."""
        if getattr(self.manifest.settings, "equality", None) is not None:
            return  # images that show other parts have other sets
        sets = [shard["symmetry_mask"][shard["marking_visible"]] for shard in shards]
        showing = [number for number, found in enumerate(sets) if len(found)]
        for number in showing[1:]:
            if not np.array_equal(sets[number][0], sets[showing[0]][0]):
                path, first = self.folder / self._entries[number].file, self._entries[showing[0]].file
                raise DataError(f"{path}: the set of its images that show the marking is not that of {first}")

    def _with_common_volumes(self, shards: list[dict[str, npt.NDArray[Any]]]) -> tuple[Volume, ...]:
        """Return the volumes of all shards, each once, and make the arrays `volume` of these point into them."""
        common: list[Volume] = []
        for number, shard in enumerate(shards):
            own = self._opened(number)[0].volumes
            common += [volume for volume in own if volume not in common]
            if "volume" in shard:
                places = np.array([*(common.index(volume) for volume in own), -1], np.int32)
                shard["volume"] = places[shard["volume"]]
        return tuple(common)

    def close(self) -> None:
        """Close the files; the next access opens them again."""
        self._open.clear()
        self._shards.clear()

    def _opened(self, number: int) -> "tuple[_Shard, ByteFile]":
        """Return a shard and its open file; whatever other threads do meanwhile, both are good to read from."""
        shard, file = self._shards.get(number), self._open.pop(number, None)
        if shard is None:
            shard, file = self._opened_first(number)
        if file is None:
            file = shard.open()
        while len(self._open) >= MAX_OPEN_SHARDS:
            with contextlib.suppress(KeyError):  # another thread was faster
                self._open.popitem(last=False)
        self._open[number] = file
        return shard, file

    def _opened_first(self, number: int) -> "tuple[_Shard, ByteFile]":
        """Check a shard, and return it with the file that was checked."""
        entry = self._entries[number]
        opened, labels = checked_shard(self._place, self.manifest, entry, check=self._check)
        shard = self._shards[number] = _Shard(opened, labels, entry.first_index)
        return shard, opened.file


class _Shard:
    """What is known of a shard that was checked: its labels, and where its images lie."""

    def __init__(self, shard: Shard, labels: ShardLabels, first_index: int) -> None:
        self._path, self._identity, self._first_index = shard.path, shard.file.identity, first_index
        self._tolerance_px = shard.tolerance_px
        self._image, self._segmentation, self._depth = shard.image, shard.segmentation, shard.depth
        self._mask, self._part_pixels = labels.symmetry_mask, labels.part_pixels
        self._volume, self.volumes = labels.volume, labels.volumes
        sealed = np.full((len(shard), 3, 3), np.nan)
        self._rotation = sealed if labels.rotation is None else labels.rotation
        unknown = np.full(len(shard), np.nan, dtype=np.float32)
        self._pixels = unknown if labels.marking_pixels is None else labels.marking_pixels
        self.symmetry_group = labels.symmetry_group
        self.symmetry_group.setflags(write=False)  # all samples share it

    def open(self) -> ByteFile:
        """Open the file, which has to be the one that was checked."""
        try:
            file = ByteFile(self._path)
        except OSError as error:
            raise DataError(f"{self._path}: cannot be opened again: {error.strerror}") from None
        if file.identity != self._identity:
            raise DataError(f"{self._path}: was replaced after it was opened; load the set again")
        return file

    def sample(self, index: int, file: ByteFile) -> Sample:
        row = index - self._first_index
        pixels, has_areas = float(self._pixels[row]), self._segmentation is not None
        try:
            return Sample(
                index=index,
                image=self._image.row(row, file),
                segmentation=None if self._segmentation is None else self._segmentation.row(row, file),
                rotation=self._rotation[row].copy(),
                marking_pixels=pixels,
                marking_visible=pixels >= self._tolerance_px if has_areas else None,  # False where that is NaN
                symmetry_mask=None if self._mask is None else self._mask[row].copy(),
                symmetry_group=self.symmetry_group,
                part_pixels=None if self._part_pixels is None else self._part_pixels[row].copy(),
                depth=None if self._depth is None else self._depth.row(row, file),
                volume=None if self._volume is None or self._volume[row] < 0 else self.volumes[self._volume[row]],
            )
        except DamageError as error:
            raise DataError(f"{self._path}: {error}. `symsol-annot verify` checks the whole set") from None

    def labels(self) -> dict[str, npt.NDArray[Any]]:
        """Return the arrays of `Labels` over all rows, by name."""
        if self._mask is None:
            raise DataError(f"{self._path}: labels cannot be read: it has no symmetry_mask")
        columns = {
            "rotation": self._rotation,
            "symmetry_mask": self._mask,
            "marking_pixels": self._pixels,
            "marking_visible": self._pixels >= self._tolerance_px,
        }
        optional = {"part_pixels": self._part_pixels, "volume": self._volume}
        return columns | {name: values for name, values in optional.items() if values is not None}


def load(folder: str | os.PathLike[str], split: str = "test", *, check: bool = True) -> Dataset:
    """Open a split of a set, like `load("data/cylO", split="test")`.

    Args:
        folder: the set's folder, which holds its manifest.json; a relative path is one of the present working folder.
        split: "train" or "test".
        check: whether a shard's size and SHA-256 are compared with the manifest's at its first use, which reads all of
            it once. For a huge set that `symsol-annot verify` has checked, `check=False` leaves that out; structure and
            labels are checked nonetheless, and each image that is read against gzip's adler32.

    Raises:
        DataError: the folder holds no set, the split is not in it, or shards of it are missing.
    """
    path = Path(folder)
    manifest = read_manifest(path)
    there = [name for name in SPLITS if manifest.images(name)]
    if split not in there:
        raise DataError(f"{path}: has no split {split!r}; it has {', '.join(there)}{nearest(str(split), there)}")
    entries = manifest.of_split(split)
    missing = [entry.file for entry in entries if not entry.is_finished or not (path / entry.file).is_file()]
    if missing:
        command = manifest.imported.source.command if manifest.is_imported else "render"
        remedy = f"the same `symsol-annot {command}` command makes them"
        raise DataError(
            f"{path}: {len(missing)} of {len(entries)} {split} shards are missing, the first {missing[0]}; "
            f"{'fetch them again' if manifest.is_sealed else remedy}"
        )
    return Dataset(path, split, manifest, check=check)
