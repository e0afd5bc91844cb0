"""Folders for temporary files: the only ones that this program removes without having just made them.

Each holds a mark that names the folder itself by device and inode, so that neither a folder of a like name nor a copy
of a marked one is taken for ours; and the process that owns it holds a lock on it for as long as it lives. What a
killed owner left is removed by `sweep`, which takes a folder only where mark, user and lock all say that it may.
"""

import contextlib
import os
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path

from symsol_annot.errors import OutputError
from symsol_annot.system.closing import Closing
from symsol_annot.system.locks import Held, try_lock
from symsol_annot.system.reading import read_text

PREFIX = "symsol-annot-"
HIDDEN_PREFIX = f".{PREFIX}"  # of those beside a file that is being written
MARK_NAME = "MADE-BY-SYMSOL-ANNOT"
_MARK = "symsol-annot made this folder for temporary files, and removes it.\nfolder {device}:{inode}\n"
_MARK_BYTES = 4096
WAITING = "waiting"  # of what was moved away from a name beside the scratch folder, until the next one has that name
_OPEN_FOLDER = os.O_RDONLY | getattr(os, "O_DIRECTORY", 0) | getattr(os, "O_NOFOLLOW", 0)


class Scratch(Closing):
    """A folder for temporary files that this process holds a lock on for as long as it lives.

    Attributes:
        path: the folder, empty but for its mark.
    """

    def __init__(self, beside: Path | None = None) -> None:
        """Make the folder.

        Args:
            beside: a folder on whose file system it has to be, since files in it are renamed; by default it is among
                the system's temporary files.

        Raises:
            OSError: it cannot be made.
        """
        prefix = PREFIX if beside is None else HIDDEN_PREFIX
        self.path = Path(tempfile.mkdtemp(prefix=prefix, dir=beside))
        self._identity, self._descriptor = _identity(self.path), -1
        try:
            if sys.platform != "win32":  # which locks no folders
                self._descriptor = os.open(self.path, _OPEN_FOLDER)
                try_lock(self._descriptor)  # before the mark: a folder without one is never swept
            _write_mark(self.path)
        except OSError:
            self._let_go()
            with contextlib.suppress(OSError):  # made a moment ago, by this process
                (self.path / MARK_NAME).unlink(missing_ok=True)
                self.path.rmdir()  # which needs no descriptor, of which there may be none left
            raise

    def close(self) -> None:
        """Remove the folder with all that is in it, where that was not done already."""
        with contextlib.suppress(OSError):
            if _identity(self.path) == self._identity:
                _remove(self.path)
        self._let_go()

    def _let_go(self) -> None:
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


@contextlib.contextmanager
def temporary_errors() -> Iterator[None]:
    """Turn the operating system's errors into an OutputError about temporary files."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"temporary files cannot be written: {error}. Make room there, or set TMPDIR to another folder. "
            "Finished shards are kept: re-running the command resumes it"
        ) from None


def sweep(folder: Path | None = None) -> None:
    """Remove the scratch folders whose owners are dead, as after SIGKILL, and nothing else.

    Args:
        folder: where they were made, as `beside`; by default among the system's temporary files.
    """
    place, prefix = (Path(tempfile.gettempdir()), PREFIX) if folder is None else (folder, HIDDEN_PREFIX)
    with contextlib.suppress(OSError):
        for path in place.iterdir():
            if path.name.startswith(prefix):
                _remove_if_abandoned(path)


@lru_cache(maxsize=4096)
def sweep_once(folder: Path) -> None:
    """Sweep a folder when this process first writes a file there."""
    sweep(folder)


def is_marked(folder: Path) -> bool:
    """Tell whether a folder is a scratch folder: this user's, no link to one, and with a mark that names it."""
    try:
        status = folder.lstat()
        if not stat.S_ISDIR(status.st_mode) or (hasattr(os, "getuid") and status.st_uid != os.getuid()):
            return False
        mark = folder / MARK_NAME
        return stat.S_ISREG(mark.lstat().st_mode) and read_text(mark, _MARK_BYTES) == _mark_of(status)
    except (OSError, UnicodeDecodeError):
        return False


def remove_marked(folder: Path) -> None:
    """Remove a scratch folder that another process of this program made for this one; anything else stays."""
    if is_marked(folder):
        _remove(folder)


def _remove(folder: Path) -> None:
    """Remove a scratch folder, unless something waits in it that cannot have its name back.

    Its mark goes last, and comes back where the folder itself cannot go, so that a later sweep may take it.
    """
    with contextlib.suppress(OSError):
        for waiting in (folder / WAITING).iterdir():
            place = folder.parent / waiting.name
            if os.path.lexists(place):
                return
            waiting.rename(place)
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            if path.is_dir() and not path.is_symlink():
                shutil.rmtree(path, ignore_errors=True)
            elif path.name != MARK_NAME:
                path.unlink()
        (folder / MARK_NAME).unlink(missing_ok=True)
        try:
            folder.rmdir()
        except OSError:  # the folder that it is in was made read-only, or something came into it
            _write_mark(folder)


def _remove_if_abandoned(folder: Path) -> None:
    if sys.platform == "win32" or not is_marked(folder):
        return
    with contextlib.suppress(OSError):
        descriptor = os.open(folder, _OPEN_FOLDER)
        try:
            if try_lock(descriptor) is Held.HERE:  # without locks it is not known whether its owner lives
                remove_marked(folder)
        finally:
            os.close(descriptor)


def _write_mark(folder: Path) -> None:
    (folder / MARK_NAME).write_text(_mark_of(folder.lstat()), encoding="ascii")


def _mark_of(status: os.stat_result) -> str:
    return _MARK.format(device=status.st_dev, inode=status.st_ino)


def _identity(folder: Path) -> tuple[int, int]:
    status = folder.lstat()
    return status.st_dev, status.st_ino
