"""The folder that is published: files put into it whole, with a list of their SHA-256.

The list is written before each file that it names, and has another name until the bundle is finished. So it tells
after an interruption what is this program's own and may be kept, and what is somebody else's and must not be touched.
"""

import hashlib
import os
import re
from collections.abc import Mapping
from pathlib import Path, PurePosixPath

from symsol_annot.errors import DataError, OutputError, first_of
from symsol_annot.files import (
    PARTIAL_SUFFIX,
    file_sha256,
    make_folder,
    output_errors,
    remove_partial_files,
    write_atomically,
)

CHECKSUMS_NAME = "SHA256SUMS"
_UNFINISHED_NAME = "SHA256SUMS.unfinished"
_LISTED_NAMES = 5


class Bundle:
    """A folder that is being filled; whoever opens it holds its lock."""

    def __init__(self, folder: Path, sha256: dict[str, str]) -> None:
        self.folder = folder
        self._sha256 = sha256

    def sha256(self, name: str) -> str | None:
        """Return the SHA-256 of a file of the bundle, or None where it is not there."""
        return self._sha256.get(name) if (self.folder / name).exists() else None

    def size(self, name: str) -> int:
        """Return the size of a file that is there."""
        return (self.folder / name).stat().st_size

    def put(self, name: str, data: bytes) -> None:
        """Write a file, unless it is there with these bytes.

        Raises:
            OutputError: it cannot be written.
        """
        if self._announce(name, hashlib.sha256(data).hexdigest()):
            write_atomically(self.folder / name, data)

    def link(self, name: str, source: Path, sha256: str) -> None:
        """Put a file of known bytes there, as a hard link where the file system can, else as a copy.

        Raises:
            DataError: it has other bytes.
            OutputError: it cannot be written.
        """
        if not self._announce(name, sha256):
            return
        target = self.folder / name
        with output_errors(target):
            try:
                os.link(source.resolve(), target)
            except OSError:  # another disk, or one without links
                write_atomically(target, source.read_bytes())
            if file_sha256(target) != sha256:
                target.unlink()
                raise DataError(f"{source}: was changed while it was published; run the same command again")

    def finish(self) -> None:
        """Give the list of checksums its name: the bundle is whole."""
        with output_errors(self.folder):
            if (self.folder / _UNFINISHED_NAME).exists():
                (self.folder / _UNFINISHED_NAME).replace(self.folder / CHECKSUMS_NAME)

    def _announce(self, name: str, sha256: str) -> bool:
        """List a file that is about to be written; False where it is there already."""
        if self.sha256(name) == sha256:
            return False
        make_folder((self.folder / name).parent)
        with output_errors(self.folder):
            (self.folder / name).unlink(missing_ok=True)
            self._sha256[name] = sha256
            lines = "".join(f"{digest}  {listed}\n" for listed, digest in sorted(self._sha256.items()))
            write_atomically(self.folder / _UNFINISHED_NAME, lines.encode())
            (self.folder / CHECKSUMS_NAME).unlink(missing_ok=True)
        return True


def open_bundle(folder: Path, expected: Mapping[str, str | None]) -> Bundle:
    """Open a folder to be filled: an empty one, or one that holds this bundle, finished or begun.

    Args:
        folder: an existing folder, which the caller has locked.
        expected: name, with /, to SHA-256 of each file that the bundle will have; None where that is still to be seen.

    Raises:
        OutputError: it holds anything else, or files of the bundle that were changed; nothing was touched.
    """
    with output_errors(folder):
        listed = _read_checksums(folder)
        there = _files_in(folder)
        strangers = there if listed is None else (there | listed.keys()) - expected.keys()
        _refuse(folder, strangers, "holds files that are no part of this bundle")
        sha256 = {name: file_sha256(folder / name) for name in there}
        others = {name for name, digest in sha256.items() if expected[name] not in (None, digest)}
        _refuse(folder, others, "holds the files of another set, or damaged ones")
        changed = {name for name, digest in sha256.items() if (listed or {}).get(name) != digest}
        _refuse(folder, changed, "holds files that were changed since they were made")
        for inner in {folder, *((folder / name).parent for name in expected)}:
            remove_partial_files(inner)
    return Bundle(folder, sha256)


def _files_in(folder: Path) -> set[str]:
    """Return the names of all files but the list of checksums and half-written ones; a link is a name, too.

    What is hidden, at any depth, is left out: notes of programs that upload or show it (.git, .DS_Store).
    """
    found = [path for path in folder.rglob("*") if path.is_symlink() or not path.is_dir()]
    names = {path.relative_to(folder).as_posix() for path in found if not path.name.endswith(PARTIAL_SUFFIX)}
    shown = {name for name in names if not any(part.startswith(".") for part in PurePosixPath(name).parts)}
    return shown - {CHECKSUMS_NAME, _UNFINISHED_NAME}


def _read_checksums(folder: Path) -> dict[str, str] | None:
    """Return name to SHA-256 of the list in a folder, or None without one."""
    for name in (_UNFINISHED_NAME, CHECKSUMS_NAME):
        path = folder / name
        if path.is_file() and not path.is_symlink():
            lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
            found = [re.fullmatch(r"([0-9a-f]{64})  (.+)", line) for line in lines]
            if not all(found):
                _refuse(folder, {name}, "holds a list of checksums that is somebody else's, or damaged")
            return {match[2]: match[1] for match in found if match}
    return None


def _refuse(folder: Path, names: set[str], what: str) -> None:
    if names:
        raise OutputError(
            f"{folder}: {what}: {first_of(sorted(names), _LISTED_NAMES)}. Nothing was touched; "
            "move them elsewhere, or choose another folder with --out"
        )
