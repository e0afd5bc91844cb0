"""What a sealed test is made from: its secret, and the commitment to it that is published beforehand.

Both are files of JSON. The commitment's digest is the SHA-256 of the secret's file, so that `sha256sum secret.json`
checks a secret that was revealed. What the secret says beside its seed is public; the seed's 128 random bits hide the
rotations.
"""

import hashlib
import json
import os
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from symsol_annot.errors import SealError, SettingsError, output_errors
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.plan import division_into_shards
from symsol_annot.sets.stated.settings import RenderedSettings, SealedSettings, settings_from_json
from symsol_annot.sets.stated.values import MAX_SECRET_SEED, SECRET_SEED_BITS, is_sha256, is_whole, seed_to_json
from symsol_annot.system.files import replaced
from symsol_annot.system.reading import read_bytes

SECRET_NAME, COMMITMENT_NAME = "secret.json", "commitment.json"
LABELLED, PUBLIC = "labelled", "public"  # folders beside the secret: the set with its labels, and its images alone
SPLIT = "test"  # a sealed test has no other
SEED_DIGITS = SECRET_SEED_BITS // 4
_SECRET_FORMAT, _COMMITMENT_FORMAT = "symsol-annot sealed test: secret", "symsol-annot sealed test: commitment"
_FORMAT_VERSION = 1
_REMEDY = {
    _SECRET_FORMAT: f"a sealed test is a folder with {SECRET_NAME}, which `symsol-annot seal new` writes",
    _COMMITMENT_FORMAT: f"{COMMITMENT_NAME} is published with a sealed test's images; fetch it again",
}
_MAX_BYTES = 2**20
_MAX_IMAGES = 10**7
_SEED = re.compile(rf"[0-9a-f]{{{SEED_DIGITS}}}")
_SETTINGS = ("object", "object_sha256", "camera", "render", "tolerance_px")
_KEYS = {*_SETTINGS, "format", "format_version", "images", "versions"}
_FAULTS = (KeyError, TypeError, ValueError, AttributeError, RecursionError, OverflowError, SettingsError)


@dataclass(frozen=True)
class Secret:
    """All that decides a sealed test.

    Attributes:
        settings: of the set with its labels, the secret seed among them.
        images: how many it has.
        versions: the software that it was sealed for: name to version.
    """

    settings: RenderedSettings
    images: int
    versions: dict[str, str]

    def to_bytes(self) -> bytes:
        """Return the contents of its file."""
        return _serialise({**_terms(self), "format": _SECRET_FORMAT, "seed": self.seed_hex})

    @property
    def seed_hex(self) -> str:
        """The seed as 32 hexadecimal digits."""
        return f"{self.settings.seed:0{SEED_DIGITS}x}"

    @property
    def digest(self) -> str:
        """The SHA-256 of its file, which is published beforehand."""
        return hashlib.sha256(self.to_bytes()).hexdigest()

    @property
    def commitment(self) -> "Commitment":
        """What is published of it."""
        return Commitment(self.digest, replace(self, settings=replace(self.settings, seed=0)))

    def labelled_manifest(self) -> Manifest:
        """Return the manifest of the set with its labels, before its first shard is written."""
        return Manifest(self.settings, self._shards())

    def public_manifest(self) -> Manifest:
        """Return the manifest of the set of its images alone, before its first shard is written."""
        ours = self.settings
        public = SealedSettings(
            object=ours.object,
            object_sha256=ours.object_sha256,
            camera=ours.camera,
            render=ours.render,
            commitment=self.digest,
        )
        return Manifest(public, self._shards())

    def _shards(self) -> tuple[ShardEntry, ...]:
        width, height = self.settings.image_size
        return division_into_shards({SPLIT: self.images}, width * height)


@dataclass(frozen=True)
class Commitment:
    """What is published of a secret before its images are.

    Attributes:
        digest: the SHA-256 of the secret's file.
        terms: the secret without its seed, which is 0 here.
    """

    digest: str
    terms: Secret

    def to_bytes(self) -> bytes:
        """Return the contents of its file."""
        return _serialise({**_terms(self.terms), "format": _COMMITMENT_FORMAT, "sha256": self.digest})

    def opened_by(self, seed: int) -> Secret:
        """Return the secret, given its seed.

        Raises:
            SealError: the seed is another one.
        """
        secret = replace(self.terms, settings=replace(self.terms.settings, seed=seed))
        if secret.digest != self.digest:
            raise SealError(
                f"seed {secret.seed_hex}: does not fit the commitment, whose digest is {self.digest}; with this seed "
                f"it would be {secret.digest}. It is mistyped, or another test's, or was changed after the commitment"
            )
        return secret


def read_secret(path: Path) -> Secret:
    """Read a sealed test's secret.

    Raises:
        SealError: it is missing, or was damaged or edited.
    """

    def parsed(document: dict[str, Any]) -> Secret:
        _require(_SEED.fullmatch(document["seed"]) is not None)
        return _secret_of(document, int(document["seed"], 16))

    return _read(path, _SECRET_FORMAT, {*_KEYS, "seed"}, parsed)


def read_commitment(path: Path) -> Commitment:
    """Read what was published of a secret.

    Raises:
        SealError: it is missing, or was damaged or edited.
    """

    def parsed(document: dict[str, Any]) -> Commitment:
        _require(is_sha256(document["sha256"]))
        return Commitment(document["sha256"], _secret_of(document, 0))

    return _read(path, _COMMITMENT_FORMAT, {*_KEYS, "sha256"}, parsed)


def write_secret(path: Path, secret: Secret) -> None:
    """Write a secret where no file is, to be read by its owner alone, from its first byte on.

    Raises:
        OutputError: it cannot be written.
    """
    with replaced(path) as new, output_errors(path):
        descriptor = os.open(new, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(secret.to_bytes())
            file.flush()
            os.fsync(file.fileno())


def _terms(secret: Secret) -> dict[str, Any]:
    stated = secret.settings.to_json()
    settings = {key: stated[key] for key in _SETTINGS}
    return {**settings, "format_version": _FORMAT_VERSION, "images": secret.images, "versions": secret.versions}


def _secret_of(document: dict[str, Any], seed: int) -> Secret:
    _require(0 <= seed <= MAX_SECRET_SEED and is_whole(document["images"], 1, _MAX_IMAGES))
    versions = document["versions"]
    _require(type(versions) is dict and all(type(version) is str for version in versions.values()))
    settings = {key: document[key] for key in _SETTINGS}
    made = settings_from_json({**settings, "seed": seed_to_json(seed), "annotate": SPLIT})
    _require(isinstance(made, RenderedSettings))
    return Secret(made, document["images"], versions)  # type: ignore[arg-type]  # just looked at


def _read(path: Path, format_name: str, keys: set[str], parsed: Any) -> Any:
    try:
        data = read_bytes(path, _MAX_BYTES)
    except OSError as error:
        raise SealError(f"{path}: cannot be read: {error.strerror}; {_REMEDY[format_name]}") from None
    try:
        document = json.loads(data)
        is_other = document.get("format") != format_name or document.get("format_version") != _FORMAT_VERSION
    except _FAULTS:
        is_other = True
    if is_other:
        raise SealError(f"{path}: is no file {format_name!r} of format version {_FORMAT_VERSION}")
    try:
        _require(set(document) == keys)
        found = parsed(document)
        is_whole_file = found.to_bytes() == data
    except _FAULTS:
        is_whole_file = False
    if not is_whole_file:
        raise SealError(f"{path}: was damaged or edited since it was written; take it from where it was kept")
    return found


def _serialise(document: dict[str, Any]) -> bytes:
    return (json.dumps(document, indent=1, sort_keys=True) + "\n").encode()


def _require(is_right: bool) -> None:  # noqa: FBT001
    if not is_right:
        raise ValueError
