"""Values that files state of a set, and how they are checked: seeds, digests, numbers, texts."""

import math
import re
from typing import Any

MAX_SEED = 2**63 - 1  # HDF5 stores it as a 64-bit integer
SECRET_SEED_BITS = 128  # of a sealed test; a seed beyond MAX_SEED is stored as a text of 32 hexadecimal digits
MAX_SECRET_SEED = 2**SECRET_SEED_BITS - 1
_SHA256 = re.compile(r"[0-9a-f]{64}")
_SECRET_SEED = re.compile(r"[0-9a-f]{32}")
_MOST_CHARACTERS = 200


def seed_to_json(seed: int) -> int | str:
    """Return a seed as files state it: as a number, or as 32 hexadecimal digits where it is beyond MAX_SEED."""
    return seed if seed <= MAX_SEED else f"{seed:0{SECRET_SEED_BITS // 4}x}"


def seed_from_json(stated: Any) -> int:
    """Return the seed that `seed_to_json` gave.

    Raises:
        ValueError: it is none.
    """
    if is_whole(stated, 0, MAX_SEED):
        return int(stated)
    require(isinstance(stated, str) and _SECRET_SEED.fullmatch(stated) is not None, "seed")
    seed = int(stated, 16)
    require(seed > MAX_SEED, "seed")
    return seed


def is_whole(value: Any, least: int, most: int) -> bool:
    """Tell whether a value is an integer within bounds, which True and 1.0 are not."""
    return type(value) is int and least <= value <= most


def is_sha256(value: Any) -> bool:
    """Tell whether a value is a SHA-256 as lower-case hexadecimal."""
    return isinstance(value, str) and _SHA256.fullmatch(value) is not None


def is_number(value: Any) -> bool:
    """Tell whether a value is a finite float, which integers are not."""
    return type(value) is float and math.isfinite(value)


def is_short_text(value: Any) -> bool:
    """Tell whether a value is a printable text of at most 200 characters."""
    return isinstance(value, str) and value.isprintable() and len(value) <= _MOST_CHARACTERS


def require(is_right: bool, what: str) -> None:  # noqa: FBT001
    """Refuse what is not right.

    Raises:
        ValueError: it is not; the message is what it is about.
    """
    if not is_right:
        raise ValueError(what)
