"""A folder of what can be made again: bounded, checked when it is read, and never a reason for anything to fail.

Each file begins with a line that names it this program's, and states the SHA-256 of what follows. No other file in the
folder is read or removed.
"""

import contextlib
import hashlib
import logging
import os
import re
import shutil
from pathlib import Path

from symsol_annot.errors import OutputError
from symsol_annot.system.files import make_folder, replaced
from symsol_annot.system.reading import open_regular

MAX_BYTES = 4 * 2**30
_MAGIC = b"symsol-annot cache 1 "
_HEADER_BYTES = len(_MAGIC) + 64 + 1  # the digest in hexadecimal, and the end of the line
_SUFFIX = ".cached"
_KEY = re.compile(r"[0-9a-f]{64}")
_DISK_SHARE = 0.25  # of what is free, that one file may take
_LOG = logging.getLogger(__name__)


def user_cache_folder() -> Path | None:
    """Return this user's folder: $XDG_CACHE_HOME/symsol-annot, else ~/.cache/symsol-annot; None for a homeless one."""
    place = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if place.is_absolute():
        return place / "symsol-annot"
    with contextlib.suppress(RuntimeError):
        return Path.home() / ".cache" / "symsol-annot"
    return None


class Cache:
    """Bytes by keys in a folder.

    Args:
        folder: made with the first thing that is kept.
        max_bytes: of all files; beyond it those go that were used longest ago.
    """

    def __init__(self, folder: Path, max_bytes: int = MAX_BYTES) -> None:
        self._folder, self._max_bytes = folder, max_bytes

    def get(self, key: str) -> bytearray | None:
        """Return what is kept under a key; None where nothing is, or it cannot be read or is not what was put there.

        Args:
            key: 64 hexadecimal digits.
        """
        path = self._path(key)
        try:
            with os.fdopen(open_regular(path), "rb") as file:
                size = os.fstat(file.fileno()).st_size - _HEADER_BYTES
                header = file.read(_HEADER_BYTES)
                if not header.startswith(_MAGIC) or not 0 <= size <= self._max_bytes:
                    return None
                data = bytearray(size)
                if file.readinto(data) != size or header != _header(data):
                    return None
            os.utime(path)
        except OSError as error:
            if not isinstance(error, FileNotFoundError):
                _LOG.info("%s: cannot be read: %s", path, error)
            return None
        return data

    def put(self, key: str, *parts: bytes | memoryview) -> bool:
        """Keep bytes under a key, and tell whether they are kept: not on a full disk, nor in a read-only folder.

        Args:
            key: 64 hexadecimal digits that name everything that the bytes follow from.
            parts: the bytes, one after another.
        """
        path, size = self._path(key), sum(len(part) for part in parts)
        if path.is_symlink() or (path.exists() and not path.is_file()):  # not made here
            return False
        try:
            make_folder(self._folder)
            if size > min(self._max_bytes, _DISK_SHARE * shutil.disk_usage(self._folder).free):
                return False
            with replaced(path) as new, new.open("xb") as file:
                file.write(_header(*parts))
                for part in parts:
                    file.write(part)
                file.flush()
                os.fsync(file.fileno())
            self._remove_the_oldest()
        except (OSError, OutputError) as error:
            _LOG.info("%s: is not kept: %s", path, error)
            return False
        return True

    def _remove_the_oldest(self) -> None:
        there = []
        for path in self._folder.iterdir():
            if path.suffix == _SUFFIX and _KEY.fullmatch(path.stem) and _is_ours(path):
                status = path.lstat()
                there.append((status.st_mtime, status.st_size, path))
        too_many = sum(size for _, size, _ in there) - self._max_bytes
        for _, size, path in sorted(there):
            if too_many <= 0:
                return
            path.unlink(missing_ok=True)  # another process may have
            too_many -= size

    def _path(self, key: str) -> Path:
        if not _KEY.fullmatch(key):
            raise ValueError(f"expected a key of 64 hexadecimal digits, found {key!r}")
        return self._folder / f"{key}{_SUFFIX}"


def _header(*parts: bytes | bytearray | memoryview) -> bytes:
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part)
    return _MAGIC + digest.hexdigest().encode() + b"\n"


def _is_ours(path: Path) -> bool:
    with contextlib.suppress(OSError):
        if not path.is_symlink():
            with os.fdopen(open_regular(path), "rb") as file:
                return file.read(len(_MAGIC)) == _MAGIC
    return False
