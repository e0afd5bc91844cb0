"""JSON files of a BOP dataset, of unknown origin: tables, lists and finite numbers, within bounds."""

import hashlib
import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError
from symsol_annot.system.reading import read_bytes

MAX_JSON_BYTES = 2**25  # scenes of 2,000 images have 5 MB; JSON takes up to 25 times its size in memory
MAX_NUMBER = 1e9  # of lengths in mm and of focal lengths in pixels
MAX_ID = 999_999  # of six digits
_SHOWN = 60  # characters of a value in a message


@dataclass(frozen=True)
class JsonFile:
    """A JSON file that holds a table.

    Attributes:
        path: of the file.
        sha256: of its bytes.
        table: what it says.
    """

    path: Path
    sha256: str
    table: dict[str, Any]


def is_there(path: Path) -> bool:
    """Tell whether there is something of this name: a broken link too, and what may not be looked at."""
    try:
        path.lstat()
    except OSError as error:
        return not isinstance(error, (FileNotFoundError, NotADirectoryError))
    return True


def check_inside(root: Path, path: Path) -> None:
    """Refuse a file or folder that is a link out of the dataset's folder.

    Raises:
        DataError: it is.
    """
    try:
        target = path.resolve()
        is_inside = root.resolve() in (target, *target.parents)
    except (OSError, RuntimeError) as error:  # a link that leads to itself
        raise DataError(f"{path}: cannot be followed: {error}") from None
    if not is_inside:
        raise DataError(f"{path}: leads to {target}, out of the dataset's folder {root}; put a copy in its place")


def read_table(root: Path, path: Path, what: str) -> JsonFile:
    """Read a JSON file of a dataset.

    Args:
        root: the dataset's folder.
        path: of the file.
        what: the file is for, in a message.

    Raises:
        DataError: it is missing, too large, no JSON, no table, or a link out of the dataset.
    """
    check_inside(root, path)
    try:
        data = read_bytes(path, MAX_JSON_BYTES)
    except OSError as error:
        found = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
        raise DataError(f"{path}: {found}; expected {what}") from None
    try:
        table = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise DataError(f"{path}: cannot be read as JSON: {error}") from None
    if not isinstance(table, dict):
        raise DataError(f"{path}: expected a table in braces, {what}, found {shown(table)}")
    return JsonFile(path, hashlib.sha256(data).hexdigest(), table)


def whole_id(value: Any, what: str) -> int:
    """Return an id, which a table's key has as a text.

    Raises:
        DataError: it is none.
    """
    if isinstance(value, str) and value.isascii() and value.isdigit() and len(value) <= len(str(MAX_ID)):
        return int(value)
    if type(value) is int and 0 <= value <= MAX_ID:
        return value
    raise DataError(f"{what}: expected a whole number from 0 to {MAX_ID}, found {shown(value)}")


def numbers(value: Any, count: int, what: str) -> npt.NDArray[np.float64]:
    """Return a list of finite numbers (count,).

    Raises:
        DataError: it is none, or a number is beyond every length.
    """
    if isinstance(value, list) and len(value) == count and all(map(_is_number, value)):
        return np.array(value, dtype=np.float64)
    raise DataError(f"{what}: expected {count} numbers within {MAX_NUMBER:g} of 0, found {shown(value)}")


def number(value: Any, what: str) -> float:
    """Return a finite number.

    Raises:
        DataError: it is none, or beyond every length.
    """
    if not _is_number(value):
        raise DataError(f"{what}: expected a number within {MAX_NUMBER:g} of 0, found {shown(value)}")
    return float(value)


def typed(table: Any, key: str, kind: type, what: str) -> Any:
    """Return the value of a table's key, which has to be of a type.

    Raises:
        DataError: the table is none, or it has no such value.
    """
    words = "a list in brackets" if kind is list else "a table in braces"
    if not isinstance(table, dict):
        raise DataError(f"{what}: expected a table in braces with {key}, found {shown(table)}")
    if key not in table:
        raise DataError(f"{what}: has no {key}; expected {words}")
    if not isinstance(table[key], kind):
        raise DataError(f"{what}: {key}: expected {words}, found {shown(table[key])}")
    return table[key]


def shown(value: Any) -> str:
    """Return the start of a value, as a message shows it."""
    text = repr(value) if not isinstance(value, (list, dict)) else _start(value)
    return text if len(text) <= _SHOWN else f"{text[:_SHOWN]}..."


def _start(value: list[Any] | dict[str, Any]) -> str:
    kind = "list" if isinstance(value, list) else "table"
    return f"a {kind} of {len(value)}"


def _is_number(value: Any) -> bool:
    if type(value) is int:
        return abs(value) <= MAX_NUMBER  # before it is a float, which not every integer can be
    return type(value) is float and math.isfinite(value) and abs(value) <= MAX_NUMBER
