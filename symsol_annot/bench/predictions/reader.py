"""A predictions file: opened, checked against the truth that it is about, and its tracks."""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from symsol_annot.bench.predictions.advice.mends import mend_of_file
from symsol_annot.bench.predictions.faults import FaultLog
from symsol_annot.bench.predictions.format import FILE_ATTRIBUTES, PREDICTIONS_FORMAT, TRACKS
from symsol_annot.bench.predictions.structure import Structure, shown
from symsol_annot.bench.predictions.tracks import (
    ClassifierBlock,
    ClassifierTrack,
    DensityBlock,
    DensityTrack,
    HypothesesBlock,
    HypothesesTrack,
    Track,
)
from symsol_annot.bench.predictions.truth import Truth, read_truth
from symsol_annot.errors import DataError, PredictionsError
from symsol_annot.sets.folders import set_folders
from symsol_annot.system.sandbox.hdf5_process import SandboxedFile
from symsol_annot.system.text.names import (
    METHOD_NAME_RULE,
    OBJECT_NAME_RULE,
    SPLITS,
    is_method_name,
    is_object_name,
    is_split,
)

_TRACKS: dict[str, type[HypothesesTrack | ClassifierTrack | DensityTrack]] = {
    track.name: track for track in (HypothesesTrack, ClassifierTrack, DensityTrack)
}


class Predictions:
    """A predictions file whose structure was checked; its contents are checked as its tracks are read.

    Attributes:
        method: what the method calls itself.
        truth: of the object and split that it is about.
        faults: found so far; complete once all tracks were gone through.
        tracks: those that are there and can be read.
    """

    def __init__(self, file: SandboxedFile, truth: Truth) -> None:
        self._path, self.truth, self.faults = file.path, truth, FaultLog()
        structure = Structure(file, truth, self.faults)
        structure.has_attributes(FILE_ATTRIBUTES, "the file")
        self.method = str(file.attributes.get("method", ""))
        if "method" in file.attributes and not is_method_name(self.method):
            self.faults.add("the file", f"attribute 'method': expected {METHOD_NAME_RULE}, found {shown(self.method)}")
        self._image_index = structure.image_index
        there = [name for name, datasets in TRACKS.items() if any(structure.has(dataset) for dataset in datasets)]
        if not there:
            first = ", ".join(datasets[0] for datasets in TRACKS.values())
            self.faults.add("the file", f"has no track: none of the data sets {first}")
        found = [_TRACKS[name](structure) for name in there]
        self.tracks: tuple[Track, ...] = tuple(track for track in found if track.is_sound())

    def check(self) -> None:
        """Go through every track.

        Raises:
            PredictionsError: with all faults of the file.
        """
        for track in self.tracks:
            for _ in self.blocks(track):
                pass
        self.raise_faults()

    def blocks(self, track: Track) -> Iterator[HypothesesBlock | ClassifierBlock | DensityBlock]:
        """Yield a track's images in blocks of bounded size, without those that have a fault."""
        if self._image_index is None:
            return
        try:
            yield from track.blocks(self._image_index)
        except PredictionsError as error:  # reading failed: what was found before, and in other tracks, counts too
            for fault in error.faults:
                self.faults.add("the file", fault)

    def raise_faults(self) -> None:
        """Raise the faults that were found so far, if there are any."""
        if self.faults:
            raise PredictionsError(str(self._path), self.faults.lines())


@contextmanager
def open_predictions(path: str | os.PathLike[str], data: str | os.PathLike[str]) -> Iterator[Predictions]:
    """Open a predictions file and the truth that it says it is about.

    Args:
        path: of the predictions.
        data: a set's folder, or the folder of sets.

    Raises:
        PredictionsError: it is no predictions file.
        DataError: the set that it is about is not there or damaged.
    """
    if found := mend_of_file(Path(path), _some_set(Path(data))):
        raise PredictionsError(str(path), [found])
    with SandboxedFile(Path(path)) as file:
        yield Predictions(file, read_truth(data, *_subject(file)))


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
    raise PredictionsError(str(file.path), [f"the file: {fault}"])
