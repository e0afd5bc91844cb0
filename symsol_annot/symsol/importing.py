"""The original SYMSOL as sets of this package: its images and rotations, its symmetry sets where it has them.

The source lists m rotations per image and says nothing of their convention, of camera or marking. Its sets are taken as
R g with g of one group; that is checked for every image, and the group's duplicates are removed.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from importlib import metadata
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot import __version__
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.importing.set_writing import is_whole, manifest_there, place_of, write_set
from symsol_annot.rotations.so3 import Rotations, nearest_rotations, rotation_deviation
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.plan import division_into_shards
from symsol_annot.sets.shard.writer import ShardFile, ShardWriter, storage_versions
from symsol_annot.sets.stated.settings import ImportedSettings, Source
from symsol_annot.symsol.listed_groups import SAME_RAD, ListedGroup, listed_group
from symsol_annot.symsol.zip_reader import SymsolZip
from symsol_annot.system.locks import held_folder
from symsol_annot.system.progress import OnImages, ignore_images
from symsol_annot.system.text.names import SPLITS

MAX_OFF_SO3 = 1e-4
_IMAGES_FOR_GROUP = 64


@dataclass(frozen=True)
class ImportedSet:
    """An object's set after its import.

    Attributes:
        folder: of its set.
        manifest: of the set.
        members: |G|, the size of each symmetry set; None where the source gives none.
        off_so3: how far the source's rotations are from rotations at most; the nearest ones are stored.
        off_sets_rad: how far a listed rotation is from the member R g that stands for it, at most, in rad.
        was_there: whether the folder held it already, whole, so that nothing was written.
    """

    folder: Path
    manifest: Manifest
    members: int | None
    off_so3: float = np.nan
    off_sets_rad: float = np.nan
    was_there: bool = False


def import_symsol(
    path: Path,
    out: Path,
    objects: Iterable[str] = (),
    *,
    workers: int = 1,
    on_begin: Callable[[Manifest], object] = lambda _: None,
    on_images: OnImages = ignore_images,
) -> Iterator[ImportedSet]:
    """Import objects of the original SYMSOL one after the other; each appears in the folder once it is whole.

    Objects that are there already, from the same zip, are left as they are, unless a shard is missing or damaged: then
    the object's shards are made again, to the same bytes with the same software. The bytes do not depend on `workers`.

    Args:
        path: the zip.
        out: the folder of sets; nothing outside it is written.
        objects: which; all in the zip where none is named.
        workers: how many threads decode and compress.
        on_begin: told of each set before it is made.
        on_images: told how many more images are imported.

    Raises:
        DataError: the zip is damaged or not SYMSOL's; nothing is left of the object in question. Or the folder holds
            the object's set in an older format, to which nothing is added.
        DifferentSetError: the folder holds another set under an object's name.
        SettingsError: an object is not in the zip.
        OutputError: the folder cannot be written to, or a file in it is a link that leads out of it.
    """
    with SymsolZip(path) as source, held_folder(out):
        wanted = tuple(dict.fromkeys(objects)) or source.objects
        missing = [name for name in wanted if name not in source.objects]
        if missing:
            raise SettingsError(f"{path}: has no {', '.join(missing)}; it has {', '.join(source.objects)}")
        sha256 = source.sha256()
        for name in wanted:
            importer = _Importer(source, name, sha256)
            folder, manifest = out / name, importer.manifest
            members = len(importer.listed.group) if manifest.settings.annotate != "none" else None
            there = manifest_there(folder, manifest)
            if there and is_whole(folder, there):
                yield ImportedSet(folder, there, members, was_there=True)
                continue
            place_there = place_of(folder, manifest, is_there=there is not None)
            on_begin(manifest)
            with place_there as place:
                made = importer.write(place, workers, on_images)
                source.refuse_change()
            yield ImportedSet(folder, made, members, importer.off_so3, importer.off_sets_rad)


class _Importer:
    """One object: its manifest, then its shards."""

    def __init__(self, source: SymsolZip, name: str, sha256: str) -> None:
        self._source, self._name = source, name
        self.off_so3 = self.off_sets_rad = 0.0
        self.listed = _listed_group_of(source, name)
        annotate = _annotate(source, name)
        height, width, _ = source.image(name, SPLITS[0], 0).shape
        settings = ImportedSettings(
            object=name,
            width=width,
            height=height,
            annotate=annotate,
            source=Source(
                name="SYMSOL",
                sha256=sha256,
                convention="unknown",
                transposed=self.listed.is_transposed,
                rotations_listed=len(self.listed.element),
                duplicates_removed=self.listed.duplicates,
            ),
        )
        images = {split: source.header(name, split).images for split in SPLITS}
        self.manifest = Manifest(settings, division_into_shards(images, width * height))

    def write(self, folder: Path, workers: int, on_images: OnImages) -> Manifest:
        """Write all shards and the manifest, and return it."""
        shards = ((entry, partial(self._shard, entry, R)) for entry, R in self._rotations())
        return write_set(folder, self.manifest, shards, workers, on_images)

    def _rotations(self) -> Iterator[tuple[ShardEntry, Rotations]]:
        """Yield each shard with its images' own rotations (n, 3, 3), after checking their lists."""
        for split in SPLITS:
            with self._source.rotations(self._name, split) as table:
                for entry in self.manifest.of_split(split):
                    listed = table.read(entry.images)
                    own = listed[:, 0]
                    self._check_rotations(entry, own)
                    if listed.shape[1] > 1:
                        self._check_sets(entry, listed)
                    own = np.swapaxes(own, -1, -2) if self.listed.is_transposed else own
                    yield entry, nearest_rotations(own)

    def _check_rotations(self, entry: ShardEntry, R: Rotations) -> None:
        deviation = rotation_deviation(R)
        bad = ~(deviation <= MAX_OFF_SO3)
        if bad.any():
            row = int(np.argmax(bad))
            raise DataError(
                f"{self._what(entry.split)}: image {entry.first_index + row}: its rotation is none: off by "
                f"{deviation[row]:.3g} (allowed {MAX_OFF_SO3:g})"
            )
        self.off_so3 = max(self.off_so3, float(deviation.max()))

    def _check_sets(self, entry: ShardEntry, listed: Rotations) -> None:
        off = self.listed.off_rad(listed)
        if not (off <= SAME_RAD).all():
            row = int(np.argmax(~(off <= SAME_RAD)))
            raise DataError(
                f"{self._what(entry.split)}: image {entry.first_index + row}: its list is not R g with g of the "
                f"{len(self.listed.group)} symmetries that the object's first images have"
            )
        self.off_sets_rad = max(self.off_sets_rad, float(off.max()))

    def _shard(self, entry: ShardEntry, R: Rotations) -> ShardFile:
        group, is_annotated = self.listed.group, self.manifest.is_annotated(entry.split)
        mask = np.ones(len(group), dtype=bool) if is_annotated else None
        header = self.manifest.header(entry, _versions())
        with ShardWriter(header, entry.images, group, annotated=is_annotated) as writer:
            for row in range(entry.images):
                writer.add_imported(self._image(entry, row), R[row], mask)
            return writer.finish({})

    def _image(self, entry: ShardEntry, row: int) -> npt.NDArray[np.uint8]:
        index, (width, height) = entry.first_index + row, self.manifest.settings.image_size
        image = self._source.image(self._name, entry.split, index)
        expected = (height, width, 3)
        if image.shape != expected:
            name = f"{entry.split}/images/{self._name}_{index:05d}.png"
            raise DataError(f"{self._source.path}: {name}: is of shape {image.shape}, the object's first of {expected}")
        return image

    def _what(self, split: str) -> str:
        return f"{self._source.path}: {split}/rotations.npz: {self._name}"


def _listed_group_of(source: SymsolZip, name: str) -> ListedGroup:
    """Return an object's group. Where it lists one rotation an image, only whether to transpose, as others tell."""
    split = next((split for split in reversed(SPLITS) if source.header(name, split).listed > 1), None)
    if split is not None:
        with source.rotations(name, split) as table:
            listed = table.read(min(table.header.images, _IMAGES_FOR_GROUP))
        return listed_group(listed, f"{source.path}: {split}/rotations.npz: {name}")
    others = (other for other in source.objects if any(source.header(other, s).listed > 1 for s in SPLITS))
    other = next(others, None)
    is_transposed = other is not None and _listed_group_of(source, other).is_transposed
    return ListedGroup(np.eye(3)[None], np.zeros(1, dtype=np.intp), is_transposed)


def _annotate(source: SymsolZip, name: str) -> str:
    """Return which splits have symmetry sets, as a manifest says it: where several rotations are listed."""
    listed = {split: source.header(name, split).listed for split in SPLITS}
    if len(set(listed.values())) == 1:
        return "all" if listed["test"] > 1 else "none"
    if listed["train"] == 1:
        return "test"
    found = ", ".join(f"{number} in {split}" for split, number in listed.items())
    raise DataError(f"{source.path}: {name}: expected as many rotations per image in both splits, found {found}")


def _versions() -> dict[str, str]:
    return {"symsol-annot": __version__, **storage_versions(), "pillow": metadata.version("pillow")}
