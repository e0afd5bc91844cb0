"""What a mesh file tells its parts by: materials, colours, nodes of its scene, components that hang together."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from symsol_annot.errors import ObjectError, first_of
from symsol_annot.objects.mesh_files.face_colours import nearby_joined, to_linear, unpacked
from symsol_annot.objects.mesh_files.mesh_file import MIXED_COLOURS, NO_COLOUR, Indices, MeshFile
from symsol_annot.objects.parts import MAX_PARTS, Colour

PARTS_CHOICES = ("auto", "material", "colour", "node", "component", "none")
WHOLE = "body"  # the name of the only part
_SHOWN = 5


@dataclass(frozen=True, eq=False)
class Parting:
    """The parts of a mesh's triangles.

    Attributes:
        part_of: (T,) indices of `names`.
        names: of the parts, each another, that an object.toml may have.
        colours: linear RGB of each part; None for all of them where two would look alike, or the file has none.
        by: what tells them: "material", "colour", "node", "component" or "none".
    """

    part_of: Indices
    names: tuple[str, ...]
    colours: tuple[Colour, ...] | None
    by: str


def parted(file: MeshFile, by: str, path: Path) -> Parting:
    """Return the parts of a mesh file's triangles; of components, which are known later, one for all.

    Args:
        file: the mesh.
        by: one of PARTS_CHOICES. "auto" takes materials where there are several, else colours, else nodes.
        path: of the file, for messages.

    Raises:
        ObjectError: what should tell the parts does not: a face has several colours, or there are too many.
    """
    if by in {"component", "none"}:
        return Parting(np.zeros(len(file.triangles), dtype=np.intp), (WHOLE,), _colours_of(file, None, 1), by)
    if by == "material" or (by == "auto" and len(file.materials) > 1):
        return _named(file, file.material_of, [material.name for material in file.materials], "material", path)
    colours = _by_colour(file, path) if by in {"auto", "colour"} else None
    if colours is not None and (by == "colour" or len(colours.names) > 1):
        return colours
    if by == "node" or len(file.nodes) > 1:
        return _named(file, file.node_of, file.nodes, "node", path)
    return parted(file, "none", path)


def part_names(names: Sequence[str], otherwise: str) -> tuple[str, ...]:
    """Return names that parts of an object may have, each another, made of those of a file."""
    found: list[str] = []
    for number, name in enumerate(names):
        plain = as_object_name(name) or f"{otherwise}-{number + 1}"
        unique, count = plain, 1
        while unique in found:
            count += 1
            unique = f"{plain[:58]}-{count}"
        found.append(unique)
    return tuple(found)


def as_object_name(text: str) -> str:
    """Return a text as the name of an object or a part, with - for what such a name may not hold; it may be empty."""
    return "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "-" for c in text).strip("_-")[:64]


def _named(file: MeshFile, label_of: Indices, names: Sequence[str], by: str, path: Path) -> Parting:
    _refuse_too_many(len(names), f"{by}s", path)
    if len(names) == 1:
        return Parting(label_of, (as_object_name(names[0]) or WHOLE,), _colours_of(file, label_of, 1), by)
    return Parting(label_of, part_names(names, by), _colours_of(file, label_of, len(names)), by)


def _by_colour(file: MeshFile, path: Path) -> Parting | None:
    """Return the parts by the colours of the faces; None where no face has one."""
    missing = [material.missing_texture for material in file.materials if material.missing_texture]
    if missing:
        raise ObjectError(
            f"{path}: the texture {missing[0]!r}, which tells its parts, is not beside it, or is no picture; put it "
            "there, or import the mesh without its colours: --parts none"
        )
    if (file.colour_of == NO_COLOUR).all():
        return None
    mixed = np.flatnonzero(file.colour_of == MIXED_COLOURS)
    if len(mixed):
        raise ObjectError(
            f"{path}: {len(mixed):,} of its {len(file.colour_of):,} faces have several colours each, the first of them "
            f"face {mixed[0] + 1}, and a part is made of whole faces: cut the mesh along the edges of the colours, and "
            "give each face one (in Blender: a material per colour); or import the mesh without its colours: "
            "--parts none"
        )
    corners = file.vertices[file.triangles]
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    colour_of = nearby_joined(file.colour_of, areas, MAX_PARTS) if _has_texture(file) else file.colour_of
    known, label_of = np.unique(colour_of, return_inverse=True)
    _refuse_too_many(len(known), "colours", path)
    names = ["uncoloured" if one == NO_COLOUR else "colour-{:02x}{:02x}{:02x}".format(*unpacked(one)) for one in known]
    colours = None if NO_COLOUR in known else tuple(to_linear(int(one)) for one in known)
    return Parting(np.asarray(label_of, dtype=np.intp), tuple(names), colours, "colour")


def _has_texture(file: MeshFile) -> bool:
    return any(material.name for material in file.materials)


def _colours_of(file: MeshFile, label_of: Indices | None, count: int) -> tuple[Colour, ...] | None:
    """Return each part's colour, if all have one and no two have the same."""
    found: list[Colour] = []
    for label in range(count):
        is_of_it = np.ones(len(file.triangles), dtype=bool) if label_of is None else label_of == label
        colours = np.unique(file.colour_of[is_of_it])
        materials = {file.materials[index].colour for index in np.unique(file.material_of[is_of_it])}
        given = materials.pop() if len(materials) == 1 else None
        if len(colours) == 1 and colours[0] >= 0:
            given = to_linear(int(colours[0]))
        if given is None or given in found:
            return None
        found.append(given)
    return tuple(found)


def _refuse_too_many(count: int, what: str, path: Path) -> None:
    if count > MAX_PARTS:
        raise ObjectError(
            f"{path}: has {count:,} {what}, and an object at most {MAX_PARTS} parts; join those that belong together, "
            "or import the mesh as one part: --parts none"
        )


def body_index(names: Sequence[str], areas: Sequence[float], body: str | None, path: Path) -> int:
    """Return which part is the body: the one that is named, else the largest by its area.

    Raises:
        ObjectError: there is no part of that name.
    """
    if body is None:
        return int(np.argmax(areas))
    if body not in names:
        raise ObjectError(f"{path}: has no part {body!r} that could be the body; its parts are {_list(names)}")
    return list(names).index(body)


def _list(names: Sequence[str]) -> str:
    return first_of([repr(name) for name in names], _SHOWN)
