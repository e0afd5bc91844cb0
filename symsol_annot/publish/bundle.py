"""The folder that is published: files put into it whole, with a list of their SHA-256.

The list is written before each file that it names, and has another name until the bundle is finished. So it tells
after an interruption what is this program's own and may be kept, and what is not and must not be touched.
"""

import hashlib
import os
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from symsol_annot.errors import DataError, OutputError, first_of, output_errors
from symsol_annot.system.checksums import changed_in, is_hidden, is_system_note, names_in, read_list, to_list
from symsol_annot.system.files import make_folder, replaced, write_atomically
from symsol_annot.system.reading import file_sha256
from symsol_annot.system.scratch import sweep

CHECKSUMS_NAME = "SHA256SUMS"
_UNFINISHED_NAME = "SHA256SUMS.unfinished"
_MADE_BY = "symsol-annot publish"
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

    def stream(self, name: str, blocks: Callable[[], Iterable[bytes]]) -> str:
        """Write a file of any size, unless it is there with these bytes, and return its SHA-256.

        Args:
            name: of the file.
            blocks: returns the file's bytes in blocks, the same ones each time; called twice.

        Raises:
            DataError: they were not the same.
            OutputError: it cannot be written.
        """
        sha256 = _sha256_of(blocks())
        if self._announce(name, sha256):
            with replaced(self.folder / name) as new:
                with new.open("xb") as file:
                    for block in blocks():
                        file.write(block)
                    file.flush()
                    os.fsync(file.fileno())
                if file_sha256(new) != sha256:
                    raise DataError(f"{self.folder / name}: its source was changed; run the same command again")
        return sha256

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
            self._remove_own(name)
            self._sha256[name] = sha256
            write_atomically(self.folder / _UNFINISHED_NAME, to_list(self._sha256, _MADE_BY))
            (self.folder / CHECKSUMS_NAME).unlink(missing_ok=True)  # `open_bundle` found it to be this program's
        return True

    def _remove_own(self, name: str) -> None:
        """Remove a file of the bundle that is about to be written again, unless it was changed meanwhile."""
        if name in self._sha256 and changed_in(self.folder, {name: self._sha256[name]}):
            _refuse(self.folder, {name}, "holds a file that was changed while this command ran")
        (self.folder / name).unlink(missing_ok=True)


def open_bundle(folder: Path, expected: Mapping[str, str | None]) -> Bundle:
    """Open a folder to be filled: an empty one, or one that holds this bundle, finished or begun.

    Args:
        folder: an existing folder, which the caller has locked.
        expected: name, with /, to SHA-256 of each file that the bundle will have; None where that is still to be seen.

    Raises:
        OutputError: it holds anything else, or files of the bundle that were changed; nothing was touched.
    """
    with output_errors(folder):
        for inner in {folder, *((folder / name).parent for name in expected)}:
            sweep(inner)
        listed = _read_checksums(folder)
        there = {name for name in names_in(folder) if not (is_hidden(name) or is_system_note(name) or name[-1] == "/")}
        there -= {CHECKSUMS_NAME, _UNFINISHED_NAME}
        foreign = there if listed is None else (there | listed.keys()) - expected.keys()
        _refuse(folder, foreign, "holds files that are no part of this bundle")
        _refuse(folder, {name for name in there if (folder / name).is_symlink()}, "holds links in place of files")
        sha256 = {name: file_sha256(folder / name) for name in there}
        others = {name for name, digest in sha256.items() if expected[name] not in (None, digest)}
        _refuse(folder, others, "holds the files of another set, or damaged ones")
        changed = {name for name, digest in sha256.items() if (listed or {}).get(name) != digest}
        _refuse(folder, changed, "holds files that were changed since they were made")
    return Bundle(folder, sha256)


def _sha256_of(blocks: Iterable[bytes]) -> str:
    digest = hashlib.sha256()
    for block in blocks:
        digest.update(block)
    return digest.hexdigest()


def _read_checksums(folder: Path) -> dict[str, str] | None:
    """Return a folder's list, name to SHA-256, or None without one; refuse one that `publish` did not make."""
    for name in (_UNFINISHED_NAME, CHECKSUMS_NAME):
        listed = read_list(folder / name, _MADE_BY)
        if listed is None and os.path.lexists(folder / name):
            _refuse(folder, {name}, "holds a list of checksums that is somebody else's, or damaged")
        if listed is not None:
            return listed
    return None


def _refuse(folder: Path, names: set[str], what: str) -> None:
    if names:
        raise OutputError(
            f"{folder}: {what}: {first_of(sorted(names), _LISTED_NAMES)}. Nothing was touched; "
            "move them elsewhere, or choose another folder with --out"
        )
