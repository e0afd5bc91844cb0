"""manifest.json: what a set consists of, beside its shards.

It is written before the first shard, says of each shard that is finished what its bytes are, and carries a
digest of itself. `fingerprint` names the finished set by its contents.
"""

import hashlib
import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from symsol_annot.errors import DataError, SettingsError
from symsol_annot.sets.shard.header import MAX_IMAGES_PER_SHARD, ShardHeader, shard_file_name
from symsol_annot.sets.shard.layout import LAYOUTS, NEWEST
from symsol_annot.sets.stated.settings import (
    ImportedSettings,
    RenderedSettings,
    SealedSettings,
    SetSettings,
    settings_from_json,
)
from symsol_annot.sets.stated.values import is_sha256, is_whole
from symsol_annot.system.files import write_atomically
from symsol_annot.system.reading import read_bytes
from symsol_annot.system.text.names import SPLITS

MANIFEST_NAME = "manifest.json"
MANIFEST_FORMAT = "symsol-annot set"
MAX_MANIFEST_BYTES = 2**24  # 50,000 shards; JSON takes up to 25 times its size in memory
_BESIDES_PIXELS_BYTES = 2**23  # of a shard: the labels of 500 images over 7,200 symmetries, the group, the attributes
_FINGERPRINTED = ("object", "object_sha256", "seed", "camera")  # of the settings, beside the contents


@dataclass(frozen=True)
class ShardEntry:
    """One shard of the plan; `bytes`, `sha256` and `content_sha256` are None until it is finished.

    Attributes:
        file: its name in the folder.
        split: "train" or "test".
        first_index: the index within the split of its first image.
        images: how many it holds.
        bytes: the size of the file, in bytes.
        sha256: of the file.
        content_sha256: of its arrays, as `shard.reader.content_sha256`.
    """

    file: str
    split: str
    first_index: int
    images: int
    bytes: int | None = None
    sha256: str | None = None
    content_sha256: str | None = None

    @property
    def is_finished(self) -> bool:
        """Whether the shard was written."""
        return self.sha256 is not None


@dataclass(frozen=True)
class Manifest:
    """A set: what it was made from, and its shards.

    Attributes:
        settings: what decides the contents, or what is known of an imported set.
        shards: all planned shards, train before test, in order.
        format_version: of the manifest and of its shards, one of `LAYOUTS`; only sets of the newest are made.
    """

    settings: SetSettings
    shards: tuple[ShardEntry, ...]
    format_version: int = NEWEST

    @property
    def is_finished(self) -> bool:
        """Whether every shard was written."""
        return all(shard.is_finished for shard in self.shards)

    @property
    def fingerprint(self) -> str | None:
        """The SHA-256 over object, seed, camera and contents of a finished set; None before."""
        return self._digest(self.shards) if self.is_finished else None

    @property
    def plan_sha256(self) -> str:
        """The SHA-256 of what the set is to be, which making it does not change."""
        division = [[shard.file, shard.first_index, shard.images] for shard in self.shards]
        return _sha256_of_json([self.settings.to_json(), division])

    def split_fingerprint(self, split: str) -> str | None:
        """Return the fingerprint of one split, which does not depend on whether the other was rendered; None before."""
        shards = self.of_split(split)
        return self._digest(shards) if shards and all(shard.is_finished for shard in shards) else None

    def of_split(self, split: str) -> tuple[ShardEntry, ...]:
        """Return a split's shards in order."""
        return tuple(shard for shard in self.shards if shard.split == split)

    def images(self, split: str) -> int:
        """Return how many images a split has."""
        return sum(shard.images for shard in self.of_split(split))

    @property
    def is_imported(self) -> bool:
        """Whether the images are from another source, which does not say how they were drawn."""
        return isinstance(self.settings, ImportedSettings)

    @property
    def is_sealed(self) -> bool:
        """Whether the set has the images of a sealed test alone, whose labels nobody knows who lacks its secret."""
        return isinstance(self.settings, SealedSettings)

    @property
    def sealed(self) -> SealedSettings:
        """The settings of a sealed set.

        Raises:
            DataError: the set is no sealed one.
        """
        if not isinstance(self.settings, SealedSettings):
            raise DataError(f"{self.settings.object}: is no sealed set; `symsol-annot seal render` makes one")
        return self.settings

    @property
    def rendered(self) -> RenderedSettings:
        """The settings of a rendered set.

        Raises:
            DataError: the set was imported or is sealed, so how its images were drawn is not known.
        """
        if self.is_sealed:
            raise DataError(f"{self.settings.object}: is a sealed set: the seed of its images is secret")
        if not isinstance(self.settings, RenderedSettings):
            raise DataError(f"{self.settings.object}: is an imported set: how its images were drawn is not known")
        return self.settings

    @property
    def imported(self) -> ImportedSettings:
        """What is known of an imported set.

        Raises:
            DataError: the set was rendered.
        """
        if not isinstance(self.settings, ImportedSettings):
            raise DataError(f"{self.settings.object}: is a rendered set, which has no source")
        return self.settings

    def is_annotated(self, split: str) -> bool:
        """Tell whether a split carries symmetry sets."""
        return self.settings.is_annotated(split)

    def header(self, entry: ShardEntry, versions: dict[str, str]) -> ShardHeader:
        """Return what a shard of this set says of itself, made with such software."""
        return ShardHeader(self.settings, entry.split, entry.first_index, versions, self.format_version)

    def expected_attributes(self, entry: ShardEntry) -> dict[str, Any]:
        """Return the attributes that a shard of this set carries, but for the software's versions."""
        attributes = self.header(entry, versions={}).to_attributes()
        del attributes["versions"]
        return attributes

    def with_finished(self, entry: ShardEntry) -> "Manifest":
        """Return the manifest with one shard's entry replaced."""
        return replace(self, shards=tuple(entry if shard.file == entry.file else shard for shard in self.shards))

    def differences(self, other: "Manifest") -> list[str]:
        """Say in what the plan of another set differs: one line each."""
        there = other.settings.to_json()
        pairs = [(key, there.get(key), value) for key, value in self.settings.to_json().items()]
        pairs += [(f"{split} images", other.images(split), self.images(split)) for split in SPLITS]
        lines = [f"{what}: there {theirs!r}, asked for {ours!r}" for what, theirs, ours in pairs if theirs != ours]
        plans = [[(s.file, s.first_index, s.images) for s in manifest.shards] for manifest in (self, other)]
        if not lines and plans[0] != plans[1]:
            lines.append("the division into shards")
        return lines

    def _digest(self, shards: tuple[ShardEntry, ...]) -> str:
        stated = self.settings.to_json()
        made_from = {key: stated[key] for key in _FINGERPRINTED}
        contents = [[shard.split, shard.first_index, shard.images, shard.content_sha256] for shard in shards]
        return _sha256_of_json({**made_from, "contents": contents})


def write_manifest(folder: Path, manifest: Manifest) -> None:
    """Write a set's manifest.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(folder / MANIFEST_NAME, _serialise(manifest))


def read_manifest(folder: Path) -> Manifest:
    """Read a set's manifest and check it against its own digest.

    Raises:
        DataError: it is missing, damaged, or of another format version.
    """
    path = folder / MANIFEST_NAME
    try:
        data = read_bytes(path, MAX_MANIFEST_BYTES)
    except FileNotFoundError:
        raise DataError(f"{folder}: holds no {MANIFEST_NAME}; {_hint(folder)}") from None
    except NotADirectoryError:
        raise DataError(f"{folder}: is a file; a set is a folder, like data/cylO") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    return manifest_from_bytes(data, str(path))


def manifest_from_bytes(data: bytes, path: str) -> Manifest:
    """Read a set's manifest from its bytes and check it against its own digest.

    Args:
        data: the file's bytes.
        path: what the file is called, for messages.

    Raises:
        DataError: it is damaged, or of another format version.
    """
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: cannot be read as JSON: {error}") from None
    if not isinstance(document, dict) or document.get("format") != MANIFEST_FORMAT:
        raise DataError(f"{path}: is no manifest of a set ('format' is not {MANIFEST_FORMAT!r})")
    found = document.get("format_version")
    if type(found) is int and found > NEWEST:
        raise DataError(
            f"{path}: is of format version {found}, newer than {NEWEST}, which this symsol-annot reads: update it"
        )
    if type(found) is not int or found not in LAYOUTS:
        known = " and ".join(str(version) for version in LAYOUTS)
        raise DataError(f"{path}: this symsol-annot reads format_version {known}, found {found!r}")
    try:
        manifest = _from_document(document)
        is_whole = _serialise(manifest) == data
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError, SettingsError):
        is_whole = False
    if not is_whole:
        raise DataError(
            f"{path}: is damaged or was edited: its bytes are not the ones that its own digests stand for. "
            "Fetch it again, or render the set again"
        )
    return manifest


def refuse_to_add(folder: Path, manifest: Manifest) -> None:
    """Raise a DataError where a folder's set is of a format that is read, and no longer written."""
    if manifest.format_version != NEWEST:
        again = "Import it" if manifest.is_imported else "Render it"
        raise DataError(
            f"{folder}: holds a set of format version {manifest.format_version}, which is read for good but no longer "
            f"written, so nothing was touched. {again} anew into another folder (--out) to have it in version {NEWEST}"
        )


def _serialise(manifest: Manifest) -> bytes:
    document = _to_document(manifest)
    document["manifest_sha256"] = _sha256_of_json(document)
    return (json.dumps(document, indent=1) + "\n").encode()


def _to_document(manifest: Manifest) -> dict[str, Any]:
    splits = {}
    for split in SPLITS:
        shards = [
            {
                "file": shard.file,
                "first_index": shard.first_index,
                "images": shard.images,
                "bytes": shard.bytes,
                "sha256": shard.sha256,
                "content_sha256": shard.content_sha256,
            }
            for shard in manifest.of_split(split)
        ]
        if shards:
            splits[split] = {
                "images": manifest.images(split),
                "annotated": manifest.is_annotated(split),
                "fingerprint": manifest.split_fingerprint(split),
                "shards": shards,
            }
    return {
        "format": MANIFEST_FORMAT,
        "format_version": manifest.format_version,
        **manifest.settings.to_json(),
        "fingerprint": manifest.fingerprint,
        "splits": splits,
    }


def _from_document(document: dict[str, Any]) -> Manifest:
    besides = ("format", "format_version", "fingerprint", "splits", "manifest_sha256")
    settings = settings_from_json({key: value for key, value in document.items() if key not in besides})
    shards = tuple(
        ShardEntry(split=split, **shard)
        for split in SPLITS
        for shard in document["splits"].get(split, {}).get("shards", [])
    )
    manifest = Manifest(settings, shards, document["format_version"])
    _require(LAYOUTS[manifest.format_version].has_depth or not settings.has_depth, "depth")
    _check_shards(manifest)
    return manifest


def _check_shards(manifest: Manifest) -> None:
    """Raise a ValueError where an entry is none that a shard can have, or shards do not follow on."""
    for split in SPLITS:
        following, shards = 0, manifest.of_split(split)
        for number, shard in enumerate(shards):
            name = shard_file_name(split, number, len(shards))
            _require(type(shard.first_index) is int and type(shard.images) is int, shard.file)
            _require(shard.file == name and shard.first_index == following, shard.file)
            _require(1 <= shard.images <= MAX_IMAGES_PER_SHARD, shard.file)
            _require(_is_finished_or_not(shard, manifest.settings), shard.file)
            following += shard.images


def _is_finished_or_not(shard: ShardEntry, settings: SetSettings) -> bool:
    found = (shard.bytes, shard.sha256, shard.content_sha256)
    if found == (None, None, None):
        return True
    pixels = shard.images * math.prod(settings.image_size)
    per_pixel = 9 if settings.has_depth else 5  # RGB, segmentation and depth, which compressing hardly lengthens
    most = _BESIDES_PIXELS_BYTES + per_pixel * pixels
    return is_whole(shard.bytes, 1, most) and is_sha256(shard.sha256) and is_sha256(shard.content_sha256)


def _require(is_right: bool, what: str) -> None:  # noqa: FBT001
    if not is_right:
        raise ValueError(what)


def shards_in(folder: Path) -> list[str]:
    """Return the names of a folder's HDF5 files, of this set or not, but for hidden ones like macOS' ._x.h5."""
    return sorted(path.name for path in folder.glob("*.h5") if not path.name.startswith("."))


def _hint(folder: Path) -> str:
    sets = sorted(path.parent.name for path in folder.glob(f"[!.]*/{MANIFEST_NAME}"))
    if sets:
        return f"it has sets inside: {', '.join(str(folder / name) for name in sets)}"
    return "a set is a folder that `symsol-annot render` made, like data/cylO"


def _sha256_of_json(document: Any) -> str:
    return hashlib.sha256(json.dumps(document, sort_keys=True, separators=(",", ":")).encode()).hexdigest()
