"""The parts of an object of format version 2, as its object.toml lists them, and which of them break its symmetry."""

import colorsys
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.mesh import BODY_ID, Mesh
from symsol_annot.objects.object_toml import ObjectToml
from symsol_annot.objects.part_symmetries import carried_onto, stabiliser_of_part
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.text.names import OBJECT_NAME_RULE, is_object_name
from symsol_annot.system.text.toml import shown

Colour = tuple[float, float, float]  # linear RGB, from 0 to 1

MAX_PARTS = 255  # their ids are bytes, and 0 is the background's
BODY_COLOUR: Colour = (0.72, 0.80, 0.94)
MARKING_COLOUR: Colour = (0.95, 0.16, 0.04)
DEFAULT_TOLERANCE_PX = 0.125  # less than one of the 4 points of a pixel
_SAME_COLOUR = 0.02  # of linear RGB: under five of 255 levels where it is bright
MOST_OFFSET = 0.02  # radii: at 224 pixels, under two
_GOLDEN = (5**0.5 - 1.0) / 2.0  # of a turn of the hue from one part to the next: no two come close


@dataclass(frozen=True)
class Part:
    """A part of an object.

    Attributes:
        name: as segmentations and tables name it.
        material: of the mesh, whose faces it consists of.
        colour: linear RGB, from 0 to 1.
    """

    name: str
    material: str
    colour: Colour


@dataclass(frozen=True, eq=False)
class Breaking:
    """What breaks the symmetry of an object.

    Attributes:
        ids: of the parts that some rotation of the group does not map onto themselves, ascending.
        stabiliser: (G,) bool, the rotations of the group that map each part onto itself.
    """

    ids: tuple[int, ...]
    stabiliser: npt.NDArray[np.bool_]


def default_colour(number: int) -> Colour:
    """Return the colour of the part of a number, counted from 0, where an object.toml gives it none."""
    if number < 2:
        return (BODY_COLOUR, MARKING_COLOUR)[number]
    red, green, blue = colorsys.hsv_to_rgb((0.3 + number * _GOLDEN) % 1.0, 0.9, 0.8)
    return round(red, 3), round(green, 3), round(blue, 3)


def read_parts(toml: ObjectToml) -> tuple[Part, ...]:
    """Return the parts that the tables `[[part]]` list.

    Raises:
        ObjectError: there are none or too many, or one has no name, no material, a colour that is none, or the name or
            the material of another.
    """
    count = toml.count("part")
    if not 1 <= count <= MAX_PARTS:
        raise toml.fault(
            "part", f"expected 1 to {MAX_PARTS} tables [[part]], the first of them the body, found {count}"
        )
    parts = tuple(_read_part(toml, number) for number in range(count))
    _refuse_repeated(toml, "name", [part.name for part in parts], "has the name")
    materials = [part.material for part in parts]
    _refuse_repeated(toml, "select.material", materials, "selects the same faces, those of the material")
    return parts


def read_of(toml: ObjectToml) -> tuple[str, ...]:
    """Return the names of the parts whose group is declared: `symmetry.of`, the first part where that is not given.

    None are named where no part has the whole group by itself, as a mug of one shell has no circle: each may break it.

    Raises:
        ObjectError: one of them is no part.
    """
    names = [toml.take(f"part.{number}.name", str) for number in range(toml.count("part"))]
    of = toml.take("symmetry.of", list) if toml.has("symmetry.of") else names[:1]
    if not all(isinstance(name, str) and name in names for name in of) or len(set(of)) < len(of):
        raise toml.fault("symmetry.of", f"expected names of parts ({', '.join(names)}), found {shown(of)}")
    return tuple(of)


def read_tolerance(toml: ObjectToml) -> float:
    """Return T of the general rule in pixels: `equality.tolerance_px`, or its default.

    Raises:
        ObjectError: it is no area.
    """
    if not toml.has("equality.tolerance_px"):
        return DEFAULT_TOLERANCE_PX
    tolerance_px: float = toml.take("equality.tolerance_px", float)
    if not 0.0 < tolerance_px < float("inf"):
        raise toml.fault("equality.tolerance_px", f"expected a positive number of pixels, found {tolerance_px}")
    return tolerance_px


def read_max_offset(toml: ObjectToml) -> float:
    """Return `symmetry.max_offset`: how far the group may carry the surface off itself, in radii; 0 if not given.

    Raises:
        ObjectError: it is no length, or so long that the shape would be another one.
    """
    if not toml.has("symmetry.max_offset"):
        return 0.0
    offset: float = toml.take("symmetry.max_offset", float)
    if not 0.0 <= offset <= MOST_OFFSET:
        raise toml.fault("symmetry.max_offset", f"expected 0 to {MOST_OFFSET} of the radius, found {offset}")
    return offset


def read_mesh_name(toml: ObjectToml) -> str:
    """Return the name of the mesh's file in the object's folder: `mesh.file`, or mesh.obj.

    Raises:
        ObjectError: it is no name of an OBJ file.
    """
    name: str = toml.take("mesh.file", str) if toml.has("mesh.file") else "mesh.obj"
    if not is_object_name(name.removesuffix(".obj")) or not name.endswith(".obj"):
        raise toml.fault("mesh.file", f"expected the name of an .obj file in the object's folder, found {shown(name)}")
    return name


def refuse_unseen_parts(toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...]) -> None:
    """Refuse parts of which no picture could show anything.

    Raises:
        ObjectError: a part has no faces, or is closed and inside out, or painted on another in its colour.
    """
    for number, part in enumerate(parts):
        if not (mesh.part_ids == BODY_ID + number).any():
            raise toml.fault(
                f"part.{number}.select.material", f"selects nothing: no face has the material {shown(part.material)}"
            )
    _refuse_inside_out(toml, mesh, parts)
    _refuse_unseen_paint(toml, mesh, parts)


def breaking_parts(
    toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...], of: tuple[str, ...], group: Rotations
) -> Breaking:
    """Return which parts break the group (G, 3, 3) of the parts named `of`, and what leaves all of them in place.

    Raises:
        ObjectError: the group carries one breaking part onto another of the same colour.
    """
    others = [BODY_ID + number for number, part in enumerate(parts) if part.name not in of]
    kept = {part: stabiliser_of_part(mesh.triangles_of(part), group) for part in others}
    ids = tuple(part for part, mask in kept.items() if not mask.all())
    _refuse_look_alikes(toml, mesh, parts, ids, group)
    stabiliser = np.ones(len(group), dtype=bool)
    for breaking in ids:
        stabiliser &= kept[breaking]
    return Breaking(ids, stabiliser)


def _refuse_inside_out(toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...]) -> None:
    """Refuse a part that is a closed surface of its own and faces inwards: nobody would see it."""
    for number, part in enumerate(parts):
        corners = mesh.triangles[mesh.part_ids == BODY_ID + number]
        sides = np.stack([corners, np.roll(corners, -1, axis=1)], axis=-1).reshape(-1, 2)
        is_closed = set(map(tuple, sides.tolist())) == set(map(tuple, sides[:, ::-1].tolist()))
        a, b, c = np.moveaxis(mesh.vertices[corners], 1, 0)
        if is_closed and float((a * np.cross(b, c)).sum()) <= 0:
            raise toml.fault(
                f"part.{number}.name",
                f"the faces of {part.name!r} look inwards; wind them counter-clockwise seen from outside",
            )


def _refuse_look_alikes(
    toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...], ids: tuple[int, ...], group: Rotations
) -> None:
    """Refuse parts that the eye cannot tell apart: images are compared part by part."""
    for place, first in enumerate(ids):
        for second in ids[place + 1 :]:
            one, other = parts[first - BODY_ID], parts[second - BODY_ID]
            if (
                one.colour == other.colour
                and carried_onto(mesh.triangles_of(first), mesh.triangles_of(second), group).any()
            ):
                raise toml.fault(
                    f"part.{second - BODY_ID}.name",
                    f"{other.name!r} looks like {one.name!r}: a rotation of the group carries one onto the other, and "
                    "they have one colour. Make them one part, or give them different colours",
                )


def _refuse_unseen_paint(toml: ObjectToml, mesh: Mesh, parts: tuple[Part, ...]) -> None:
    """Refuse a part that is painted on another in its colour: labels would tell what no picture shows."""
    part_of = {}
    meeting = set()
    for part, corners in zip(mesh.part_ids.tolist(), mesh.triangles.tolist(), strict=True):
        for start, end in zip(corners, corners[1:] + corners[:1], strict=True):
            part_of[start, end] = part
            other = part_of.get((end, start), part)
            if other != part:
                meeting.add((min(part, other), max(part, other)))
    for first, second in sorted(meeting):
        one, other = parts[first - BODY_ID], parts[second - BODY_ID]
        if max(abs(a - b) for a, b in zip(one.colour, other.colour, strict=True)) < _SAME_COLOUR:
            raise toml.fault(
                f"part.{second - BODY_ID}.colour",
                f"{other.name!r} is painted on {one.name!r} in its colour, so that no picture shows where; give it "
                "another colour, or make them one part",
            )


def _refuse_repeated(toml: ObjectToml, field: str, values: list[str], what: str) -> None:
    for number, value in enumerate(values):
        first = values.index(value)
        if first < number:
            raise toml.fault(f"part.{number}.{field}", f"{what} {shown(value)}, as part {first} does")


def _read_part(toml: ObjectToml, number: int) -> Part:
    name = toml.take(f"part.{number}.name", str)
    if not is_object_name(name):
        raise toml.fault(f"part.{number}.name", f"expected {OBJECT_NAME_RULE}, found {shown(name)}")
    material = toml.take(f"part.{number}.select.material", str)
    if material != " ".join(material.split()) or not material or not material.isprintable():
        raise toml.fault(
            f"part.{number}.select.material", f"expected the name of a material of the mesh, found {shown(material)}"
        )
    field = f"part.{number}.colour"
    return Part(name, material, _read_colour(toml, field) if toml.has(field) else default_colour(number))


def _read_colour(toml: ObjectToml, field: str) -> Colour:
    colour = toml.take(field, list)
    numbers = [float(x) for x in colour if isinstance(x, int | float) and not isinstance(x, bool) and 0 <= x <= 1]
    if len(colour) != 3 or len(numbers) != 3:
        raise toml.fault(field, f"expected three numbers from 0 to 1, the linear RGB, found {shown(colour)}")
    return numbers[0], numbers[1], numbers[2]
