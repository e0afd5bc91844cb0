"""Writing files and folders so that a reader never sees half of one."""

import contextlib
import errno
import hashlib
import os
import shutil
from collections.abc import Iterable, Iterator
from pathlib import Path

from symsol_annot.errors import OutputError

PARTIAL_SUFFIX = ".partial"


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Give a name beside a file's own; what is written there takes the file's place, or goes at an error or Ctrl-C.

    Whoever writes sees to it that the bytes reached the disk (`os.fsync`).

    Raises:
        OutputError: the disk is full or the folder not writable.
    """
    partial = _beside(path, PARTIAL_SUFFIX)
    with output_errors(path):
        partial.unlink(missing_ok=True)  # a killed run's, or a link to elsewhere
        try:
            yield partial
            partial.replace(path)
        except BaseException:
            with contextlib.suppress(OSError):
                partial.unlink()
            raise


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder beside a name, which it gets once it is whole; at an error or Ctrl-C it goes.

    Args:
        path: where nothing is, or an empty folder; nobody else writes it meanwhile.

    Raises:
        OutputError: the disk is full or the folder around it not writable, or something was put there meanwhile.
    """
    partial = _beside(path, PARTIAL_SUFFIX)
    with output_errors(path):
        if partial.exists():  # a killed run left it
            shutil.rmtree(partial)
        try:
            partial.mkdir()
            yield partial
            if path.exists():
                path.rmdir()
            partial.rename(path)
        except BaseException:
            shutil.rmtree(partial, ignore_errors=True)
            raise


@contextlib.contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """Give the same beside a folder that may hold something, which is removed once the new one is whole."""
    before = _beside(path, ".before")
    with output_errors(path):
        _bring_back(before, path)  # where a run was killed between two names
    try:
        with new_folder(path) as partial:
            yield partial
            if path.exists():
                path.rename(before)
    except BaseException:
        with output_errors(path):
            _bring_back(before, path)
        raise
    shutil.rmtree(before, ignore_errors=True)


def write_atomically(path: Path, data: bytes) -> None:
    """Write beside the name, make sure it reached the disk, and rename into place.

    Raises:
        OutputError: the disk is full or the folder not writable; nothing is left beside the name.
    """
    with replaced(path) as partial, partial.open("xb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    with output_errors(path):
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
            errno.ENOSPC: "the disk is full: make room, then run the same command again",
            errno.EDQUOT: "the disk quota is used up: make room, then run the same command again",
            errno.EACCES: "no write permission: choose another folder with --out, or change its permissions",
            errno.EPERM: "no write permission: choose another folder with --out, or change its permissions",
            errno.EROFS: "the file system is read-only: choose another folder with --out",
            errno.ENOTDIR: "a part of the path is a file, not a folder: choose another folder with --out",
            errno.EEXIST: "is a file, not a folder: choose another folder with --out",
        }.get(error.errno or 0, error.strerror or str(error))
        raise OutputError(f"{path}: cannot be written: {advice}") from None


def _beside(path: Path, suffix: str) -> Path:
    return path.with_name(f".{path.name}{suffix}")


def _bring_back(before: Path, path: Path) -> None:
    """Give a folder that was moved away its name again, or remove it where the new one has come."""
    if not before.exists():
        return
    if path.exists() and any(path.iterdir()):
        shutil.rmtree(before, ignore_errors=True)
        return
    if path.exists():
        path.rmdir()
    before.rename(path)


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
