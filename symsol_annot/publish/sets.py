"""Which sets a folder holds, and whether they may be published."""

from dataclasses import dataclass
from pathlib import Path

from symsol_annot.archives.archive import ARCHIVE_ENDING, MAX_NAME, is_set_name
from symsol_annot.archives.digest_files import DIGEST_ENDING
from symsol_annot.errors import DataError, bulleted
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import MANIFEST_NAME, Manifest, ShardEntry, read_manifest
from symsol_annot.system.text.names import SPLITS

GROUPS_CONFIG = "symmetry_groups"  # beside the sets in the Parquet mirror


@dataclass(frozen=True)
class PublishedSet:
    """A set that is to be published.

    Attributes:
        name: its folder's; the name of its folder and its configuration in the bundle.
        folder: where it is.
        manifest: what it consists of.
    """

    name: str
    folder: Path
    manifest: Manifest

    @property
    def splits(self) -> tuple[str, ...]:
        """The splits that it has."""
        return tuple(split for split in SPLITS if self.manifest.images(split))

    @property
    def fills_volumes(self) -> bool:
        """Whether sets of the images can fill a volume, so that each image's labels say which."""
        return self.has_all_rotations and any(self.manifest.settings.is_annotated(split) for split in self.splits)

    @property
    def has_all_rotations(self) -> bool:
        """Whether the object's body has all of SO(3) as its group."""
        equality = getattr(self.manifest.settings, "equality", None)
        return equality is not None and bool(equality.has_all_rotations)

    def shard_name(self, entry: ShardEntry) -> str:
        """Return the name of a shard in the bundle."""
        return f"data/{self.name}/{entry.file}"

    def parquet_name(self, entry: ShardEntry) -> str:
        """Return the name of the same shard as Parquet."""
        return f"parquet/{self.name}/{entry.file.removesuffix('.h5')}.parquet"

    def webdataset_name(self, file: str) -> str:
        """Return the name in the bundle of a file of the WebDataset mirror, which has one per shard."""
        return f"webdataset/{self.name}/{file.replace('.h5', '.tar')}"

    @property
    def archive_name(self) -> str:
        """The name in the bundle of the archive with the whole set, which `symsol-annot fetch` puts in place."""
        return f"archives/{self.name}{ARCHIVE_ENDING}"

    @property
    def digest_name(self) -> str:
        """The name in the bundle of the file with the archive's SHA-256."""
        return f"{self.archive_name}{DIGEST_ENDING}"

    @property
    def manifest_name(self) -> str:
        """The name of the manifest in the bundle."""
        return f"data/{self.name}/{MANIFEST_NAME}"


def sets_in(folder: Path) -> tuple[PublishedSet, ...]:
    """Return the set that a folder is, or the sets in it, by name.

    Raises:
        DataError: there is none, or one is damaged, unfinished, imported, or named so that hosts would not take it; the
            message lists all of these.
    """
    sets, faults = [], []
    for path in set_folders(folder) or [folder]:
        try:
            found = PublishedSet(path.resolve().name, path, read_manifest(path))
        except DataError as error:
            faults.append(str(error))
            continue
        sets.append(found)
        faults += [f"{path}: {fault}" for fault in _faults_of(found)]
    if faults:
        raise DataError("nothing was published:\n" + bulleted(faults))
    return tuple(sets)


def _faults_of(found: PublishedSet) -> list[str]:
    faults = []
    if not is_set_name(found.name):
        faults.append(
            f"hosts want letters, digits, '_' and '-', at most {MAX_NAME} of them, found the folder's name "
            f"{found.name!r}; rename it"
        )
    if found.name == GROUPS_CONFIG:
        faults.append(f"{GROUPS_CONFIG!r} is the name of something else in a bundle; rename the folder")
    if found.manifest.is_imported:
        faults.append("was imported from elsewhere, under its own licence; pass on its source instead")
    if found.manifest.is_sealed:
        faults.append("is sealed: it has no labels to describe; publish its folder as it is (docs/sealed.md)")
    if not found.manifest.is_finished:
        missing = sum(not entry.is_finished for entry in found.manifest.shards)
        faults.append(f"is not finished: {missing} shards are missing; the same render command makes them")
    return faults
