"""A predictions file that is read: opened, checked against the truth that it is about, and its tracks."""

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from symsol_annot.bench.predictions.advice.mends import mend_of_file
from symsol_annot.bench.predictions.contents import Contents
from symsol_annot.bench.predictions.faults import FaultLog
from symsol_annot.bench.predictions.format import FILE_ATTRIBUTES, PREDICTIONS_FORMAT, THE_FILE
from symsol_annot.bench.predictions.proposals import Predicted
from symsol_annot.bench.predictions.sandboxed_file import SandboxedFile
from symsol_annot.bench.predictions.structure import Structure, shown
from symsol_annot.bench.predictions.tracks.table import TRACK_OF_DATASET, TRACKS
from symsol_annot.bench.predictions.tracks.track import TrackReader
from symsol_annot.bench.predictions.truth import Subject, Truth, read_subject
from symsol_annot.errors import DataError, PredictionsError, SealError
from symsol_annot.sets.folders import set_folders
from symsol_annot.system.reading import file_sha256
from symsol_annot.system.text.names import (
    METHOD_NAME_RULE,
    OBJECT_NAME_RULE,
    SPLITS,
    is_method_name,
    is_object_name,
    is_split,
)

_MOST_TIMES_NEEDED, _MOST_BESIDE = 4, 2**29  # of the bytes that a file's values take; HDF5 leaves holes in files


class Predictions:
    """A predictions file whose structure was checked; its contents are checked as its tracks are read.

    Attributes:
        path: of the file.
        sha256: of the file, as hexadecimal; empty where it has faults, or `open_predictions` did not open it.
        method: what the method calls itself.
        about: the split that it is about, with its truth where that is known.
        faults: found so far; complete once all tracks were gone through.
        readers: of those tracks that are there and can be read.
    """

    def __init__(self, file: Contents, about: Subject) -> None:
        self.path, self.about, self.sha256, self.faults = file.path, about, "", FaultLog()
        structure = Structure(file, about, self.faults, TRACK_OF_DATASET)
        structure.has_attributes(FILE_ATTRIBUTES, THE_FILE)
        self.method = str(file.attributes.get("method", ""))
        if "method" in file.attributes and not is_method_name(self.method):
            self.faults.add(THE_FILE, f"attribute 'method': expected {METHOD_NAME_RULE}, found {shown(self.method)}")
        self._image_index = structure.image_index
        there = [track for track in TRACKS.values() if any(structure.has(dataset) for dataset in track.datasets)]
        if not there:
            first = ", ".join(track.datasets[0] for track in TRACKS.values())
            self.faults.add(THE_FILE, f"has no track: none of the data sets {first}")
        for track in there:
            if fault := track.fault_of_sealing(about):
                self.faults.add(track.name, fault)
        found = [track.reader(structure) for track in there]
        self.readers: tuple[TrackReader, ...] = tuple(reader for reader in found if reader.is_sound())

    @property
    def truth(self) -> Truth:
        """Of the split that it is about.

        Raises:
            SealError: the split is sealed, and was opened without its secret.
        """
        if isinstance(self.about, Truth):
            return self.about
        raise SealError(
            f"{self.about.folder}: is sealed, so predictions about it are scored by whoever has its secret alone: "
            "`symsol-annot score --secret FILE` (docs/sealed.md)"
        )

    def check(self) -> None:
        """Go through every track.

        Raises:
            PredictionsError: with all faults of the file.
        """
        for reader in self.readers:
            for _ in self.blocks(reader):
                pass
        self.raise_faults()

    def blocks(self, reader: TrackReader) -> Iterator[Any]:
        """Yield a track's images in blocks of bounded size, without those that have a fault."""
        if self._image_index is None:
            return
        try:
            yield from reader.blocks(self._image_index)
        except PredictionsError as error:  # reading failed: what was found before, and in other tracks, counts too
            for fault in error.faults:
                self.faults.add(THE_FILE, fault)

    def proposals(self, reader: TrackReader, first: int | None = None) -> list[Predicted]:
        """Return what a track says of the first images of its split, or of all, as pictures show it.

        Raises:
            PredictionsError: the contents have faults, all of which it lists.
        """
        read = reader.proposals(self.truth)
        found: dict[int, Predicted] = {}
        for block in self.blocks(reader):
            for row, image in enumerate(block.image_index):
                if first is None or image < first:
                    found[int(image)] = read(block, row)
        self.raise_faults()
        return [found[image] for image in sorted(found)]

    def raise_faults(self) -> None:
        """Raise the faults that were found so far, if there are any.

        Raises:
            PredictionsError: with those faults.
        """
        if self.faults:
            raise PredictionsError(str(self.path), self.faults.lines())


@contextmanager
def open_predictions(
    path: str | os.PathLike[str], data: str | os.PathLike[str], secrets: Sequence[Path] = ()
) -> Iterator[Predictions]:
    """Open a predictions file and the truth that it says it is about.

    The file's digest is taken once, here. A file that is changed or replaced before the `with` block ends is refused
    at its end, since the digest and what was read of it may then be of different contents.

    Args:
        path: of the predictions.
        data: a set's folder, or the folder of sets.
        secrets: of sealed tests, for their truth.

    Raises:
        PredictionsError: it is no predictions file, or was changed meanwhile.
        SealError: the set that it is about is sealed, and none of the secrets given is its own.
        DataError: the set that it is about is not there or damaged.
    """
    if found := mend_of_file(Path(path), _some_set(Path(data))):
        raise PredictionsError(str(path), [found])
    before = _identity(Path(path))
    with SandboxedFile(Path(path)) as file:
        predictions = Predictions(file, read_subject(data, *_subject(file), secrets))
        if fault := _excess(file):
            predictions.faults.add(THE_FILE, fault)
        if not predictions.faults:  # a file with faults is refused whatever its digest
            predictions.sha256 = _sha256(Path(path))
        yield predictions
    if _identity(Path(path)) != before:
        fault = f"{THE_FILE}: was changed while it was read; try again once its writer is done"
        raise PredictionsError(str(path), [fault])


def _sha256(path: Path) -> str:
    try:
        return file_sha256(path)
    except OSError as error:
        raise PredictionsError(str(path), [f"{THE_FILE}: cannot be read: {error.strerror or error}"]) from None


def _excess(file: SandboxedFile) -> str:
    """Say where a file is far larger than its data sets, whose digest would take as long as somebody likes; else ""."""
    needed = sum(facts.values_bytes for facts in file.datasets.values() if not facts.found)
    size = file.size_bytes
    if size <= _MOST_TIMES_NEEDED * needed + _MOST_BESIDE:
        return ""
    return f"has {size:,} bytes, of which its data sets need {needed:,}; HDF5's `h5repack` writes it without the rest"


def _identity(path: Path) -> tuple[int, ...]:
    """Return what changes where a file is written or replaced; nothing where there is none."""
    try:
        status = path.stat()
    except OSError:
        return ()
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def _some_set(data: Path) -> str:
    """Return the folder of a set under `data`, for code to copy: the only one, or one to be filled in."""
    try:
        (only,) = set_folders(data)
    except (DataError, ValueError):
        return (data / "OBJECT").as_posix()
    return only.as_posix()


def _subject(file: SandboxedFile) -> tuple[str, str, str]:
    """Return the object, the split and the fingerprint that a file says it is about."""
    found = file.attributes
    name, split, fingerprint = found.get("object"), found.get("split"), found.get("fingerprint")
    if found.get("format") != PREDICTIONS_FORMAT:
        fault = f"attribute 'format': expected {PREDICTIONS_FORMAT!r}, found {shown(found.get('format'))}"
    elif not is_object_name(name):
        fault = f"attribute 'object': expected the name of an object, found {shown(name)}: {OBJECT_NAME_RULE}"
    elif not is_split(split):
        fault = f"attribute 'split': expected one of {', '.join(SPLITS)}, found {shown(split)}"
    else:
        return str(name), str(split), fingerprint if isinstance(fingerprint, str) else ""
    raise PredictionsError(str(file.path), [f"{THE_FILE}: {fault}"])
