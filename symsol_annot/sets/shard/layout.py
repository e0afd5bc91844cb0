"""The versions of the shard's format: which data sets and attributes each has, for each kind of shard.

A version is one object here, and so is a kind and a data set: what reads and checks shards goes by them.
"""

from collections.abc import Container, Mapping
from dataclasses import dataclass

PARTS = "parts"
EQUALITY = "equality"  # of objects with parts of any kind; sets of others lack it
GROUP, GROUP_SHA256 = "symmetry_group", "symmetry_group_sha256"  # an attribute has no checksum of its own
SYMMETRY_MASK = "symmetry_mask"
VOLUME = "volume"  # of balls alone, in annotated splits: the data set, and the attributes that it points into
VOLUMES, VOLUMES_SHA256 = "volumes", "volumes_sha256"
_COMMON_ATTRIBUTES = {
    "format": "text",
    "format_version": "whole",
    "object": "text",
    "split": "text",
    "first_index": "whole",
    "camera": "text",
    "versions": "text",
}
_DRAWN_ATTRIBUTES = {
    "object_sha256": "text",
    "render": "text",
    "engine": "text",
    "tolerance_px": "real",
    "candidates_drawn": "whole",
    "candidates_within_tolerance": "whole",
}


@dataclass(frozen=True)
class ShardKind:
    """What a shard may be.

    Attributes:
        title: in messages.
        mark: the attribute that shards of this kind alone have.
        attributes: those that it has beside the common ones, to their kinds.
    """

    title: str
    mark: str
    attributes: Mapping[str, str]


RENDERED = ShardKind("a rendered shard", "seed", {**_DRAWN_ATTRIBUTES, "seed": "whole"})
FROM_SECRET = ShardKind(  # with labels too; the seed is one of a sealed test, of more bits than an integer of HDF5
    "a shard rendered from a secret seed", "secret_seed", {**_DRAWN_ATTRIBUTES, "secret_seed": "text"}
)
IMPORTED = ShardKind("an imported shard", "source", {"source": "text"})
SEALED = ShardKind(  # images alone
    "a sealed shard", "commitment", {"object_sha256": "text", "render": "text", "commitment": "text"}
)
_WITH_MAPS = frozenset({RENDERED.mark, FROM_SECRET.mark})
_WITH_LABELS = _WITH_MAPS | {IMPORTED.mark}
_ALL = _WITH_LABELS | {SEALED.mark}


@dataclass(frozen=True)
class Column:
    """A data set of a shard.

    Attributes:
        name: of the data set.
        dtype: numpy's name of its type.
        axes: its shape: a length, or what it is the number of: "images", "height", "width", "parts", "symmetries".
        is_picture: whether each row is a chunk of its own; else all rows are one chunk.
        is_optional: whether a shard may lack it.
        kinds: the marks of the kinds of shards that have it or, where it is optional, may have it.
    """

    name: str
    dtype: str
    axes: tuple[int | str, ...]
    is_picture: bool = False
    is_optional: bool = False
    kinds: frozenset[str] = _WITH_LABELS


@dataclass(frozen=True)
class ShardLayout:
    """A version of the shard's format.

    Attributes:
        version: what the attribute `format_version` says.
        columns: its data sets, in the order of the digest of a shard's contents.
        common: the attributes of all shards, to their kinds: "text", "whole", "real" or "array".
        kinds: what its shards may be, the rendered ones first.
        has_parts: whether shards with a segmentation have the attribute `parts`.
    """

    version: int
    columns: tuple[Column, ...]
    common: Mapping[str, str]
    kinds: tuple[ShardKind, ...]
    has_parts: bool

    @property
    def has_group_attribute(self) -> bool:
        """Whether the symmetry group is an attribute; else it is a data set."""
        return GROUP in self.common

    @property
    def has_depth(self) -> bool:
        """Whether shards may have depth maps."""
        return _DEPTH in self.columns

    def kind_of(self, attributes: Container[str]) -> ShardKind:
        """Return what a shard is, given the names of its attributes: rendered, where nothing tells otherwise."""
        return next((kind for kind in self.kinds[1:] if kind.mark in attributes), self.kinds[0])

    def attribute_kinds(self, kind: ShardKind) -> dict[str, str]:
        """Return the attributes that a shard has, to their kinds."""
        parts = {PARTS: "text"} if self.has_parts and kind.mark in _WITH_MAPS else {}
        return {**self.common, **kind.attributes, **parts}

    def optional_attributes(self, kind: ShardKind) -> dict[str, str]:
        """Return the attributes that a shard may have beside `attribute_kinds`, to their kinds."""
        of_volumes = {VOLUMES: "array", VOLUMES_SHA256: "text"}
        return {EQUALITY: "text", **of_volumes} if self.has_parts and kind.mark in _WITH_MAPS else {}

    def columns_of(self, kind: ShardKind) -> tuple[Column, ...]:
        """Return the data sets that a shard has or, where they are optional, may have."""
        return tuple(column for column in self.columns if kind.mark in column.kinds)


_IMAGE = Column("image", "|u1", ("images", "height", "width", 3), is_picture=True, kinds=_ALL)
_SEGMENTATION = Column("segmentation", "|u1", ("images", "height", "width"), is_picture=True, kinds=_WITH_MAPS)
_DEPTH = Column("depth", "<f4", ("images", "height", "width"), is_picture=True, is_optional=True, kinds=_WITH_MAPS)
_ROTATION = Column("rotation", "<f8", ("images", 3, 3))
_MARKING_PIXELS = Column("marking_pixels", "<f4", ("images",), kinds=_WITH_MAPS)
_PART_PIXELS = Column("part_pixels", "<f4", ("images", "parts"), kinds=_WITH_MAPS)
_SYMMETRY_MASK = Column(SYMMETRY_MASK, "|b1", ("images", "symmetries"), is_optional=True)
_VOLUME = Column(VOLUME, "<i4", ("images",), is_optional=True, kinds=_WITH_MAPS)
_GROUP = Column(GROUP, "<f8", ("symmetries", 3, 3), kinds=_ALL)

LAYOUTS = {
    1: ShardLayout(
        1,
        (_IMAGE, _SEGMENTATION, _ROTATION, _MARKING_PIXELS, _SYMMETRY_MASK, _GROUP),
        _COMMON_ATTRIBUTES,
        (RENDERED, IMPORTED),
        has_parts=False,
    ),
    2: ShardLayout(
        2,
        (_IMAGE, _SEGMENTATION, _DEPTH, _ROTATION, _MARKING_PIXELS, _PART_PIXELS, _SYMMETRY_MASK, _VOLUME),
        {**_COMMON_ATTRIBUTES, GROUP: "array", GROUP_SHA256: "text"},
        (RENDERED, FROM_SECRET, IMPORTED, SEALED),
        has_parts=True,
    ),
}
NEWEST = max(LAYOUTS)  # what is written
ALL_ATTRIBUTES = {
    name: kind_of_value
    for layout in LAYOUTS.values()
    for kind in layout.kinds
    for name, kind_of_value in {**layout.attribute_kinds(kind), **layout.optional_attributes(kind)}.items()
}
