"""Reading files of unknown origin: regular files only, and never more of one than is allowed.

A FIFO has no end, /dev/zero neither, and opening a device may do something. All that this package reads whole goes
through here: manifests, object.toml, meshes, recipes, scores, scheduler files.
"""

import errno
import hashlib
import os
import stat
import zlib
from pathlib import Path

_FLAGS = os.O_RDONLY | getattr(os, "O_BINARY", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_NOCTTY", 0)
_BLOCK_BYTES = 2**20
_AS_GZIP = 16 + zlib.MAX_WBITS
GZIP_ENDING = ".gz"


def open_regular(path: Path) -> int:
    """Return a descriptor of a regular file, open for reading; a link is followed.

    Raises:
        OSError: it is missing, unreadable, or no regular file.
    """
    _refuse_irregular(os.stat(path))  # noqa: PTH116 - before it is opened
    descriptor = os.open(path, _FLAGS)  # and if it was changed meanwhile, this does not wait for a FIFO's writer
    try:
        _refuse_irregular(os.fstat(descriptor))
    except OSError:
        os.close(descriptor)
        raise
    return descriptor


def read_bytes(path: Path, limit: int) -> bytes:
    """Return the bytes of a regular file.

    Args:
        path: of the file; a link is followed.
        limit: how many bytes it may have.

    Raises:
        OSError: it is missing, unreadable, no regular file, or larger than `limit`; `strerror` says which.
    """
    data = bytearray()
    with os.fdopen(open_regular(path), "rb") as file:
        while block := file.read(_BLOCK_BYTES):  # at once, memory for the whole limit would be taken
            data += block
            if len(data) > limit:
                raise _too_large(path, limit)
    return bytes(data)


def read_gzip(path: Path, limit: int) -> bytes:
    """Return what a regular file of gzip unpacks to.

    Args:
        path: of the file; a link is followed.
        limit: how many bytes it may have, packed and unpacked; what unpacks to more is given up there.

    Raises:
        OSError: as `read_bytes`, or it is no gzip, cut short or damaged, or something follows it.
    """
    packed, unpacker = read_bytes(path, limit), zlib.decompressobj(_AS_GZIP)
    try:
        data = unpacker.decompress(packed, limit + 1)
    except zlib.error as error:
        raise OSError(errno.EINVAL, f"is no gzip, or damaged: {error}", str(path)) from None
    if len(data) > limit:
        raise OSError(errno.EFBIG, f"unpacks to more than the {limit:,} bytes that such a file may have", str(path))
    if not unpacker.eof:
        raise OSError(errno.EINVAL, "is gzip that was cut short", str(path))
    if unpacker.unused_data:
        raise OSError(errno.EINVAL, "is gzip with something behind its end", str(path))
    return data


def read_text(path: Path, limit: int) -> str:
    """Return a regular file's text, UTF-8, with or without a byte order mark.

    Raises:
        OSError: as `read_bytes`.
        UnicodeDecodeError: it is no UTF-8.
    """
    return read_bytes(path, limit).decode("utf-8-sig")


def file_sha256(path: Path, limit: int | None = None) -> str:
    """Return the SHA-256 of a regular file, as hexadecimal.

    Args:
        path: of the file; a link is followed.
        limit: how many bytes it may have; any number by default.

    Raises:
        OSError: it is missing, unreadable, no regular file, or larger than `limit`; `strerror` says which.
    """
    with os.fdopen(open_regular(path), "rb") as file:
        if limit is not None and os.fstat(file.fileno()).st_size > limit:
            raise _too_large(path, limit)
        return hashlib.file_digest(file, "sha256").hexdigest()


def _too_large(path: Path, limit: int) -> OSError:
    return OSError(errno.EFBIG, f"is larger than the {limit:,} bytes that such a file may have", str(path))


def _refuse_irregular(status: os.stat_result) -> None:
    if stat.S_ISDIR(status.st_mode):
        raise IsADirectoryError(errno.EISDIR, "is a folder, where a file belongs")
    if not stat.S_ISREG(status.st_mode):
        raise OSError(errno.EINVAL, "is no regular file")
