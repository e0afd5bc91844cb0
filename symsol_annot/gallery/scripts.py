"""Data that a page from disk can load: scripts that each hand one document to the page.

A browser refuses to fetch files for such a page, but runs scripts. Arrays travel as base64 of their bytes.
"""

import base64
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

Document = dict[str, Any]


def write_script(path: Path, key: str, document: Document) -> None:
    """Write a script that delivers a document under a key.

    JSON in ASCII is JavaScript whatever the strings in it say; the page puts them on the screen as text only.
    """
    text = json.dumps(document, separators=(",", ":"), allow_nan=False)
    path.write_text(f"{_opening(key)}{text});\n", encoding="ascii")


def packed(values: npt.ArrayLike, dtype: str) -> Document:
    """Return an array as a document: type and bytes, little-endian, the last axis fastest.

    Args:
        values: any shape; the page knows it.
        dtype: one of "u1", "i2", "u4", "f4".
    """
    data = np.ascontiguousarray(values, dtype=f"<{dtype}").tobytes()
    return {"dtype": dtype, "data": base64.b64encode(data).decode("ascii")}


def number(value: float) -> float | None:
    """Return a JSON number; null where it is undefined."""
    return float(f"{value:.6g}") if math.isfinite(value) else None


def _opening(key: str) -> str:
    return f"SYMSOL.deliver({json.dumps(key)},"
