"""Folders held by one process alone."""

import contextlib
import enum
import logging
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from symsol_annot.errors import OutputError, output_errors

if sys.platform != "win32":
    import fcntl

_LOG = logging.getLogger(__name__)


class Held(enum.Enum):
    """Who holds a lock."""

    HERE = "this process, from now on"
    ELSEWHERE = "another process"
    UNKNOWN = "nobody can tell: this file system has no locks"


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for this process alone; the lock ends with the process and leaves no file.

    A file system without such locks (some network ones) lets everybody in; that is logged as a warning.

    Raises:
        OutputError: another process holds it, or it cannot be opened.
        FileNotFoundError: it was removed by the process that held it before.
    """
    if sys.platform == "win32":  # has no such lock
        _warn_of_no_locks(folder)
        yield
        return
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        held = try_lock(descriptor)
        if held is Held.ELSEWHERE:
            raise OutputError(
                f"{folder}: another process{_lock_holder(descriptor)} is writing there right now; wait for it, or "
                "choose another place with --out"
            )
        if held is Held.UNKNOWN:
            _warn_of_no_locks(folder)
        elif not os.path.samestat(os.fstat(descriptor), os.stat(folder)):  # noqa: PTH116 - the one before was removed
            raise FileNotFoundError(folder)
        yield
    finally:
        os.close(descriptor)


def try_lock(descriptor: int) -> Held:
    """Lock an open file or folder until it is closed, where no other process holds it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return Held.ELSEWHERE
    except OSError:  # ENOLCK, ENOTSUP, and EBADF from NFS, which locks no folders
        return Held.UNKNOWN
    return Held.HERE


@contextlib.contextmanager
def held_folder(path: Path) -> Iterator[None]:
    """Hold a folder for this process alone, made where it is missing and removed again where nothing was put in it.

    Raises:
        OutputError: it cannot be made, or another process holds it.
    """
    with contextlib.ExitStack() as stack:
        made: list[Path] = []
        stack.callback(_remove_empty, made)
        for is_last in (False, False, True):  # another process may remove it, empty, between its making and its locking
            with output_errors(path):
                made += [folder for folder in (path, *path.parents) if not folder.exists() and folder not in made]
                path.mkdir(parents=True, exist_ok=True)
                try:
                    stack.enter_context(locked(path))
                    break
                except FileNotFoundError:
                    if is_last:
                        raise
        yield


def _remove_empty(folders: list[Path]) -> None:
    for folder in folders:
        with contextlib.suppress(OSError):  # it holds something
            folder.rmdir()


def _warn_of_no_locks(folder: Path) -> None:
    _LOG.warning(
        "%s: this file system has no locks, so whether another process writes there cannot be told; "
        "see to it that none does",
        folder,
    )


def _lock_holder(descriptor: int) -> str:
    """Say which process on this machine has locked an open folder, where the system tells (Linux)."""
    status = os.fstat(descriptor)
    wanted = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()  # number, kind, mode, access, process, device:device:inode, start, end
            if words[1] == "FLOCK" and words[5] == wanted and int(words[4]) > 0:
                command = Path(f"/proc/{words[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f" ({words[4]}: {' '.join(command.split())[:120]})"
    return ""
