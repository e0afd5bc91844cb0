"""Objects as data: a folder with object.toml and a mesh says everything about one.

spec = load_object("cylO")              # a built-in one
spec = load_object("path/to/mug")       # a folder of the same form
"""

import difflib
import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import resources
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError, RotationError, UnknownObjectError
from symsol_annot.objects.all_rotations import declares_all_rotations, turns_of_parts
from symsol_annot.objects.group_toml import read_group
from symsol_annot.objects.mesh import Mesh
from symsol_annot.objects.obj_file import MAX_MESH_BYTES, parse_mesh, read_object_file
from symsol_annot.objects.object_toml import ObjectToml
from symsol_annot.objects.parts import (
    BODY_COLOUR,
    MARKING_COLOUR,
    Part,
    breaking_parts,
    read_max_offset,
    read_mesh_name,
    read_of,
    read_parts,
    read_tolerance,
    refuse_unseen_parts,
)
from symsol_annot.rotations.groups import left_cosets
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.text.names import OBJECT_NAME_RULE, is_object_name
from symsol_annot.system.text.toml import MAX_TOML_BYTES, TITLE_RULE, is_title, shown

OBJECT_FORMAT_VERSIONS = (1, 2)
_UNIT_SLACK = 1e-6  # of a vertex's distance from the origin
PUBLISHED_NAMES = ("tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO")  # of the benchmark; others ship beside them


@dataclass(frozen=True)
class Marking:
    """What breaks a body's symmetry: what is painted on it or, in format version 2, every part that does.

    Attributes:
        stabiliser: (H, 3, 3) the rotations of the body's group that map the marking onto itself, part by part.
        tolerance_px: T; the marking counts as hidden where it covers less than this area of the image. By the general
            rule, images are the same that differ by less than this area.
    """

    stabiliser: Rotations
    tolerance_px: float


@dataclass(frozen=True)
class ObjectSpec:
    """One object: its mesh, its body's symmetry group and its marking.

    Attributes:
        name: the name in file names and labels, by the rule in `names`.
        title: what it is, in words.
        digest: SHA-256 over the bytes of object.toml and of the mesh that were read.
        folder: where it was read from; None where it was not read from a folder.
        mesh: the surface.
        symmetry_group: (G, 3, 3) C, the rotations that map the unmarked body onto itself, identity first; where those
            are all of SO(3), the ones that keep a part in place, which are the candidates beside a volume.
        marking: None for a body without one.
        parts: all of them in the order of their ids, the body first, whose id is 1.
        has_general_rule: whether its symmetry sets follow from a comparison of images, as those of format version 2;
            else from whether the marking shows.
        max_offset: how far the group may carry the surface off itself, in radii, for it to count as having the group:
            so a body of facets counts as round. 0 where none is stated.
        kept_by_turns: (B, G) bool of a ball, which of `symmetry_group` keep each of `mesh.breaking` in place; None of a
            body with another group.
    """

    name: str
    title: str
    digest: str
    folder: Path | None
    mesh: Mesh
    symmetry_group: Rotations
    marking: Marking | None
    parts: tuple[Part, ...]
    has_general_rule: bool = False
    max_offset: float = 0.0
    kept_by_turns: npt.NDArray[np.bool_] | None = None

    @property
    def has_all_rotations(self) -> bool:
        """Whether every rotation maps the unmarked body onto itself, so that sets can fill a volume."""
        return self.kept_by_turns is not None

    @cached_property
    def is_ball(self) -> bool:
        """Whether the surface stands for the unit sphere: it has all rotations, and no part stands out of it."""
        radii = np.linalg.norm(self.mesh.vertices, axis=1)
        return self.has_all_rotations and bool(radii.min() >= 1.0 - 2.0 * self.max_offset - _UNIT_SLACK)

    @property
    def stabiliser(self) -> Rotations:
        """The (H, 3, 3) rotations that map body and marking onto themselves; all of C without a marking."""
        return self.symmetry_group if self.marking is None else self.marking.stabiliser

    @property
    def tolerance_px(self) -> float | None:
        """T, the area from which the marking counts as shown; None without a marking, which shows nowhere."""
        return None if self.marking is None else self.marking.tolerance_px

    @cached_property
    def cosets(self) -> npt.NDArray[np.intp]:
        """The (G / H, H) indices into `symmetry_group` of the stabiliser's left cosets; row 0 is the stabiliser."""
        if self.marking is None:
            return np.arange(len(self.symmetry_group), dtype=np.intp)[None]
        return left_cosets(self.symmetry_group, self.marking.stabiliser)


def builtin_names() -> tuple[str, ...]:
    """Return the names of the built-in objects, sorted: those of `PUBLISHED_NAMES`, and what ships beside them."""
    return tuple(sorted(entry.name for entry in _assets().iterdir() if (entry / "object.toml").is_file()))


def is_builtin(spec: ObjectSpec) -> bool:
    """Tell whether an object is one of those that the package has."""
    return spec.folder is not None and spec.folder.parent == _assets()


def load_object(name_or_folder: str) -> ObjectSpec:
    """Return a built-in object by its name, or the object in a folder by its path.

    Raises:
        UnknownObjectError: there is no such object.
        ObjectError: its files are broken.
    """
    if name_or_folder in builtin_names():
        return read_object(_assets() / name_or_folder)
    folder = Path(name_or_folder)
    try:
        is_folder = name_or_folder != "" and folder.is_dir()
    except OSError as error:
        raise UnknownObjectError(f"{folder}: cannot be read: {error.strerror}") from None
    if is_folder:
        return read_object(folder)
    raise UnknownObjectError(_unknown_object(name_or_folder))


def read_object(folder: Path) -> ObjectSpec:
    """Read object.toml and the mesh of one folder.

    Raises:
        ObjectError: a file is missing or broken; the message names the field or the line.
    """
    toml_data = read_object_file(folder / "object.toml", MAX_TOML_BYTES)
    toml = ObjectToml(folder / "object.toml", toml_data)
    version = toml.take("format_version", int)
    if version not in OBJECT_FORMAT_VERSIONS:
        raise toml.fault("format_version", f"expected {' or '.join(map(str, OBJECT_FORMAT_VERSIONS))}, found {version}")
    name = toml.take("name", str)
    if not is_object_name(name):
        raise toml.fault("name", f"expected {OBJECT_NAME_RULE}, found {shown(name)}")
    title = toml.take("title", str)
    if not is_title(title):
        raise toml.fault("title", f"expected {TITLE_RULE}, found {shown(title)}")
    read = _read_marked if version == 1 else _read_parted
    return read(folder, toml, (name, title), hashlib.sha256(toml_data).digest())


def _read_marked(folder: Path, toml: ObjectToml, names: tuple[str, str], toml_digest: bytes) -> ObjectSpec:
    """Read the rest of an object of format version 1: a body and, perhaps, a marking."""
    group = read_group(toml, "body.group")
    mesh_data = read_object_file(folder / "mesh.obj", MAX_MESH_BYTES)
    mesh = parse_mesh(mesh_data, folder / "mesh.obj")
    marking = _read_marking(toml) if toml.has("marking") else None
    toml.refuse_unknown_fields()
    if bool(mesh.is_marking.any()) != (marking is not None):
        raise ObjectError(
            f"{folder}: mesh.obj has {'a' if marking is None else 'no'} face of the material 'marking', "
            f"while object.toml has {'no' if marking is None else 'a'} [marking] table; they must agree"
        )
    digest = hashlib.sha256(toml_digest + hashlib.sha256(mesh_data).digest()).hexdigest()
    parts = (Part("body", "body", BODY_COLOUR), Part("marking", "marking", MARKING_COLOUR))[: mesh.parts]
    spec = ObjectSpec(*names, digest, folder, mesh, group, marking, parts)
    try:
        _ = spec.cosets
    except RotationError as error:
        raise toml.fault("marking.stabiliser", f"is no subgroup of body.group: {error}") from None
    return spec


def _read_parted(folder: Path, toml: ObjectToml, names: tuple[str, str], toml_digest: bytes) -> ObjectSpec:
    """Read the rest of an object of format version 2: parts, and the group of those that do not break it."""
    parts, of = read_parts(toml), read_of(toml)
    if toml.has("symmetry.group"):
        raise toml.fault(
            "symmetry.group",
            "is not read: state kind, order and axis, as `symsol-annot symmetries MESH` finds them",
        )
    has_all_rotations = declares_all_rotations(toml)
    group = np.eye(3)[None] if has_all_rotations else read_group(toml, "symmetry")
    tolerance_px, max_offset = read_tolerance(toml), read_max_offset(toml)
    path = folder / read_mesh_name(toml)
    toml.refuse_unknown_fields()
    mesh_data = read_object_file(path, MAX_MESH_BYTES)
    mesh = parse_mesh(mesh_data, path, tuple(part.material for part in parts))
    digest = hashlib.sha256(toml_digest + hashlib.sha256(mesh_data).digest()).hexdigest()
    refuse_unseen_parts(toml, mesh, parts)
    if has_all_rotations:
        turns = turns_of_parts(toml, mesh, parts, of)
        group, ids, stabiliser, kept = turns.candidates, turns.ids, turns.kept.all(axis=0), turns.kept
    else:
        found = breaking_parts(toml, mesh, parts, of, group)
        ids, stabiliser, kept = found.ids, found.stabiliser, None
    mesh = replace(mesh, breaking=ids)
    marking = Marking(group[stabiliser], tolerance_px) if ids else None
    return ObjectSpec(
        *names,
        digest,
        folder,
        mesh,
        group,
        marking,
        parts,
        has_general_rule=True,
        max_offset=max_offset,
        kept_by_turns=kept,
    )


def _assets() -> Path:
    return Path(str(resources.files("symsol_annot_assets")))


def _unknown_object(name: str) -> str:
    names = builtin_names()
    by_lower = {known.lower(): known for known in names}
    nearest = difflib.get_close_matches(name.lower(), by_lower, n=2, cutoff=0.6)
    hint = f" Did you mean {' or '.join(repr(by_lower[near]) for near in nearest)}?" if nearest else ""
    return (
        f"unknown object {shown(name)}.{hint} Built-in objects are {', '.join(names)}; "
        "an object of your own is given by the path of its folder"
    )


def _read_marking(toml: ObjectToml) -> Marking:
    stabiliser = read_group(toml, "marking.stabiliser")
    tolerance_px = toml.take("marking.tolerance_px", float)
    if not 0.0 < tolerance_px < float("inf"):
        raise toml.fault("marking.tolerance_px", f"expected a positive number of pixels, found {tolerance_px}")
    if not toml.take("marking.any_part_fixes_rotation", bool):
        raise toml.fault(
            "marking.any_part_fixes_rotation",
            "is false, and such a marking (two equal dots, a long stripe) needs a comparison of whole images: "
            "make the marking a [[part]] of an object.toml of format version 2, as docs/objects.md shows",
        )
    return Marking(stabiliser, tolerance_px)
