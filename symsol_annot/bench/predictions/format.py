"""The predictions file's names, types and limits; docs/submission.md is the contract."""

from typing import Any

PREDICTIONS_FORMAT = "symsol-annot predictions"
PREDICTIONS_FORMAT_VERSION = 1

FILE_ATTRIBUTES: dict[str, type] = {
    "format": str,
    "format_version": int,
    "method": str,
    "object": str,
    "split": str,
    "fingerprint": str,
}

IMAGE_INDEX = "image_index"
THE_FILE = "the file"  # what faults belong to that are of no track
REALS, INTEGERS = ("<f4", "<f8"), ("<i4", "<i8", "<u4")

MAX_HYPOTHESES = 10_000
MAX_GRID_LEVEL = 5
STANDARD_THRESHOLD = 0.8  # of a probability, T of eq. 7.4
# Of R^T R = I and of det R = 1: columns made orthonormal in float32 are off by 6e-8 over the sine of their first angle.
ROTATION_TOLERANCE = {"<f4": 1e-4, "<f8": 1e-4}
FILTERS = {1: "gzip", 2: "shuffle", 3: "fletcher32"}  # by HDF5's numbers: those that every build has
MAX_CHUNK_BYTES = 2**28
_SHOWN_CHARACTERS = 100  # of a file's value in a message


def version_fault(found: Any, expected: int) -> str:
    """Say why a file of a format version is not read; "" where it is.

    Args:
        found: what the file has in place of a version.
        expected: the version that is read.
    """
    shown = f"{found!r:.{_SHOWN_CHARACTERS}}"
    if type(found) is not int or found < expected:
        return f"this version reads format_version {expected}, found {shown}"
    if found > expected:
        return f"is of format version {shown}, newer than {expected}, which this symsol-annot reads: update it"
    return ""


def is_level(level: Any) -> bool:
    """Tell whether predictions can be on the grid of this level."""
    return isinstance(level, int) and 0 <= level <= MAX_GRID_LEVEL
