"""The exceptions that this package raises on bad input.

    SymsolError
    ├── ObjectError             an object's object.toml or mesh.obj is broken
    │   └── UnknownObjectError      there is no object of that name or path
    ├── SettingsError           a number that makes no sense: a negative count, a size of 0
    ├── RotationError           an array that should hold rotations does not
    ├── DataError               a shard, a manifest or a folder of them is missing or damaged
    │   ├── DamageError             a chunk's bytes, or what HDF5 says of a file in its child process
    │   ├── DownloadError           a file cannot be downloaded, or the download broke off
    │   ├── DifferentSetError   the output folder already holds another set
    │   ├── NotAnnotatedError   symmetry sets asked of a split that was rendered without
    │   └── SealError               a sealed test's secret is missing, damaged, or another test's
    ├── PredictionsError        a predictions file is broken, or about another set
    ├── ScoresError             a scores file is broken, or cannot be compared with another
    ├── ModelError              a model was given what it cannot take
    │   ├── WeightsError            its weights are missing, damaged or another model's
    │   └── TrainingError           it cannot be trained on: a loss that is not finite, no memory, another training
    ├── MissingExtraError       a package is not installed that an extra brings
    ├── OutputError             a file cannot be written: permission, disk full
    └── RenderError             Blender cannot start, or stopped
        ├── RendererMissingError    something that Blender needs is not installed
        ├── ClusterError            a cluster cannot be reached, or its workers are not alike
        └── RendererCrashedError    Blender's process ended in the middle of its work
            └── RendererHungError       it gave no sign of life, and was ended

Every message says what was expected, what was found, where, and what to do next.
"""

import contextlib
import errno
from collections.abc import Iterator, Sequence
from pathlib import Path


def bulleted(lines: Sequence[str]) -> str:
    """Return the lines of a list in a message."""
    return "\n".join(f"  - {line}" for line in lines)


def count_of(faults: Sequence[str]) -> str:
    """Return how many they are, in words."""
    return "1 fault" if len(faults) == 1 else f"{len(faults)} faults"


def first_of(names: Sequence[str], shown: int) -> str:
    """Return the first of some names, and how many more there are."""
    more = f" and {len(names) - shown} more" if len(names) > shown else ""
    return ", ".join(names[:shown]) + more


def printable(text: str) -> str:
    """Return a text of which nothing can act on a terminal: what is not printable becomes Python's escapes.

    Line ends and tabs stay. Names and words in messages come from files that somebody may have forged.
    """
    if text.isprintable():
        return text
    return "".join(c if c.isprintable() or c in "\n\t" else ascii(c)[1:-1] for c in text)


class SymsolError(Exception):
    """The root of this package's exceptions; their text is `printable`."""

    def __str__(self) -> str:
        return printable(super().__str__())


class ObjectError(SymsolError):
    """An object's object.toml or mesh.obj is broken."""


class UnknownObjectError(ObjectError):
    """There is no object of that name or path."""


class SettingsError(SymsolError):
    """A setting has a value that makes no sense."""


class RotationError(SymsolError):
    """An array that should hold rotations does not."""


class DataError(SymsolError):
    """A shard, a manifest or a folder of them is missing or damaged."""


class DamageError(DataError):
    """A chunk is damaged, or a file of which HDF5 says so in its child process; whoever reads the file names it."""


class DownloadError(DataError):
    """A file cannot be downloaded: no connection, a host that refuses it, or a download that broke off.

    Attributes:
        status: the number of the host's answer where it refused the file, like 404; else None.
    """

    def __init__(self, message: str, status: int | None = None) -> None:
        super().__init__(message)
        self.status = status


class DifferentSetError(DataError):
    """The output folder already holds a set made with other settings."""

    def __init__(self, folder: str, differences: Sequence[str]) -> None:
        super().__init__(
            f"{folder} already holds another set; nothing was touched. It differs in:\n"
            + bulleted(differences)
            + "\nUse another --out folder, or delete that one."
        )
        self.differences = tuple(differences)


class NotAnnotatedError(DataError):
    """Symmetry sets were asked of a split that was rendered without them."""


class SealError(DataError):
    """A sealed test's secret is missing, damaged or another test's, or what it seals is not as it says."""


class PredictionsError(SymsolError):
    """A predictions file is broken, or about another set; `faults` lists all that was found."""

    def __init__(self, path: str, faults: Sequence[str]) -> None:
        count = count_of(faults)
        super().__init__(f"{path}: {count}; docs/submission.md says what belongs there:\n" + bulleted(faults))
        self.faults = tuple(faults)


class ScoresError(SymsolError):
    """A scores file is broken, or cannot be compared with another."""


class ModelError(SymsolError):
    """A model was given what it cannot take: images of another shape or type."""


class WeightsError(ModelError):
    """A model's weights cannot be had: no file, no download, a damaged file, or another model's."""


class TrainingError(ModelError):
    """Training cannot go on: a loss that is not finite, too little memory, a folder that holds another training."""


class MissingExtraError(SymsolError, ImportError):
    """A package is not installed; `extra` is what brings it."""

    def __init__(self, what: str, package: str, extra: str) -> None:
        super().__init__(f"{what} needs {package}, which is not installed: `pip install 'symsol-annot[{extra}]'`")
        self.extra = extra


class OutputError(SymsolError):
    """A file cannot be written."""


class RenderError(SymsolError):
    """Blender cannot start, or stopped."""


class RendererMissingError(RenderError):
    """Something that Blender needs is not installed."""


class ClusterError(RenderError):
    """A cluster cannot be reached, was lost, or has workers that would make other bytes."""


class RendererCrashedError(RenderError):
    """Blender's process ended in the middle of its work; `worker` is its name, where it has one."""

    worker = ""


class RendererHungError(RendererCrashedError):
    """Blender's process gave no sign of life, and was ended."""


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
