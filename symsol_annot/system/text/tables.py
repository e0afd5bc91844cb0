"""TOML tables as dataclasses: each key has the type of its field, and all faults are told at once."""

import datetime as dt
from collections.abc import Collection, Mapping
from dataclasses import MISSING, Field, dataclass, fields, is_dataclass
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin, get_type_hints

T = TypeVar("T")

_LARGEST_INT = 2**63 - 1  # TOML has none beyond
_SHOWN_CHARACTERS = 100
_WORDS = {float: "a number", int: "a whole number", dt.date: "a date", bool: "true or false"}


@dataclass(frozen=True)
class OneOf:
    """What makes text one of the names of a table: `Annotated[str, OneOf(TABLE)]`, looked up when a value is read."""

    names: Collection[str]


def from_table(kind: type[T], table: Mapping[str, Any], what: str) -> tuple[T | None, list[str]]:
    """Return a dataclass whose fields are a table's keys, or None, and the table's faults.

    A field may be a bool, int, float, str, date, Literal or OneOf, one of them or None, a tuple of one of them,
    another dataclass, or a mapping from names to one of these.

    Args:
        kind: the dataclass.
        table: as tomllib reads it.
        what: the table is, in words: "a classifier recipe".
    """
    hints = get_type_hints(kind, include_extras=True)
    known = {field.name: field for field in fields(kind)}  # type: ignore[arg-type]
    faults = [f"{_key(key)}: is no key of {what}; keys are {', '.join(known)}" for key in table if key not in known]
    faults += [f"{name}: is missing" for name, field in known.items() if _is_required(field) and name not in table]
    values = {key: _parsed(table[key], hints[key], key, faults) for key in table if key in known}
    return (None, faults) if faults else (kind(**values), faults)


def _is_required(field: "Field[Any]") -> bool:
    return field.default is MISSING and field.default_factory is MISSING


def _parsed(value: Any, hint: Any, where: str, faults: list[str]) -> Any:
    """Return a value as the type that is wanted; faults go to the list."""
    if type(value) is int and abs(value) > _LARGEST_INT:  # so large that Python may refuse to print it
        faults.append(f"{where}: expected a number, found one beyond 64 bits")
        return value
    origin = get_origin(hint)
    if is_dataclass(hint) or origin in (dict, Mapping):
        return _parsed_table(value, hint, where, faults)
    if origin is tuple:
        if isinstance(value, list):
            return tuple(_parsed(one, get_args(hint)[0], where, faults) for one in value)
        faults.append(
            f"{where}: expected a list of {'text' if get_args(hint)[0] is str else 'numbers'}, found {_shown(value)}"
        )
        return ()
    if origin in (Literal, Annotated):
        names = get_args(hint) if origin is Literal else tuple(hint.__metadata__[0].names)
        expected, is_right = f"one of {', '.join(names)}", value in names
    else:
        kinds = set(get_args(hint) or (hint,)) - {type(None)}
        value = float(value) if float in kinds and type(value) is int else value
        expected = next((_WORDS[kind] for kind in _WORDS if kind in kinds), "text")
        is_right = type(value) in kinds  # True is an int, and no number here
    if not is_right:
        faults.append(f"{where}: expected {expected}, found {_shown(value)}")
    return value


def _parsed_table(value: Any, hint: Any, where: str, faults: list[str]) -> Any:
    if not isinstance(value, dict):
        faults.append(f"{where}: expected a table of keys, found {_shown(value)}")
        return {}
    if is_dataclass(hint):
        made, found = from_table(hint, value, where)  # type: ignore[arg-type]
        faults += [f"{where}.{fault}" for fault in found]
        return made
    return {key: _parsed(one, get_args(hint)[1], f"{where}.{_key(key)}", faults) for key, one in value.items()}


def _shown(value: Any) -> str:
    """Return a value of unknown origin for a message: in quotes, with control characters escaped, and short."""
    text = repr(value)
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[:_SHOWN_CHARACTERS]}..."


def _key(key: str) -> str:
    """Return a key of unknown origin for a message: short, and in quotes where it is no plain word."""
    is_plain = key.isprintable() and len(key) <= _SHOWN_CHARACTERS
    return key if is_plain else _shown(key)
