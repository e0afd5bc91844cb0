"""The versions of the shard's format: which data sets and attributes each has.

A version is one object here, and so is a data set: what reads and checks shards goes by them.
"""

from collections.abc import Mapping
from dataclasses import dataclass

GROUP, GROUP_SHA256 = "symmetry_group", "symmetry_group_sha256"  # an attribute has no checksum of its own
_COMMON_ATTRIBUTES = {
    "format": "text",
    "format_version": "whole",
    "object": "text",
    "split": "text",
    "first_index": "whole",
    "camera": "text",
    "versions": "text",
}
_RENDERED_ATTRIBUTES = {
    "object_sha256": "text",
    "seed": "whole",
    "render": "text",
    "engine": "text",
    "tolerance_px": "real",
    "candidates_drawn": "whole",
    "candidates_within_tolerance": "whole",
}
_IMPORTED_ATTRIBUTES = {"source": "text"}


@dataclass(frozen=True)
class Column:
    """A data set of a shard.

    Attributes:
        name: of the data set.
        dtype: numpy's name of its type.
        axes: its shape: a length, or what it is the number of: "images", "height", "width", "parts", "symmetries".
        is_picture: whether each row is a chunk of its own; else all rows are one chunk.
        is_optional: whether a shard may lack it.
        is_rendered: whether rendered shards alone have it.
    """

    name: str
    dtype: str
    axes: tuple[int | str, ...]
    is_picture: bool = False
    is_optional: bool = False
    is_rendered: bool = False


@dataclass(frozen=True)
class ShardLayout:
    """A version of the shard's format.

    Attributes:
        version: what the attribute `format_version` says.
        columns: its data sets, in the order of the digest of a shard's contents.
        common: the attributes of all shards, to their kinds: "text", "whole", "real" or "array".
        rendered: those of rendered shards besides.
    """

    version: int
    columns: tuple[Column, ...]
    common: Mapping[str, str]
    rendered: Mapping[str, str]

    @property
    def has_group_attribute(self) -> bool:
        """Whether the symmetry group is an attribute; else it is a data set."""
        return GROUP in self.common

    @property
    def has_depth(self) -> bool:
        """Whether shards may have depth maps."""
        return _DEPTH in self.columns

    def attribute_kinds(self, *, is_imported: bool) -> dict[str, str]:
        """Return the attributes that a shard has, to their kinds."""
        return {**self.common, **(_IMPORTED_ATTRIBUTES if is_imported else self.rendered)}

    def columns_of(self, *, is_imported: bool) -> tuple[Column, ...]:
        """Return the data sets that a shard has or, where they are optional, may have."""
        return tuple(column for column in self.columns if not (is_imported and column.is_rendered))


_IMAGE = Column("image", "|u1", ("images", "height", "width", 3), is_picture=True)
_SEGMENTATION = Column("segmentation", "|u1", ("images", "height", "width"), is_picture=True, is_rendered=True)
_DEPTH = Column("depth", "<f4", ("images", "height", "width"), is_picture=True, is_optional=True, is_rendered=True)
_ROTATION = Column("rotation", "<f8", ("images", 3, 3))
_MARKING_PIXELS = Column("marking_pixels", "<f4", ("images",), is_rendered=True)
_PART_PIXELS = Column("part_pixels", "<f4", ("images", "parts"), is_rendered=True)
_SYMMETRY_MASK = Column("symmetry_mask", "|b1", ("images", "symmetries"), is_optional=True)
_GROUP = Column(GROUP, "<f8", ("symmetries", 3, 3))

LAYOUTS = {
    1: ShardLayout(
        1,
        (_IMAGE, _SEGMENTATION, _ROTATION, _MARKING_PIXELS, _SYMMETRY_MASK, _GROUP),
        _COMMON_ATTRIBUTES,
        _RENDERED_ATTRIBUTES,
    ),
    2: ShardLayout(
        2,
        (_IMAGE, _SEGMENTATION, _DEPTH, _ROTATION, _MARKING_PIXELS, _PART_PIXELS, _SYMMETRY_MASK),
        {**_COMMON_ATTRIBUTES, GROUP: "array", GROUP_SHA256: "text"},
        {**_RENDERED_ATTRIBUTES, "parts": "text"},
    ),
}
NEWEST = max(LAYOUTS)  # what is written
ALL_ATTRIBUTES = {
    name: kind
    for layout in LAYOUTS.values()
    for is_imported in (False, True)
    for name, kind in layout.attribute_kinds(is_imported=is_imported).items()
}
