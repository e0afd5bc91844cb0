"""Instances of an object in a BOP dataset as a set of this package, one image each, seen by a camera turned to it.

With R_c the turn of the camera, x_c = R_m2c x_m + t becomes R_c x_c = (R_c R_m2c) x_m + R_c t, so that the label is
R_c R_m2c, and the object's centre lies on the camera's axis.
"""

import hashlib
import re
import stat
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from importlib import metadata
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot import __version__
from symsol_annot.bop.reading.instances import Found, Instance, read_instances
from symsol_annot.bop.reading.json_files import MAX_ID
from symsol_annot.bop.reading.model_info import ModelInfo, read_model_info
from symsol_annot.bop.turned_views import picture_of, view_of
from symsol_annot.errors import DataError, SettingsError
from symsol_annot.importing.pictures import MAX_PHOTO_BYTES, decoded_photo
from symsol_annot.importing.reading_errors import as_data_error
from symsol_annot.importing.set_writing import is_whole, manifest_there, place_of, write_set
from symsol_annot.rendering.camera import DEFAULT_SIZE, SIZE_RANGE
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.plan import division_into_shards
from symsol_annot.sets.shard.writer import ShardFile, ShardWriter, storage_versions
from symsol_annot.sets.stated.settings import BOP_SOURCE, ImportedSettings, Source
from symsol_annot.system.locks import held_folder
from symsol_annot.system.progress import OnImages, ignore_images
from symsol_annot.system.reading import file_sha256, read_bytes
from symsol_annot.system.text.names import OBJECT_NAME_RULE, is_object_name

LEAST_VISIBLE = 0.1
CONVENTION = "OpenCV: R_m2c of the camera, turned about its centre to the object's"
_SPLIT_FOLDER = re.compile(r"(train|val|test)(_[A-Za-z0-9_]{1,40})?")


@dataclass(frozen=True)
class ImportedObject:
    """A set after its import.

    Attributes:
        folder: of the set.
        manifest: of the set.
        split: of the set: "train" or "test".
        members: |G|, the size of each symmetry set.
        hidden: how many instances were left out, since too little of them is visible.
        off_so3: how far a pose in the files is from a rotation at most; the nearest ones are stored.
        was_there: whether the folder held it already, whole, so that nothing was written.
    """

    folder: Path
    manifest: Manifest
    split: str
    members: int
    hidden: int
    off_so3: float
    was_there: bool = False


@dataclass(frozen=True)
class Choice:
    """Which images of a BOP dataset are imported, and how.

    Attributes:
        obj_id: the object's id.
        split: the name of the folder of scenes, like "test" or "train_pbr"; one of "val" becomes a test split.
        name: of the object, and of its set's folder; obj_000005 for the id 5 where it is "".
        size: width and height of the set's images, in pixels.
        least_visible: the least visib_fract of an instance that is imported.
        diameter_mm: of the object, where neither models_info.json nor its model says it.

    Raises:
        SettingsError: one of them makes no sense.
    """

    obj_id: int
    split: str = "test"
    name: str = ""
    size: int = DEFAULT_SIZE
    least_visible: float = LEAST_VISIBLE
    diameter_mm: float | None = None

    def __post_init__(self) -> None:
        """Give the object its name, and refuse what makes no sense."""
        object.__setattr__(self, "name", self.name or f"obj_{self.obj_id:06d}")
        low, high = SIZE_RANGE
        for what, is_right, expected, found in (
            ("name", is_object_name(self.name), OBJECT_NAME_RULE, self.name[:80]),
            ("id", 0 <= self.obj_id <= MAX_ID, f"0 to {MAX_ID}", self.obj_id),
            ("split", _SPLIT_FOLDER.fullmatch(self.split), "train, val or test, or like train_pbr", self.split[:80]),
            ("size", low <= self.size <= high, f"{low} to {high} pixels", self.size),
            ("least visible", 0.0 <= self.least_visible <= 1.0, "a part from 0 to 1", self.least_visible),
        ):
            if not is_right:
                raise SettingsError(f"{what}: expected {expected}, found {found!r}")

    @property
    def set_split(self) -> str:
        """The split of the set: "train" or "test"."""
        return "train" if self.split.startswith("train") else "test"


def import_bop(
    path: Path,
    out: Path,
    choice: Choice,
    *,
    workers: int = 1,
    on_begin: Callable[[Manifest], object] = lambda _: None,
    on_images: OnImages = ignore_images,
) -> ImportedObject:
    """Import the images that show an object of a BOP dataset; the set appears in the folder once it is whole.

    A set that is there already, from the same files, is left as it is, unless a shard is missing or damaged: then its
    shards are made again, to the same bytes with the same software. The bytes do not depend on `workers`.

    Args:
        path: the dataset's folder.
        out: the folder of sets; nothing outside it is written.
        choice: which images.
        workers: how many threads decode and compress.
        on_begin: told of the set before it is made.
        on_images: told how many more images are imported.

    Raises:
        DataError: the dataset is damaged or none; nothing is left. Or the folder holds the set in an older format.
        DifferentSetError: the folder holds another set under the name.
        SettingsError: no image shows the object, or nobody says its diameter.
        OutputError: the folder cannot be written to, or a file in it is a link that leads out of it.
    """
    _refuse_no_folder(path)
    found = read_instances(path, choice.split, choice.obj_id, choice.least_visible)
    model = read_model_info(path, choice.obj_id, choice.diameter_mm)
    with held_folder(out):
        sha256 = _sha256_of_pictures(found.instances, workers)
        manifest = _manifest(choice, model, found, _sha256_of(path, model, found, sha256))
        folder, off_so3 = out / choice.name, max(instance.off_so3 for instance in found.instances)
        made = ImportedObject(folder, manifest, choice.set_split, len(model.group), found.hidden, off_so3)
        there = manifest_there(folder, manifest)
        if there and is_whole(folder, there):
            return replace(made, manifest=there, was_there=True)
        place_there = place_of(folder, manifest, is_there=there is not None)
        on_begin(manifest)
        maker = _ShardMaker(manifest, model, found.instances, sha256)
        with place_there as place:
            shards = ((entry, partial(maker.shard, entry)) for entry in manifest.shards)
            return replace(made, manifest=write_set(place, manifest, shards, workers, on_images))


def _manifest(choice: Choice, model: ModelInfo, found: Found, sha256: str) -> Manifest:
    """Return the manifest of the set before its first shard is written."""
    source = Source(
        name=f"{BOP_SOURCE}: object {choice.obj_id} of {choice.split}, visible from {choice.least_visible:g}",
        sha256=sha256,
        convention=CONVENTION,
        transposed=False,
        rotations_listed=len(model.group),
        duplicates_removed=0,
    )
    settings = ImportedSettings(
        object=choice.name, width=choice.size, height=choice.size, annotate="all", source=source
    )
    return Manifest(settings, division_into_shards({choice.set_split: len(found.instances)}, choice.size**2))


class _ShardMaker:
    """Makes the shards of an object; any thread may ask."""

    def __init__(
        self, manifest: Manifest, model: ModelInfo, instances: Sequence[Instance], sha256: dict[Path, str]
    ) -> None:
        self._manifest, self._model, self._instances, self._sha256 = manifest, model, instances, sha256

    def shard(self, entry: ShardEntry) -> ShardFile:
        """Return a shard.

        Raises:
            DataError: a picture is damaged or was changed, or shows an object that is behind the camera.
        """
        group = self._model.group
        with ShardWriter(self._manifest.header(entry, _versions()), entry.images, group, annotated=True) as writer:
            for image, R in self._images(self._instances[entry.first_index : entry.first_index + entry.images]):
                writer.add_imported(image, R, np.ones(len(group), dtype=bool))
            return writer.finish({})

    def _images(self, instances: Sequence[Instance]) -> Iterator[tuple[npt.NDArray[np.uint8], Rotations]]:
        """Yield each instance's image and label; a picture of several instances is decoded once."""
        for path, of_picture in groupby(instances, key=lambda instance: instance.picture):
            before = self._picture(path)
            for instance in of_picture:
                model, size = self._model, self._manifest.settings.image_size[0]
                centre_mm = instance.R_m2c @ model.centre_mm + instance.t_m2c_mm
                view = view_of(centre_mm, model.radius_mm, instance.K, size, instance.name)
                yield picture_of(view, before), view.turn @ instance.R_m2c

    def _picture(self, path: Path) -> npt.NDArray[np.uint8]:
        with as_data_error(str(path)):
            data = read_bytes(path, MAX_PHOTO_BYTES)
            if hashlib.sha256(data).hexdigest() != self._sha256[path]:
                raise ValueError("was changed while it was read; run the same command once it is whole")
            return decoded_photo(data)


def _refuse_no_folder(path: Path) -> None:
    try:
        is_folder = stat.S_ISDIR(path.stat().st_mode)
        found = "is a file"
    except OSError as error:
        is_folder, found = False, error.strerror or str(error)
    if not is_folder:
        raise DataError(f"{path}: {found}; expected the folder of a BOP dataset, with models, test or train in it")


def _sha256_of_pictures(instances: Sequence[Instance], workers: int) -> dict[Path, str]:
    """Return the SHA-256 of each picture.

    Raises:
        DataError: one cannot be read, or is larger than a picture may be.
    """
    paths = list(dict.fromkeys(instance.picture for instance in instances))

    def sha256(path: Path) -> str:
        with as_data_error(str(path)):
            return file_sha256(path, MAX_PHOTO_BYTES)

    with ThreadPoolExecutor(workers, thread_name_prefix="import") as pool:
        return dict(zip(paths, pool.map(sha256, paths), strict=True))


def _sha256_of(root: Path, model: ModelInfo, found: Found, pictures: dict[Path, str]) -> str:
    """Return the SHA-256 of a list of all that was read, a line per file as `sha256sum` writes it, and the radius."""
    digests = {**{file.path: file.sha256 for file in (*model.files, *found.files)}, **pictures}
    lines = sorted(f"{sha256}  {path.relative_to(root).as_posix()}\n" for path, sha256 in digests.items())
    return hashlib.sha256("".join([*lines, f"{model.radius_mm!r}\n"]).encode()).hexdigest()


def _versions() -> dict[str, str]:
    return {"symsol-annot": __version__, **storage_versions(), "pillow": metadata.version("pillow")}
