"""Writing an object's folder, object.toml and mesh.obj, whole or not at all; and what of a folder is this program's."""

import contextlib
import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TypeAlias

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import OutputError, output_errors
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.finding.found import CIRCLE, CIRCLE_WITH_HALF_TURNS, Group
from symsol_annot.objects.parts import DEFAULT_TOLERANCE_PX, Colour
from symsol_annot.objects.spec import ObjectSpec, read_object
from symsol_annot.rotations.groups import ALL_ROTATIONS, CIRCLE_STEPS
from symsol_annot.system.checksums import changed_in, names_in, read_list, to_list
from symsol_annot.system.files import new_folder, replaced_folder
from symsol_annot.system.text.toml import MAX_TITLE

Note: TypeAlias = str | float | int | Sequence[str] | Sequence[float]

LIST_NAME = "files.sha256"
_EXACT = 1e-6  # of max_offset: what an object has without one
_MADE_BY = "symsol-annot import-object"


@dataclass(frozen=True, eq=False)
class ObjectDraft:
    """An object that is about to be written.

    Attributes:
        name: of the object.
        source: what it is made from, for its title.
        vertices: (V, 3) f8 in the object's frame, touching the unit sphere.
        triangles: (T, 3) indices of vertices.
        part_of: (T,) indices of `part_names`.
        part_names: of the parts, the body's first.
        colours: linear RGB of the parts; None for the default ones.
        of_body: whether the body has the group by itself; else all parts may break it.
        group: whose axes are those of its kind in the object's frame; a circle is written by steps.
        max_offset: how far the group may carry the body off itself, in radii; 0 where it is exact.
        steps: by how many a circle is written; None for CIRCLE_STEPS.
        provenance: what was done to the mesh.
    """

    name: str
    source: str
    vertices: npt.NDArray[np.float64]
    triangles: npt.NDArray[np.intp]
    part_of: npt.NDArray[np.intp]
    part_names: tuple[str, ...]
    colours: tuple[Colour, ...] | None
    of_body: bool
    group: Group
    max_offset: float
    steps: int | None
    provenance: Mapping[str, Note]


def object_files(draft: ObjectDraft) -> dict[str, bytes]:
    """Return the bytes of object.toml, in format version 2, and of mesh.obj."""
    return {"object.toml": _toml_text(draft).encode(), "mesh.obj": _obj_text(draft).encode("ascii")}


@contextlib.contextmanager
def written_object(folder: Path, files: Mapping[str, bytes]) -> Iterator[tuple[Path, ObjectSpec]]:
    """Write an object, read it again and check it; it gets its name when the block ends, and goes at an error.

    Args:
        folder: where it goes. One that is there is replaced if this program made all that is in it.
        files: name to bytes.

    Yields:
        the folder for now, into which more files may be put, and the object in it.

    Raises:
        ObjectError: what was written is no object, or has not the symmetries that it declares.
        OutputError: the folder holds what this program did not make, or cannot be written.
    """
    is_there = _refuse_foreign(folder)
    writing = replaced_folder if is_there else new_folder
    with output_errors(folder), writing(folder) as made:
        for name, data in files.items():
            (made / name).write_bytes(data)
        spec = read_object(made)
        check_object(spec)
        yield made, spec
        digests = {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in made.iterdir()}
        (made / LIST_NAME).write_bytes(to_list(digests, _MADE_BY))


def _refuse_foreign(folder: Path) -> bool:
    """Refuse a folder that holds what this program did not make; tell whether there is one that it made."""
    with output_errors(folder):
        if not folder.is_symlink() and not folder.exists():
            return False
        if folder.is_dir() and not folder.is_symlink():
            there = names_in(folder)
            if not there:
                return False
            listed = read_list(folder / LIST_NAME, _MADE_BY)
            if listed is not None and there - {LIST_NAME} <= set(listed) and not changed_in(folder, listed):
                return True
    raise OutputError(
        f"{folder}: is there already, and holds what `symsol-annot import-object` did not write, or what was changed "
        "since; nothing was touched: give the name of a new folder"
    )


def _toml_text(draft: ObjectDraft) -> str:
    title = f"made from {draft.source}"[:MAX_TITLE]
    lines = ["format_version = 2", f"name = {_toml(draft.name)}", f"title = {_toml(title)}"]
    for number, name in enumerate(draft.part_names):
        lines += ["", "[[part]]", f"name = {_toml(name)}", f"select = {{ material = {_toml(name)} }}"]
        if draft.colours is not None:
            lines.append(f"colour = {_toml(draft.colours[number])}")
    lines += ["", "[symmetry]", f"of = {_toml(draft.part_names[:1] if draft.of_body else ())}", *_group_lines(draft)]
    lines += ["", "[equality]", f"tolerance_px = {DEFAULT_TOLERANCE_PX}", "", "[provenance]"]
    lines += [f"{key} = {_toml(value)}" for key, value in draft.provenance.items()]
    return "\n".join(lines) + "\n"


def _group_lines(draft: ObjectDraft) -> list[str]:
    group = draft.group
    kinds = {CIRCLE: "cyclic", CIRCLE_WITH_HALF_TURNS: "dihedral"}
    lines = [f'kind = "{kinds.get(group.kind, group.kind)}"']
    is_circle = group.is_continuous and group.kind != ALL_ROTATIONS
    order = (draft.steps or CIRCLE_STEPS) if is_circle else group.order
    lines += [] if order is None else [f"order = {order}"]
    return [*lines, f"max_offset = {draft.max_offset:.2g}"] if draft.max_offset > _EXACT else lines


def _toml(value: Note) -> str:
    """Return a value as TOML writes it; of a text, what is not printable as a question mark."""
    if isinstance(value, str):
        return json.dumps("".join(c if c.isprintable() else "?" for c in value), ensure_ascii=False)
    if isinstance(value, float | int):
        return repr(value)
    return f"[{', '.join(_toml(one) for one in value)}]"


def _obj_text(draft: ObjectDraft) -> str:
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in draft.vertices.tolist()]
    for part, name in enumerate(draft.part_names):
        lines.append(f"usemtl {name}")
        lines += [f"f {a} {b} {c}" for a, b, c in (draft.triangles[draft.part_of == part] + 1).tolist()]
    return "\n".join(lines) + "\n"
