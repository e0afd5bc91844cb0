"""What may be a name. A name from a file becomes a folder's, a link's, a line on a terminal: one rule each, everywhere.

an object's   letters, digits, '_' and '-', at most 64, a letter or digit first: also the name of its set's folder
a method's    1 to 200 printable characters, not all of them spaces
a split's     "train" or "test"
"""

import difflib
import re
from collections.abc import Iterable
from typing import Any

SPLITS = ("train", "test")
MAX_METHOD_NAME = 200
OBJECT_NAME_RULE = "1 to 64 letters, digits, '_' and '-', of which the first is a letter or a digit"
METHOD_NAME_RULE = f"1 to {MAX_METHOD_NAME} printable characters, not all of them spaces"
_OBJECT_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,63}")


def is_object_name(name: Any) -> bool:
    """Tell whether this can be the name of an object, and so of its set's folder and of files about it."""
    return isinstance(name, str) and _OBJECT_NAME.fullmatch(name) is not None


def is_method_name(name: Any) -> bool:
    """Tell whether this can be what a method calls itself."""
    return isinstance(name, str) and name.isprintable() and len(name.strip()) > 0 and len(name) <= MAX_METHOD_NAME


def is_split(name: Any) -> bool:
    """Tell whether this is one of the splits."""
    return isinstance(name, str) and name in SPLITS


def nearest(name: str, known: Iterable[str]) -> str:
    """Return the names that a mistyped one is near to, as the end of a message; "" where none is.

    Args:
        name: as it was given.
        known: those that there are.
    """
    by_lower = {other.lower(): other for other in known}
    near = difflib.get_close_matches(name.lower(), by_lower, n=2, cutoff=0.6)
    return f"; did you mean {' or '.join(repr(by_lower[one]) for one in near)}?" if near else ""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """Return the names that a mistyped one is near to, else all that there are, as the end of a message."""
    names = list(known)
    return nearest(name, names) or f"; there are {', '.join(names) or 'none'}"
