"""Writing files and folders so that a reader never sees half of one, and no file of another program is lost.

What is being written lies in a scratch folder beside its place until it is whole, and is renamed then.
"""

import contextlib
import errno
import os
import shutil
import stat
from collections.abc import Iterable, Iterator
from pathlib import Path

from symsol_annot.errors import OutputError, output_errors
from symsol_annot.system.scratch import WAITING, Scratch, sweep, sweep_once

_NEW, _SUPERSEDED = "new", "superseded"  # names in a scratch folder
_SYSTEM_FOLDERS = (Path("/dev"), Path("/proc"))
_BLOCK_BYTES = 2**20


@contextlib.contextmanager
def replaced(path: Path) -> Iterator[Path]:
    """Give a name in a scratch folder; what is written there takes the file's place, or goes at an error or Ctrl-C.

    A link stays a link: the file that it leads to is replaced. A file that is there keeps its mode. What is there and
    no regular file, like a pipe or /dev/stdout, stays what it is: the bytes are written to it at the end.

    The caller sees to it that the bytes reach the disk (`os.fsync`).

    Raises:
        OutputError: the disk is full or the folder not writable.
    """
    with output_errors(path):
        if _is_written_through(path):
            with Scratch() as scratch:
                yield scratch.path / _NEW
                _write_through(scratch.path / _NEW, path)
            return
        target = Path(os.path.realpath(path))
        _refuse_folder(target)
        sweep_once(target.parent)
        with Scratch(beside=target.parent) as scratch:
            new = scratch.path / _NEW
            yield new
            with contextlib.suppress(FileNotFoundError):  # no file is there yet
                shutil.copymode(target, new)
            new.replace(target)


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder in a scratch folder, which gets its name once it is whole; at an error or Ctrl-C it goes.

    Args:
        path: where nothing is, or an empty folder; no other process writes it meanwhile.

    Raises:
        OutputError: the disk is full or the folder around it not writable, or something was put there meanwhile.
    """
    with output_errors(path):
        sweep_once(path.parent)
        with Scratch(beside=path.parent) as scratch:
            new = scratch.path / _NEW
            new.mkdir()
            yield new
            if path.exists():
                path.rmdir()
            new.rename(path)


@contextlib.contextmanager
def replaced_folder(path: Path) -> Iterator[Path]:
    """Give an empty folder, for which a folder that is there is removed once it is whole.

    The caller has proved that all that is in the folder was made by this program. A run that is killed while the
    folder has no name leaves it waiting in the scratch folder, and the next run's sweep gives it its name back.
    """
    with output_errors(path):
        sweep(path.parent)
        with Scratch(beside=path.parent) as scratch:
            new, waiting = scratch.path / _NEW, scratch.path / WAITING
            new.mkdir()
            yield new
            waiting.mkdir()
            if path.exists():
                path.rename(waiting / path.name)
            new.rename(path)
            waiting.rename(scratch.path / _SUPERSEDED)


def write_atomically(path: Path, data: bytes) -> None:
    """Write a file as `replaced` does, and make sure that it reached the disk.

    Raises:
        OutputError: the disk is full or the folder not writable; nothing is left beside the name.
    """
    with written_atomically(path, data):
        pass


@contextlib.contextmanager
def written_atomically(path: Path, data: bytes) -> Iterator[Path]:
    """Write a file that gets its name at the end of the block, in which it may be looked at; at an error it goes.

    Raises:
        OutputError: as `write_atomically`.
    """
    with replaced(path) as new:
        with new.open("xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        yield new
    with output_errors(path):
        if not _is_written_through(path):
            _sync_folder(Path(os.path.realpath(path)).parent)


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


def _is_written_through(path: Path) -> bool:
    """Tell whether something is there that a regular file must not take the place of."""
    try:
        mode = path.stat().st_mode
    except FileNotFoundError:
        return False
    if stat.S_ISDIR(mode):
        return False
    given = Path(os.path.abspath(path))  # noqa: PTH100 - /dev/stdout leads to a file, which must stay
    return not stat.S_ISREG(mode) or any(folder in given.parents for folder in _SYSTEM_FOLDERS)


def _write_through(new: Path, path: Path) -> None:
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND)
    with new.open("rb") as source, os.fdopen(descriptor, "wb", buffering=0) as target:
        while block := memoryview(source.read(_BLOCK_BYTES)):
            while block:
                block = block[target.write(block) :]


def _refuse_folder(target: Path) -> None:
    if target.is_dir():
        raise OutputError(f"{target}: cannot be written: is a folder, where a file is to be: choose another name")


def _sync_folder(folder: Path) -> None:
    if os.name == "posix":
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
