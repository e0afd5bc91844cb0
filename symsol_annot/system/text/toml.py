"""TOML of unknown origin: plain values within bounds, in bounded time.

tomllib's time grows with the square of a dotted key's length, it calls itself for every level, and it returns integers
that Python refuses to print. What passes here can be walked, compared and printed.
"""

import tomllib
from typing import Any

MAX_TOML_BYTES = 2**16  # tomllib takes up to 50 times as long for ten times as much
MAX_TITLE = 200
TITLE_RULE = f"1 to {MAX_TITLE} printable characters"
_MAX_DOTS = 256  # in a line: of a dotted key, and of a title in a checkpoint's recipe
_MAX_DEPTH = 32
_LARGEST_INT = 2**63 - 1  # TOML has none beyond
_MAX_SHOWN = 200


def parse_toml(text: str) -> dict[str, Any]:
    """Return the tables of a TOML text: nested 32 deep at most, integers within 64 bits.

    Raises:
        ValueError: it is no TOML, or larger or deeper than a settings file has a reason to be; the text says which.
    """
    if len(text) > MAX_TOML_BYTES:
        raise ValueError(f"it has {len(text):,} characters, more than the {MAX_TOML_BYTES:,} allowed")
    for number, line in enumerate(text.split("\n"), start=1):
        if line.count(".") > _MAX_DOTS:
            raise ValueError(f"more than {_MAX_DOTS} dots in a line (at line {number})")
    try:
        tables = tomllib.loads(text)
    except RecursionError:
        raise ValueError("it is nested too deep") from None
    _refuse_beyond_bounds(tables)
    return tables


def shown(value: Any) -> str:
    """Return a value as a message shows it: in Python's notation, cut where it is long."""
    text = repr(value)
    return text if len(text) <= _MAX_SHOWN else f"{text[:_MAX_SHOWN]} .. ({len(text):,} characters)"


def is_title(text: Any) -> bool:
    """Tell whether this can be what an object or a recipe is, in words."""
    return isinstance(text, str) and text.isprintable() and len(text.strip()) > 0 and len(text) <= MAX_TITLE


def _refuse_beyond_bounds(tables: dict[str, Any]) -> None:
    level: list[Any] = [tables]
    for _ in range(_MAX_DEPTH):
        if any(type(value) is int and abs(value) > _LARGEST_INT for value in level):
            raise ValueError("it holds an integer beyond 64 bits")
        parts = [value.values() if isinstance(value, dict) else value for value in level if _has_parts(value)]
        level = [part for values in parts for part in values]
        if not level:
            return
    raise ValueError(f"it is nested more than {_MAX_DEPTH} deep")


def _has_parts(value: Any) -> bool:
    return isinstance(value, dict | list)
