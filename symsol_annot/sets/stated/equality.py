"""What a set states of an object with parts: their names and colours, which break the body's symmetry, what is left."""

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.group_toml import MAX_GROUP_ORDER
from symsol_annot.objects.mesh import BODY_ID
from symsol_annot.objects.parts import MAX_PARTS, Colour
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rotations.groups import ALL_ROTATIONS, nearest_element
from symsol_annot.system.text.names import is_object_name

_MOST_NAMES = 4  # that are listed
_KEYS = ("parts", "colours", "breaking", "stabiliser")
_ROTATIONS = "rotations"  # stated of balls alone


@dataclass(frozen=True)
class Equality:
    """The rule by which images of an object of format version 2 are the same; with T, all that it needs.

    Attributes:
        parts: their names in the order of their ids, the body first, whose id is 1.
        colours: linear RGB of each.
        breaking: the ids of those that break the body's symmetry, ascending.
        stabiliser: indices of the rotations of the symmetry group that map each part onto itself, ascending.
        has_all_rotations: whether the body is a ball, so that sets can fill a volume, and `symmetry_group` is a list of
            candidates and no group.
    """

    parts: tuple[str, ...]
    colours: tuple[Colour, ...]
    breaking: tuple[int, ...]
    stabiliser: tuple[int, ...]
    has_all_rotations: bool = False

    @classmethod
    def for_object(cls, spec: ObjectSpec) -> "Equality | None":
        """Return what a set of an object states; None for an object of format version 1."""
        if not spec.has_general_rule:
            return None
        stabiliser = sorted(nearest_element(spec.symmetry_group, spec.stabiliser).tolist())
        names, colours = tuple(part.name for part in spec.parts), tuple(part.colour for part in spec.parts)
        return cls(names, colours, spec.mesh.breaking, tuple(stabiliser), spec.has_all_rotations)

    def to_json(self) -> dict[str, Any]:
        """Return it as it stands in manifest.json and in the attributes of a shard."""
        stated = {key: [list(v) if isinstance(v, tuple) else v for v in getattr(self, key)] for key in _KEYS}
        return {**stated, **({_ROTATIONS: ALL_ROTATIONS} if self.has_all_rotations else {})}

    def to_text(self) -> str:
        """Return it as the attribute of a shard."""
        return json.dumps(self.to_json())


def equality_from_json(stated: Any) -> Equality:
    """Return what `to_json` gave.

    Raises:
        ValueError: it is none.
    """
    has_all = type(stated) is dict and _ROTATIONS in stated
    keys = {*_KEYS, _ROTATIONS} if has_all else set(_KEYS)
    if type(stated) is not dict or set(stated) != keys or not all(type(stated[key]) is list for key in _KEYS):
        raise ValueError(f"equality: expected the lists {', '.join(_KEYS)}")
    if has_all and stated[_ROTATIONS] != ALL_ROTATIONS:
        raise ValueError(f"equality: {_ROTATIONS}: expected {ALL_ROTATIONS!r}")
    names, colours, breaking, stabiliser = (stated[key] for key in _KEYS)
    are_names = all(is_object_name(name) for name in names) and len(set(names)) == len(names)
    if not are_names or not 1 <= len(names) <= MAX_PARTS:
        raise ValueError(f"equality: expected 1 to {MAX_PARTS} names of parts, each another one")
    if len(colours) != len(names) or not all(_is_colour(colour) for colour in colours):
        raise ValueError("equality: expected three numbers from 0 to 1 as the colour of each part")
    if not _is_ascending(breaking, BODY_ID, len(names)) or not _is_ascending(stabiliser, 0, 2 * MAX_GROUP_ORDER):
        raise ValueError("equality: expected ascending ids of parts, and ascending indices of symmetries")
    if stabiliser[:1] != [0]:
        raise ValueError("equality: the stabiliser lacks the identity, whose index is 0")
    of_parts = tuple((r, g, b) for r, g, b in colours)
    return Equality(tuple(names), of_parts, tuple(breaking), tuple(stabiliser), has_all)


def equality_stated(text: str) -> Equality:
    """Return what `Equality.to_text` gave.

    Raises:
        ValueError: it is none.
    """
    try:
        stated = json.loads(text)
    except (ValueError, RecursionError):
        raise ValueError("equality: is no JSON") from None
    return equality_from_json(stated)


def _is_colour(value: Any) -> bool:
    return type(value) is list and len(value) == 3 and all(type(x) is float and 0.0 <= x <= 1.0 for x in value)


def _is_ascending(values: list[Any], least: int, most: int) -> bool:
    are_whole = all(type(value) is int and least <= value <= most for value in values)
    return are_whole and sorted(set(values)) == values


@dataclass(frozen=True)
class PartsOfSet:
    """The parts of a set's object, as pictures of its images name them.

    Attributes:
        names: in the order of their ids, the first of id 1.
        breaking: the ids of those that break the body's symmetry.
        tolerance_px: a part shows where its visible area reaches this; None where none breaks the symmetry.
    """

    names: tuple[str, ...]
    breaking: tuple[int, ...]
    tolerance_px: float | None

    @property
    def is_one(self) -> bool:
        """Whether a single part breaks the body's symmetry."""
        return len(self.breaking) == 1

    def in_view(self, part_pixels: npt.NDArray[np.float32]) -> tuple[str, ...]:
        """Return the names of the parts that an image shows, given their areas (P,) in pixels."""
        least = self.tolerance_px or np.finfo(np.float32).tiny
        return tuple(name for name, area_px in zip(self.names, part_pixels, strict=True) if area_px >= least)

    def in_words(self, part_pixels: npt.NDArray[np.float32] | None) -> str:
        """Say which parts an image shows; where a single one breaks the symmetry, by how many pixels that shows."""
        if part_pixels is None or not self.breaking:
            return "segmentation"
        if self.is_one:
            name, area_px = self.names[self.breaking[0] - 1], float(part_pixels[self.breaking[0] - 1])
            return f"{name}: {area_px:.4g} px" if area_px > 0 else f"{name}: out of sight"
        shown = self.in_view(part_pixels)
        if len(shown) > _MOST_NAMES:
            return f"{len(shown)} of {len(self.names)} parts in view"
        return f"in view: {', '.join(shown)}"
