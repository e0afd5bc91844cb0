"""A list of a folder's files with their SHA-256, as `sha256sum -c` reads it: what in a folder is this program's own.

The first line says who made the list. A file that is not in it, or has other bytes now, is not this program's, and
must not be removed or replaced.
"""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path, PurePosixPath

from symsol_annot.system.reading import file_sha256, read_text

_LIMIT_BYTES = 2**28
_LINE = re.compile(r"([0-9a-f]{64})  (.+)")
_SYSTEM_NOTES = (".DS_Store", "Thumbs.db", "desktop.ini")


def to_list(sha256: Mapping[str, str], made_by: str) -> bytes:
    """Return the list of files, whose names are paths with /, by the command that made them."""
    lines = "".join(f"{digest}  {name}\n" for name, digest in sorted(sha256.items()))
    return f"{_first_line(made_by)}\n{lines}".encode()


def read_list(path: Path, made_by: str) -> dict[str, str] | None:
    """Return name to SHA-256 of a list that a command made, or None where the file is not there or none of its lists.

    Raises:
        OSError: it cannot be read.
    """
    if path.is_symlink() or not path.is_file():
        return None
    try:
        first, *lines = read_text(path, _LIMIT_BYTES).splitlines()
    except (UnicodeDecodeError, ValueError):  # an empty file has no first line
        return None
    found = [_LINE.fullmatch(line) for line in lines]
    if first != _first_line(made_by) or not all(found):
        return None
    return {match[2]: match[1] for match in found if match}


def names_in(folder: Path) -> set[str]:
    """Return the names of all files in a folder, links among them; of an empty folder, with a / at its end."""
    return set(_leaves(folder, folder))


def is_hidden(name: str) -> bool:
    """Tell whether a name, or a folder on the way to it, begins with a dot: notes of other programs (.git, .cache)."""
    return any(part.startswith(".") for part in PurePosixPath(name).parts)


def is_system_note(name: str) -> bool:
    """Tell whether a file is what macOS or Windows leave in folders that a user opens."""
    last = PurePosixPath(name).name
    return last in _SYSTEM_NOTES or last.startswith("._")


def changed_in(folder: Path, listed: Mapping[str, str]) -> set[str]:
    """Return which of the listed files that are there are not what they were: other bytes, or a link now."""
    there = {name: folder / name for name in listed if (folder / name).exists() or (folder / name).is_symlink()}
    return {name for name, path in there.items() if path.is_symlink() or file_sha256(path) != listed[name]}


def _leaves(folder: Path, root: Path) -> Iterator[str]:
    entries = list(folder.iterdir())
    if not entries and folder != root:
        yield f"{folder.relative_to(root).as_posix()}/"
    for path in entries:
        if path.is_dir() and not path.is_symlink():
            yield from _leaves(path, root)
        else:
            yield path.relative_to(root).as_posix()


def _first_line(made_by: str) -> str:
    return f"# made by `{made_by}`"
