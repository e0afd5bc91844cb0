"""Writing files so that a reader never sees half of one."""

import contextlib
import errno
import hashlib
import os
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

from symsol_annot.errors import OutputError

if sys.platform != "win32":
    import fcntl

PARTIAL_SUFFIX = ".partial"


def write_atomically(path: Path, data: bytes) -> None:
    """Write beside the name, make sure it reached the disk, and rename into place.

    Raises:
        OutputError: the disk is full or the folder not writable; nothing is left beside the name.
    """
    partial = path.with_name(f".{path.name}{PARTIAL_SUFFIX}")
    with output_errors(path):
        try:
            partial.unlink(missing_ok=True)  # it may be a link to elsewhere
            with partial.open("xb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
            partial.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                partial.unlink()
            raise
        _sync_folder(path.parent)


def file_sha256(path: Path) -> str:
    """Return the SHA-256 of a regular file, as hexadecimal.

    Raises:
        OSError: it is missing, unreadable, or no regular file: a pipe or a device would never end.
    """
    if path.exists() and not path.is_file():
        raise OSError(errno.EINVAL, "is no regular file")
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


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


def make_folder(path: Path) -> None:
    """Make a folder and its parents where they are missing.

    Raises:
        OutputError: it cannot be made, or cannot be written to.
    """
    with output_errors(path):
        path.mkdir(parents=True, exist_ok=True)
        if not os.access(path, os.W_OK | os.X_OK):
            raise PermissionError(errno.EACCES, "no write permission")


def check_inside(folder: Path, names: Iterable[str]) -> None:
    """Refuse links in a folder's names that lead out of it, before anything is written.

    Raises:
        OutputError: one does.
    """
    with output_errors(folder):
        inside = folder.resolve()
        out = [
            name for name in names if (folder / name).is_symlink() and inside not in (folder / name).resolve().parents
        ]
    if out:
        target = (folder / out[0]).resolve()
        raise OutputError(
            f"{folder / out[0]}: is a symbolic link to {target}, outside the set's folder; nothing was written. "
            "Remove the link, or choose another folder with --out"
        )


def remove_partial_files(folder: Path) -> None:
    """Remove what a killed run left half-written."""
    with output_errors(folder):
        for partial in folder.glob(f".*{PARTIAL_SUFFIX}"):
            partial.unlink(missing_ok=True)


@contextlib.contextmanager
def output_errors(path: Path) -> Iterator[None]:
    """Turn the operating system's errors into an OutputError that names the path and what to do."""
    try:
        yield
    except OSError as error:
        advice = {
            errno.ENOSPC: "the disk is full: make room, then run the same command again; finished shards are kept",
            errno.EDQUOT: "the disk quota is used up: make room, then run the same command again",
            errno.EACCES: "no write permission: choose another folder with --out, or change its permissions",
            errno.EPERM: "no write permission: choose another folder with --out, or change its permissions",
            errno.EROFS: "the file system is read-only: choose another folder with --out",
            errno.ENOTDIR: "a part of the path is a file, not a folder: choose another folder with --out",
            errno.EEXIST: "is a file, not a folder: choose another folder with --out",
        }.get(error.errno or 0, error.strerror or str(error))
        raise OutputError(f"{path}: cannot be written: {advice}") from None


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
