"""Folders held by one process alone."""

import contextlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from symsol_annot.errors import OutputError
from symsol_annot.files import output_errors

if sys.platform != "win32":
    import fcntl


@contextlib.contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Hold a folder for this process alone; the lock ends with the process and leaves no file.

    A file system without such locks (some network ones) lets everybody in; two processes then make the same bytes.

    Raises:
        OutputError: another process holds it, or it cannot be opened.
    """
    if sys.platform == "win32":  # has no such lock
        yield
        return
    with output_errors(folder):
        descriptor = os.open(folder, os.O_RDONLY)
    try:
        if not try_lock(descriptor):
            raise OutputError(
                f"{folder}: another process{_lock_holder(descriptor)} is writing there right now; wait for it, or "
                "choose another folder with --out"
            )
        yield
    finally:
        os.close(descriptor)


def try_lock(descriptor: int) -> bool:
    """Lock an open file or folder until it is closed; False where somebody else holds it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # this file system has no locks
        return True
    return True


def _lock_holder(descriptor: int) -> str:
    """Say which process on this machine has locked an open folder, where the system tells (Linux)."""
    status = os.fstat(descriptor)
    wanted = f"{os.major(status.st_dev):02x}:{os.minor(status.st_dev):02x}:{status.st_ino}"
    with contextlib.suppress(OSError, ValueError):
        for line in Path("/proc/locks").read_text().splitlines():
            words = line.split()  # number, kind, mode, access, process, device:device:inode, start, end
            if words[1] == "FLOCK" and words[5] == wanted and int(words[4]) > 0:
                command = Path(f"/proc/{words[4]}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                return f" ({words[4]}: {command.strip()[:120]})"
    return ""


@contextlib.contextmanager
def held_folder(path: Path) -> Iterator[None]:
    """Hold a folder for this process alone, made where it is missing and removed again where nothing was put in it.

    Raises:
        OutputError: it cannot be made, or another process holds it.
    """
    with output_errors(path):
        made = [folder for folder in (path, *path.parents) if not folder.exists()]
        path.mkdir(parents=True, exist_ok=True)
    try:
        with locked(path):
            yield
    finally:
        with contextlib.suppress(OSError):  # it holds something
            for folder in made:
                folder.rmdir()
