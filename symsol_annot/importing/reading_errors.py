"""What zipfile, zlib and Pillow raise on damaged files, as one error that names the file."""

import struct
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager

from symsol_annot.errors import DataError

_READING_ERRORS = (
    OSError,  # Pillow's and the operating system's
    EOFError,
    KeyError,
    NotImplementedError,
    OverflowError,
    RuntimeError,
    SyntaxError,
    TypeError,
    ValueError,
    struct.error,
    zipfile.BadZipFile,
    zlib.error,
    Warning,
)


@contextmanager
def as_data_error(what: str) -> Iterator[None]:
    """Turn what zipfile, zlib and Pillow raise on a damaged file into a DataError that names it."""
    try:
        yield
    except _READING_ERRORS as error:
        raise DataError(f"{what}: {error or type(error).__name__}") from None
