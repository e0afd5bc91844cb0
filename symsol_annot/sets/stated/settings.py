"""The settings of a set: all that decides its contents, or, of an imported set, what is known of them.

They are stated once, here. The manifest, the attributes of a shard and the plan are derived from them.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import asdict, dataclass, fields
from typing import Any

from symsol_annot.rendering.camera import SIZE_RANGE, Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.stated.equality import Equality, PartsOfSet, equality_from_json
from symsol_annot.sets.stated.values import (
    is_number,
    is_sha256,
    is_short_text,
    is_whole,
    require,
    seed_from_json,
    seed_to_json,
)
from symsol_annot.system.text.names import is_object_name

ANNOTATE_CHOICES = ("all", "test", "none")
BOP_SOURCE = "BOP"  # how the name of a source begins that `import-bop` read
_MAX_LISTED = 2**31
_UNKNOWN_WHERE_IMPORTED = ("object_sha256", "seed", "render", "tolerance_px")
_RENDERED_KEYS = {"object", "object_sha256", "seed", "camera", "render", "tolerance_px", "annotate"}
_IMPORTED_KEYS = {*_RENDERED_KEYS, "source"}
_EQUALITY = "equality"  # stated of objects of format version 2 alone
_SEALED_KEYS = {*_RENDERED_KEYS, "commitment"}
_UNKNOWN_WHERE_SEALED = ("seed", "tolerance_px")


@dataclass(frozen=True, kw_only=True)
class SetSettings(ABC):
    """What is known of every set, rendered, imported or sealed.

    Attributes:
        object: the object's name.
        annotate: which splits have symmetry sets: "all", "test" or "none".
    """

    object: str
    annotate: str

    @property
    @abstractmethod
    def image_size(self) -> tuple[int, int]:
        """Width and height of every image, in pixels."""

    @property
    @abstractmethod
    def has_marking(self) -> bool:
        """Whether the object has a marking by which the images are divided; False for an imported set."""

    @property
    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """The names of the object's parts, in the order of their ids, the first of id 1; none in an imported set."""

    @property
    @abstractmethod
    def has_depth(self) -> bool:
        """Whether every image has a depth map."""

    @property
    def named_parts(self) -> PartsOfSet | None:
        """The parts of an object of format version 2, as pictures name them; None for another."""
        return None

    @abstractmethod
    def to_json(self) -> dict[str, Any]:
        """Return the settings as they stand in manifest.json, in the order of its keys; None for what is not known."""

    def is_annotated(self, split: str) -> bool:
        """Tell whether a split has symmetry sets."""
        return self.annotate in ("all", split)


@dataclass(frozen=True, kw_only=True)
class RenderedSettings(SetSettings):
    """What decides the contents of a rendered set.

    Attributes:
        object_sha256: the digest of the object's files, as `ObjectSpec.digest`.
        seed: of the random rotations.
        camera: what the object is seen through.
        render: how it is drawn.
        tolerance_px: the object's T in pixels; None without a marking.
        equality: the object's parts, and its rule; None for an object of format version 1.
    """

    object_sha256: str
    seed: int
    camera: Camera
    render: RenderSettings
    tolerance_px: float | None
    equality: Equality | None = None

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of every image, in pixels."""
        return self.camera.width, self.camera.height

    @property
    def has_marking(self) -> bool:
        """Whether the object has a marking by which the images are divided."""
        return self.tolerance_px is not None

    @property
    def parts(self) -> tuple[str, ...]:
        """The names of the object's parts, in the order of their ids, the first of id 1."""
        if self.equality is not None:
            return self.equality.parts
        return ("body", "marking") if self.has_marking else ("body",)

    @property
    def named_parts(self) -> PartsOfSet | None:
        """The parts of an object of format version 2, as pictures name them; None for another."""
        stated = self.equality
        return None if stated is None else PartsOfSet(stated.parts, stated.breaking, self.tolerance_px)

    @property
    def has_depth(self) -> bool:
        """Whether every image has a depth map."""
        return self.render.depth

    def to_json(self) -> dict[str, Any]:
        """Return the settings as they stand in manifest.json, in the order of its keys."""
        equality = {} if self.equality is None else {_EQUALITY: self.equality.to_json()}
        return {
            "object": self.object,
            "object_sha256": self.object_sha256,
            "seed": seed_to_json(self.seed),
            "camera": self.camera.to_dict(),
            "render": self.render.to_dict(),
            "tolerance_px": self.tolerance_px,
            **equality,
            "annotate": self.annotate,
        }


@dataclass(frozen=True, kw_only=True)
class SealedSettings(SetSettings):
    """What anybody may know of a sealed set, which holds the images of a sealed test and no labels.

    Attributes:
        object_sha256: the digest of the object's files, as `ObjectSpec.digest`.
        camera: what the object is seen through.
        render: how it is drawn.
        commitment: the SHA-256 of the sealed test's secret, published before the images are.
        annotate: "none".
    """

    object_sha256: str
    camera: Camera
    render: RenderSettings
    commitment: str
    annotate: str = ANNOTATE_CHOICES[-1]

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of every image, in pixels."""
        return self.camera.width, self.camera.height

    @property
    def has_marking(self) -> bool:
        """False: which images show the marking is sealed."""
        return False

    @property
    def parts(self) -> tuple[str, ...]:
        """None: which pixels are whose is sealed."""
        return ()

    @property
    def has_depth(self) -> bool:
        """False: depth maps are sealed."""
        return False

    def to_json(self) -> dict[str, Any]:
        """Return the settings as they stand in manifest.json, in the order of its keys; None for what is sealed."""
        return {
            "object": self.object,
            "object_sha256": self.object_sha256,
            "seed": None,
            "camera": self.camera.to_dict(),
            "render": self.render.to_dict(),
            "tolerance_px": None,
            "annotate": self.annotate,
            "commitment": self.commitment,
        }


@dataclass(frozen=True)
class Source:
    """Where the images of an imported set are from.

    Attributes:
        name: of the source, like "SYMSOL".
        sha256: of its file; of a list of its files where it has several.
        convention: of its rotations, in words; "unknown" where the source does not say.
        transposed: whether its matrices were transposed, so that symmetries act on the right.
        rotations_listed: how many rotations it lists per annotated image.
        duplicates_removed: how many of them repeat another one of the same list.
    """

    name: str
    sha256: str
    convention: str
    transposed: bool
    rotations_listed: int
    duplicates_removed: int

    @property
    def command(self) -> str:
        """The command that imports from it."""
        return "import-bop" if self.name.startswith(BOP_SOURCE) else "import-symsol"

    def to_json(self) -> dict[str, Any]:
        """Return the source as it stands in manifest.json and in the attributes of a shard."""
        return asdict(self)


@dataclass(frozen=True, kw_only=True)
class ImportedSettings(SetSettings):
    """What is known of an imported set; how its images were drawn is not.

    Attributes:
        width: of every image, in pixels.
        height: of every image, in pixels.
        source: where they are from.
    """

    width: int
    height: int
    source: Source

    @property
    def image_size(self) -> tuple[int, int]:
        """Width and height of every image, in pixels."""
        return self.width, self.height

    @property
    def has_marking(self) -> bool:
        """False: an imported set is not divided by a marking."""
        return False

    @property
    def parts(self) -> tuple[str, ...]:
        """None: an imported set does not say which pixels are whose."""
        return ()

    @property
    def has_depth(self) -> bool:
        """False: an imported set has no depth maps."""
        return False

    def camera_to_json(self) -> dict[str, Any]:
        """Return the camera as far as it is known: its size in pixels."""
        return {"distance": None, "focal_px": None, "width": self.width, "height": self.height}

    def to_json(self) -> dict[str, Any]:
        """Return the settings as they stand in manifest.json, in the order of its keys; None for what is not known."""
        return {
            "object": self.object,
            "object_sha256": None,
            "seed": None,
            "camera": self.camera_to_json(),
            "render": None,
            "tolerance_px": None,
            "annotate": self.annotate,
            "source": self.source.to_json(),
        }


def settings_from_json(stated: dict[str, Any]) -> SetSettings:
    """Return the settings that `to_json` gave.

    Raises:
        ValueError: a key is missing or unknown, or a value is none that a set can have.
        TypeError: the render settings are no table of all of them.
        SettingsError: a render setting makes no sense.
    """
    made = next((made for mark, made in _MADE_BY_MARK.items() if mark in stated), _rendered)
    require(set(stated) - ({_EQUALITY} if made is _rendered else set()) == _KEYS[made], "unknown fields")
    require(is_object_name(stated["object"]), "object")
    require(type(stated["annotate"]) is str and stated["annotate"] in ANNOTATE_CHOICES, "annotate")
    camera = stated["camera"]
    require(type(camera) is dict and set(camera) == {field.name for field in fields(Camera)}, "camera")
    require(all(is_whole(camera[side], *SIZE_RANGE) for side in ("width", "height")), "camera: its size")
    return made(stated)


def _rendered(stated: dict[str, Any]) -> RenderedSettings:
    tolerance_px = stated["tolerance_px"]
    _require_drawn(stated)
    require(tolerance_px is None or (is_number(tolerance_px) and tolerance_px > 0), "tolerance_px")
    equality = equality_from_json(stated[_EQUALITY]) if _EQUALITY in stated else None
    require(equality is None or bool(equality.breaking) == (tolerance_px is not None), "tolerance_px")
    return RenderedSettings(
        object=stated["object"],
        object_sha256=stated["object_sha256"],
        seed=seed_from_json(stated["seed"]),
        camera=Camera(**stated["camera"]),
        render=RenderSettings.from_dict(stated["render"]),
        tolerance_px=tolerance_px,
        equality=equality,
        annotate=stated["annotate"],
    )


def _require_drawn(stated: dict[str, Any]) -> None:
    """Check what is known of all images that were drawn here."""
    camera = stated["camera"]
    require(is_number(camera["distance"]) and camera["distance"] > 1, "camera: its distance")
    require(is_number(camera["focal_px"]) and camera["focal_px"] > 0, "camera: its focal length")
    require(is_sha256(stated["object_sha256"]), "object_sha256")


def _sealed(stated: dict[str, Any]) -> SealedSettings:
    require(all(stated[name] is None for name in _UNKNOWN_WHERE_SEALED), "what is sealed")
    require(stated["annotate"] == ANNOTATE_CHOICES[-1], "annotate")
    _require_drawn(stated)
    require(is_sha256(stated["commitment"]), "commitment")
    return SealedSettings(
        object=stated["object"],
        object_sha256=stated["object_sha256"],
        camera=Camera(**stated["camera"]),
        render=RenderSettings.from_dict(stated["render"]),
        commitment=stated["commitment"],
    )


def _imported(stated: dict[str, Any]) -> ImportedSettings:
    camera, source = stated["camera"], stated["source"]
    require(all(stated[name] is None for name in _UNKNOWN_WHERE_IMPORTED), "what an import cannot know")
    require(camera["distance"] is None and camera["focal_px"] is None, "camera")
    require(type(source) is dict and set(source) == {field.name for field in fields(Source)}, "source")
    require(all(is_short_text(source[name]) for name in ("name", "convention")), "source")
    counts = ("rotations_listed", "duplicates_removed")
    require(all(is_whole(source[name], 0, _MAX_LISTED) for name in counts), "source")
    require(is_sha256(source["sha256"]) and type(source["transposed"]) is bool, "source")
    return ImportedSettings(
        object=stated["object"],
        width=camera["width"],
        height=camera["height"],
        annotate=stated["annotate"],
        source=Source(**source),
    )


_MADE_BY_MARK: dict[str, Callable[[dict[str, Any]], SetSettings]] = {"source": _imported, "commitment": _sealed}
_KEYS: dict[Callable[[dict[str, Any]], SetSettings], set[str]] = {
    _rendered: _RENDERED_KEYS,
    _imported: _IMPORTED_KEYS,
    _sealed: _SEALED_KEYS,
}
