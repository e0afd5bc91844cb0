"""Objects as data: a folder with object.toml and mesh.obj says everything about one.

spec = load_object("cylO")              # a built-in one
spec = load_object("path/to/mug")       # a folder of the same form
"""

import difflib
import hashlib
import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError, RotationError, UnknownObjectError
from symsol_annot.objects.mesh import Mesh
from symsol_annot.objects.obj_file import MAX_MESH_BYTES, parse_mesh, read_object_file
from symsol_annot.objects.object_toml import ObjectToml
from symsol_annot.rotations.groups import GROUP_KINDS, GroupParameter, left_cosets
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.text.names import OBJECT_NAME_RULE, is_object_name
from symsol_annot.system.text.toml import MAX_TOML_BYTES, TITLE_RULE, is_title, shown

OBJECT_FORMAT_VERSION = 1
MAX_GROUP_ORDER = 3600
_AXIS_LENGTHS = (1e-9, 1e9)  # within which its square, and so its direction, is a number


@dataclass(frozen=True)
class Marking:
    """What is painted on a body and breaks its symmetry.

    Attributes:
        stabiliser: (H, 3, 3) the rotations of the body's group that map the marking onto itself.
        tolerance_px: T; the marking counts as hidden where it covers less than this area of the image.
    """

    stabiliser: Rotations
    tolerance_px: float


@dataclass(frozen=True)
class ObjectSpec:
    """One object: its mesh, its body's symmetry group and its marking.

    Attributes:
        name: the name in file names and labels, by the rule in `names`.
        title: what it is, in words.
        digest: SHA-256 over the bytes of object.toml and mesh.obj that were read.
        folder: where it was read from; None where it was not read from a folder.
        mesh: the surface.
        symmetry_group: (G, 3, 3) C, the rotations that map the unmarked body onto itself, identity first.
        marking: None for a body without one.
    """

    name: str
    title: str
    digest: str
    folder: Path | None
    mesh: Mesh
    symmetry_group: Rotations
    marking: Marking | None

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
    """Return the names of the built-in objects, sorted."""
    return tuple(sorted(entry.name for entry in _assets().iterdir() if (entry / "object.toml").is_file()))


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
    """Read object.toml and mesh.obj of one folder.

    Raises:
        ObjectError: a file is missing or broken; the message names the field or the line.
    """
    toml_data = read_object_file(folder / "object.toml", MAX_TOML_BYTES)
    toml = ObjectToml(folder / "object.toml", toml_data)
    version = toml.take("format_version", int)
    if version != OBJECT_FORMAT_VERSION:
        raise toml.fault("format_version", f"expected {OBJECT_FORMAT_VERSION}, found {version}")
    name = toml.take("name", str)
    if not is_object_name(name):
        raise toml.fault("name", f"expected {OBJECT_NAME_RULE}, found {shown(name)}")
    title = toml.take("title", str)
    if not is_title(title):
        raise toml.fault("title", f"expected {TITLE_RULE}, found {shown(title)}")
    group = _read_group(toml, "body.group")
    mesh_data = read_object_file(folder / "mesh.obj", MAX_MESH_BYTES)
    mesh = parse_mesh(mesh_data, folder / "mesh.obj")
    marking = _read_marking(toml) if toml.has("marking") else None
    toml.refuse_unknown_fields()
    if bool(mesh.is_marking.any()) != (marking is not None):
        raise ObjectError(
            f"{folder}: mesh.obj has {'a' if marking is None else 'no'} face of the material 'marking', "
            f"while object.toml has {'no' if marking is None else 'a'} [marking] table; they must agree"
        )
    digest = hashlib.sha256()
    for data in (toml_data, mesh_data):
        digest.update(hashlib.sha256(data).digest())
    spec = ObjectSpec(name, title, digest.hexdigest(), folder, mesh, group, marking)
    try:
        _ = spec.cosets
    except RotationError as error:
        raise toml.fault("marking.stabiliser", f"is no subgroup of body.group: {error}") from None
    return spec


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
    stabiliser = _read_group(toml, "marking.stabiliser")
    tolerance_px = toml.take("marking.tolerance_px", float)
    if not 0.0 < tolerance_px < float("inf"):
        raise toml.fault("marking.tolerance_px", f"expected a positive number of pixels, found {tolerance_px}")
    if not toml.take("marking.any_part_fixes_rotation", bool):
        raise toml.fault(
            "marking.any_part_fixes_rotation",
            "is false, and such a marking (two equal dots, a long stripe) is not supported yet: "
            "its symmetry sets need a comparison of whole label images",
        )
    return Marking(stabiliser, tolerance_px)


def _read_group(toml: ObjectToml, field: str) -> Rotations:
    """Return the group that a table like { kind = "cyclic", order = 3, axis = [0, 0, 1] } names."""
    name = toml.take(f"{field}.kind", str)
    if name not in GROUP_KINDS:
        raise toml.fault(f"{field}.kind", f"expected one of {', '.join(GROUP_KINDS)}, found {name!r}")
    kind = GROUP_KINDS[name]
    given = [*kind.needs, *(parameter for parameter in kind.takes if toml.has(f"{field}.{parameter}"))]
    return kind.make(**{parameter: _PARAMETER_READERS[parameter](toml, f"{field}.{parameter}") for parameter in given})


def _read_order(toml: ObjectToml, field: str) -> int:
    order: int = toml.take(field, int)
    if not 1 <= order <= MAX_GROUP_ORDER:
        raise toml.fault(field, f"expected 1 to {MAX_GROUP_ORDER}, found {order}")
    return order


def _read_axis(toml: ObjectToml, field: str) -> list[float]:
    axis = toml.take(field, list)
    numbers = [float(x) for x in axis if isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)]
    if len(axis) != 3 or len(numbers) != 3 or not any(numbers):
        raise toml.fault(field, f"expected three finite numbers that are not all 0, found {shown(axis)}")
    least, most = _AXIS_LENGTHS
    if not least <= math.hypot(*numbers) <= most:
        raise toml.fault(field, f"expected an axis of a length from {least:g} to {most:g}, found {shown(axis)}")
    return numbers


_PARAMETER_READERS: dict[GroupParameter, Callable[[ObjectToml, str], Any]] = {"order": _read_order, "axis": _read_axis}
