"""Writing an object's folder, object.toml and mesh.obj, from a surface and the symmetries that were found."""

from pathlib import Path

import numpy as np

from symsol_annot.errors import ObjectError, OutputError, output_errors
from symsol_annot.objects.finding.found import Group, Symmetries
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.objects.spec import ObjectSpec, read_object
from symsol_annot.rotations.groups import GROUP_KINDS
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.files import new_folder

_DIGITS = 12
_MOST_PARTS = 2  # of format version 1
_SAME = 1e-6


def write_object(folder: Path, name: str, title: str, surface: Surface, found: Symmetries) -> ObjectSpec:
    """Write a surface as an object of format version 1, and read it again.

    The surface is moved, turned and scaled: the group's fixed point to the origin, its axes to those of its kind, the
    farthest corner to the unit sphere.

    Args:
        folder: that does not exist yet.
        name: of the object.
        title: of the object, in words.
        surface: with one part, the body, or two, the body and its marking.
        found: its symmetries.

    Raises:
        ObjectError: format version 1 cannot say this, or the mesh is not closed.
        OutputError: the folder is there already, or cannot be written.
    """
    if folder.exists():
        raise OutputError(f"{folder}: is there already; nothing was touched: give the name of a new folder")
    files = object_files(name, title, surface, found)
    with output_errors(folder), new_folder(folder) as made:
        for file, text in files.items():
            (made / file).write_text(text, encoding="utf-8")
        read_object(made)
    return read_object(folder)


def object_files(name: str, title: str, surface: Surface, found: Symmetries) -> dict[str, str]:
    """Return the texts of object.toml and mesh.obj.

    Raises:
        ObjectError: format version 1 cannot say this.
    """
    group = found.shape.group
    if len(surface.part_names) > _MOST_PARTS:
        raise ObjectError(
            f"format version 1 has a body and one marking, the mesh has {len(surface.part_names)} parts: "
            f"{', '.join(surface.part_names)}; join those that look alike"
        )
    if group.is_continuous:
        raise ObjectError(
            f"format version 1 has no {group.name}; write the mesh as it is, or give it 360 facets about its axis"
        )
    lines = ["format_version = 1", f'name = "{name}"', f'title = "{title}"', "", "[body.group]", *_group_lines(group)]
    if len(surface.part_names) == _MOST_PARTS:
        stabiliser = found.parts[1].stabiliser
        lines += [
            *("", "[marking]", "tolerance_px = 0.125"),
            "# true if any part of the marking that shows, however small, fixes the rotation up to the stabiliser;",
            "# this was not looked at",
            *("any_part_fixes_rotation = false", "", "[marking.stabiliser]"),
            *_subgroup_lines(stabiliser, group),
        ]
    lines += ["", "[provenance]", f"residual = {found.shape.residual:.3g}", f"tolerance = {found.tolerance:g}"]
    return {"object.toml": "\n".join(lines) + "\n", "mesh.obj": _obj_text(surface, found)}


def _group_lines(group: Group) -> list[str]:
    """Return the fields of a group whose axes are those of its kind."""
    lines = [f'kind = "{group.kind}"']
    return lines if group.order is None else [*lines, f"order = {group.order}"]


def _subgroup_lines(subgroup: Group, group: Group) -> list[str]:
    """Return the fields of a stabiliser in the frame of the group; a cyclic one may have any axis."""
    frame = group.frame.T @ subgroup.frame
    if subgroup.kind == "cyclic":
        x, y, z = (round(float(value), _DIGITS) + 0.0 for value in frame[:, 2])
        return [*_group_lines(subgroup), f"axis = [{x!r}, {y!r}, {z!r}]"]
    standard = GROUP_KINDS[subgroup.kind].make(**({} if subgroup.order is None else {"order": subgroup.order}))
    if not _is_same_group(frame @ standard @ frame.T, standard):
        raise ObjectError(
            f"the marking's stabiliser is {subgroup.name} about axes that format version 1 cannot name: only cyclic "
            "groups have an axis there"
        )
    return _group_lines(subgroup)


def _is_same_group(elements: Rotations, others: Rotations) -> bool:
    nearest = (elements.reshape(-1, 9) @ others.reshape(-1, 9).T).max(axis=1)
    return len(elements) == len(others) and bool((nearest > 3.0 - _SAME).all())


def _obj_text(surface: Surface, found: Symmetries) -> str:
    vertices = (surface.vertices - found.shape.centre) @ found.shape.group.frame
    vertices = np.round(vertices / np.linalg.norm(vertices, axis=1).max(), _DIGITS) + 0.0
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in vertices.tolist()]
    for part, material in zip(range(len(surface.part_names)), ("body", "marking"), strict=False):
        triangles = surface.triangles[surface.part_of == part] + 1
        lines += [f"usemtl {material}", *(f"f {a} {b} {c}" for a, b, c in triangles.tolist())]
    return "\n".join(lines) + "\n"
