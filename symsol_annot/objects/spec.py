"""Objects as data: a folder with object.toml and mesh.obj says everything about one.

spec = load_object("cylO")              # a built-in one
spec = load_object("path/to/mug")       # a folder of the same form
"""

import difflib
import hashlib
import math
import re
from dataclasses import dataclass
from functools import cached_property
from importlib import resources
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import ObjectError, RotationError, UnknownObjectError
from symsol_annot.objects.mesh import MAX_MESH_BYTES, Mesh, parse_mesh, read_object_file
from symsol_annot.rotations import so3
from symsol_annot.system.text.names import OBJECT_NAME_RULE, is_object_name
from symsol_annot.system.text.toml import MAX_TOML_BYTES, TITLE_RULE, is_title, parse_toml, shown

OBJECT_FORMAT_VERSION = 1
MAX_GROUP_ORDER = 3600
_AXIS_LENGTHS = (1e-9, 1e9)  # within which its square, and so its direction, is a number


_Field: TypeAlias = tuple[str, ...]  # the keys that lead to a value


@dataclass(frozen=True)
class Marking:
    """What is painted on a body and breaks its symmetry.

    Attributes:
        stabiliser: (H, 3, 3) the rotations of the body's group that map the marking onto itself.
        tolerance_px: T; the marking counts as hidden where it covers less than this area of the image.
    """

    stabiliser: so3.Rotations
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
    symmetry_group: so3.Rotations
    marking: Marking | None

    @property
    def stabiliser(self) -> so3.Rotations:
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
        return so3.left_cosets(self.symmetry_group, self.marking.stabiliser)


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
    toml = _Toml(folder / "object.toml", toml_data)
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


def _read_marking(toml: "_Toml") -> Marking:
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


def _read_group(toml: "_Toml", field: str) -> so3.Rotations:
    """Return the group that a table like { kind = "cyclic", order = 3, axis = [0, 0, 1] } names."""
    kind = toml.take(f"{field}.kind", str)
    finite = {
        "tetrahedral": so3.tetrahedral_group,
        "octahedral": so3.octahedral_group,
        "icosahedral": so3.icosahedral_group,
    }
    if kind in finite:
        return finite[kind]()
    if kind not in ("cyclic", "dihedral"):
        kinds = ", ".join(["cyclic", "dihedral", *finite])
        raise toml.fault(f"{field}.kind", f"expected one of {kinds}, found {kind!r}")
    order = toml.take(f"{field}.order", int)
    if not 1 <= order <= MAX_GROUP_ORDER:
        raise toml.fault(f"{field}.order", f"expected 1 to {MAX_GROUP_ORDER}, found {order}")
    if kind == "dihedral":
        return so3.dihedral_group(order)
    return so3.cyclic_group(order, _read_axis(toml, f"{field}.axis") if toml.has(f"{field}.axis") else so3.Z_AXIS)


def _read_axis(toml: "_Toml", field: str) -> list[float]:
    axis = toml.take(field, list)
    numbers = [float(x) for x in axis if isinstance(x, int | float) and not isinstance(x, bool) and math.isfinite(x)]
    if len(axis) != 3 or len(numbers) != 3 or not any(numbers):
        raise toml.fault(field, f"expected three finite numbers that are not all 0, found {shown(axis)}")
    least, most = _AXIS_LENGTHS
    if not least <= math.hypot(*numbers) <= most:
        raise toml.fault(field, f"expected an axis of a length from {least:g} to {most:g}, found {shown(axis)}")
    return numbers


class _Toml:
    """An object.toml whose faults name the file, the field and, where it stands in the file, its line."""

    def __init__(self, path: Path, data: bytes) -> None:
        self._path = path
        self._taken: set[_Field] = {("provenance",)}
        try:
            self._text = data.decode("utf-8-sig")
        except UnicodeDecodeError as error:
            raise ObjectError(f"{path}: cannot be read: {error}") from None
        try:
            self._tables = parse_toml(self._text)
        except ValueError as error:
            raise ObjectError(f"{path}: is no valid TOML: {error}") from None

    def has(self, field: str) -> bool:
        """Tell whether a dotted field is there."""
        return self._find(field) is not None

    def take(self, field: str, kind: type[Any]) -> Any:
        """Return a dotted field's value, of the type asked for; integers pass as float."""
        value = self._find(field)
        if value is None:
            raise self.fault(field, "is missing")
        if kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
            raise self.fault(field, f"expected {_TOML_NAMES[kind]}, found {shown(value)}")
        self._taken.add(tuple(field.split(".")))
        return value

    def refuse_unknown_fields(self) -> None:
        """Raise for the first field that nobody took: most often a misspelt one."""
        for field in _leaves(self._tables):
            if field not in self._taken and field[:1] not in self._taken:
                raise self.fault(".".join(field), "is not a field of an object.toml")

    def fault(self, field: str, what: str) -> ObjectError:
        """Return the error that says what is wrong with a field, and where."""
        line = self._line_of(field) if self.has(field) else None
        where = f"{self._path}, line {line}" if line else str(self._path)
        return ObjectError(f"{where}: {field}: {what}")

    def _line_of(self, field: str) -> int | None:
        """Return the line where a dotted field is set, by its table's header and its key, or in an inline table."""
        table = ""
        for number, line in enumerate(self._text.split("\n"), start=1):
            header = re.match(r"\s*\[([^\[\]]+)\]", line)
            key = re.match(r"\s*([^\s=#]+)\s*=", line)
            if header:
                table = _plain(header[1]) + "."
            elif key and f"{field}.".startswith(f"{table}{_plain(key[1])}."):
                return number
        return None

    def _find(self, field: str) -> Any:
        value: Any = self._tables
        for key in field.split("."):
            value = value.get(key) if isinstance(value, dict) else None
        return value


_TOML_NAMES = {int: "a whole number", float: "a number", str: "a string", bool: "true or false", list: "a list"}


def _plain(key: str) -> str:
    """Return a dotted TOML key without quotes and spaces."""
    return re.sub(r"[\s\"']", "", key)


def _leaves(table: dict[str, Any], prefix: _Field = ()) -> list[_Field]:
    """Return the fields of tables within tables, empty tables among them."""
    fields: list[_Field] = []
    for key, value in table.items():
        fields += _leaves(value, (*prefix, key)) if isinstance(value, dict) and value else [(*prefix, key)]
    return fields
