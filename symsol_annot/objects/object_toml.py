"""The fields of an object.toml, taken one by one, so that every fault names its file, field and line."""

import re
from pathlib import Path
from typing import Any, TypeAlias

from symsol_annot.errors import ObjectError
from symsol_annot.system.text.toml import parse_toml, shown

_Field: TypeAlias = tuple[str, ...]  # the keys that lead to a value
_FREE = ("provenance",)  # holds what anybody likes


class ObjectToml:
    """An object.toml.

    Args:
        path: where it comes from, for error messages.
        data: its bytes.

    Raises:
        ObjectError: they are no TOML.
    """

    def __init__(self, path: Path, data: bytes) -> None:
        self._path = path
        self._taken: set[_Field] = {_FREE}
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

    def count(self, field: str) -> int:
        """Return how many tables a dotted field has that is written as `[[field]]`; 0 where it is none.

        The first of them is `field.0`, and so on.
        """
        tables = self._find(field)
        return len(tables) if _are_tables(tables) else 0

    def take(self, field: str, kind: type[Any]) -> Any:
        """Return a dotted field's value, of the type asked for; whole numbers pass as float.

        Raises:
            ObjectError: it is missing, or of another type.
        """
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
        """Check that every field was taken; one that was not is most often misspelt.

        Raises:
            ObjectError: there is one; the message names the first.
        """
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
        seen: dict[str, int] = {}
        for number, line in enumerate(self._text.split("\n"), start=1):
            header = re.match(r"\s*\[([^\[\]]+)\]", line)
            repeated = re.match(r"\s*\[\[([^\[\]]+)\]\]", line)
            key = re.match(r"\s*([^\s=#]+)\s*=", line)
            if repeated:
                name = _plain(repeated[1])
                seen[name] = seen.get(name, -1) + 1
                table = f"{name}.{seen[name]}."
            elif header:
                table = _plain(header[1]) + "."
            elif key and f"{field}.".startswith(f"{table}{_plain(key[1])}."):
                return number
        return None

    def _find(self, field: str) -> Any:
        value: Any = self._tables
        for key in field.split("."):
            if _are_tables(value) and key.isdecimal():
                value = value[int(key)] if int(key) < len(value) else None
            else:
                value = value.get(key) if isinstance(value, dict) else None
        return value


_TOML_NAMES = {int: "a whole number", float: "a number", str: "a string", bool: "true or false", list: "a list"}


def _plain(key: str) -> str:
    """Return a dotted TOML key without quotes and spaces."""
    return re.sub(r"[\s\"']", "", key)


def _are_tables(value: Any) -> bool:
    return isinstance(value, list) and bool(value) and all(isinstance(table, dict) for table in value)


def _leaves(table: dict[str, Any], prefix: _Field = ()) -> list[_Field]:
    """Return the fields of tables within tables, empty tables among them; those of repeated tables by their number."""
    fields: list[_Field] = []
    for key, value in table.items():
        inner = {str(number): one for number, one in enumerate(value)} if _are_tables(value) else value
        fields += _leaves(inner, (*prefix, key)) if isinstance(inner, dict) and inner else [(*prefix, key)]
    return fields
