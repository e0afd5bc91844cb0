"""Temporary folders that do not outlive their owner by more than one run: whoever comes next removes them."""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from symsol_annot.errors import OutputError
from symsol_annot.locks import try_lock

_PREFIX = "symsol-annot-"


class Scratch:
    """A temporary folder that this process holds a lock on for as long as it lives.

    Attributes:
        path: the folder.
    """

    def __init__(self) -> None:
        self.path = Path()
        self._descriptor = -1
        while self._descriptor < 0:  # a sweep can take a folder between its making and its locking
            self.path = Path(tempfile.mkdtemp(prefix=_PREFIX))
            try:
                self._descriptor = _locked_descriptor(self.path)
            except OSError:  # too many open files
                self.path.rmdir()
                raise

    def close(self) -> None:
        """Remove the folder, where that was not done already."""
        shutil.rmtree(self.path, ignore_errors=True)
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
            "Finished shards are kept: the same command goes on"
        ) from None


def sweep() -> None:
    """Remove this user's temporary folders whose owners are dead, as after SIGKILL."""
    for folder in Path(tempfile.gettempdir()).glob(f"{_PREFIX}*"):
        with contextlib.suppress(OSError):
            if folder.lstat().st_uid == os.getuid():
                descriptor = _locked_descriptor(folder)
                if descriptor >= 0:
                    shutil.rmtree(folder, ignore_errors=True)
                    os.close(descriptor)


def _locked_descriptor(folder: Path) -> int:
    """Open a folder (no link to one) and lock it; -1 where it is gone or somebody else's.

    Raises:
        OSError: it cannot be opened, though it is there.
    """
    try:
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except FileNotFoundError:
        return -1
    if try_lock(descriptor) and folder.exists():
        return descriptor
    os.close(descriptor)
    return -1
