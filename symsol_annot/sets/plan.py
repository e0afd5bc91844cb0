"""The plan of a set: all that decides its bytes, its division into shards, and each image's rotation."""

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from symsol_annot.errors import SettingsError
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations, uniform_rotations
from symsol_annot.sets.manifest import Manifest, ShardEntry
from symsol_annot.sets.shard.header import MAX_IMAGES_PER_SHARD, shard_file_name
from symsol_annot.sets.stated.equality import Equality
from symsol_annot.sets.stated.settings import ANNOTATE_CHOICES, RenderedSettings
from symsol_annot.sets.stated.values import MAX_SECRET_SEED
from symsol_annot.system.text.names import SPLITS

_MAX_PIXELS_PER_SHARD = 2**25  # a shard is built in memory
_SMALL_SET_SHARDS = 8  # a small set is still divided, so that several workers have work
_MIN_IMAGES_PER_SHARD = 16


@dataclass(frozen=True)
class SetPlan:
    """All that decides a set's bytes.

    Attributes:
        spec: the object.
        images: how many images a split has, by split.
        seed: of the random rotations.
        camera: what the object is seen through.
        settings: how it is drawn.
        annotate: which splits get symmetry sets: "all", "test" or "none".
    """

    spec: ObjectSpec
    images: dict[str, int]
    seed: int
    camera: Camera
    settings: RenderSettings
    annotate: str

    def __post_init__(self) -> None:
        """Refuse counts and choices that make no set."""
        if any(number < 0 for number in self.images.values()) or not any(self.images.values()):
            raise SettingsError(f"images: expected counts of 0 or more that are not all 0, found {self.images}")
        if set(self.images) - set(SPLITS):
            raise SettingsError(f"splits: expected {', '.join(SPLITS)}, found {', '.join(self.images)}")
        if self.annotate not in ANNOTATE_CHOICES:
            raise SettingsError(f"annotate: expected one of {', '.join(ANNOTATE_CHOICES)}, found {self.annotate!r}")
        if not 0 <= self.seed <= MAX_SECRET_SEED:
            raise SettingsError(f"seed: expected 0 to {MAX_SECRET_SEED}, found {self.seed}")

    @classmethod
    def behind(cls, manifest: Manifest, spec: ObjectSpec) -> "SetPlan":
        """Return the plan that a set was made by; whether its object is that set's is for `generate` to find.

        Raises:
            DataError: the set was imported.
        """
        made = manifest.rendered
        images = {split: manifest.images(split) for split in SPLITS}
        return cls(spec, images, made.seed, made.camera, made.render, made.annotate)

    @property
    def set_settings(self) -> RenderedSettings:
        """The settings of the set, of which its manifest and its shards' attributes derive."""
        return RenderedSettings(
            object=self.spec.name,
            object_sha256=self.spec.digest,
            seed=self.seed,
            camera=self.camera,
            render=self.settings,
            tolerance_px=self.spec.tolerance_px,
            equality=Equality.for_object(self.spec),
            annotate=self.annotate,
        )

    def manifest(self) -> Manifest:
        """Return the manifest of the set before its first shard is written."""
        shards = division_into_shards(self.images, self.camera.width * self.camera.height)
        return Manifest(self.set_settings, shards)


def division_into_shards(images: dict[str, int], pixels_per_image: int) -> tuple[ShardEntry, ...]:
    """Return the shards, none of them finished, of a set with so many images in each split."""
    fitting = max(1, _MAX_PIXELS_PER_SHARD // pixels_per_image)
    return tuple(entry for split in SPLITS for entry in _shards(split, images.get(split, 0), fitting))


def _shards(split: str, images: int, fitting: int) -> Iterator[ShardEntry]:
    per_shard = max(_MIN_IMAGES_PER_SHARD, -(-images // _SMALL_SET_SHARDS))
    per_shard = min(per_shard, MAX_IMAGES_PER_SHARD, fitting)
    shards = -(-images // per_shard)
    for number in range(shards):
        first = number * per_shard
        yield ShardEntry(shard_file_name(split, number, shards), split, first, min(per_shard, images - first))


def label_rotation(seed: int, object_name: str, split: str, index: int) -> Rotations:
    """Return the rotation (3, 3) of one image: uniform on SO(3), from these four values alone.

    An image's rotation tells nothing of another's to whoever does not know the seed, since SHA-256 is between them.
    """
    key = hashlib.sha256(f"{seed}/{object_name}/{split}/{index}".encode()).digest()
    rng = np.random.Generator(np.random.Philox(key=np.frombuffer(key[:16], dtype="<u8")))
    return uniform_rotations(1, rng)[0]
