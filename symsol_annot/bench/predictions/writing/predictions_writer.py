"""A predictions file that is being written: what was collected for it, and how it is put in its place."""

import contextlib
import os
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from symsol_annot.bench.predictions.columns import Array, Column
from symsol_annot.bench.predictions.format import (
    FILE_ATTRIBUTES,
    IMAGE_INDEX,
    PREDICTIONS_FORMAT,
    PREDICTIONS_FORMAT_VERSION,
    THE_FILE,
)
from symsol_annot.bench.predictions.predictions_reader import Predictions
from symsol_annot.bench.predictions.sandboxed_file import SandboxedFile
from symsol_annot.bench.predictions.structure import shown
from symsol_annot.bench.predictions.tracks.table import TRACK_OF_DATASET, TRACKS
from symsol_annot.bench.predictions.tracks.track import Track
from symsol_annot.bench.predictions.truth import Subject, subject_of
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.predictions.writing.hdf5_output import HDF5Output
from symsol_annot.bench.predictions.writing.kept_answers import KeptAnswers, Resume, check_resume, held_parts
from symsol_annot.errors import PredictionsError, SealError, SettingsError, output_errors
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.files import replaced
from symsol_annot.system.text.names import METHOD_NAME_RULE, is_method_name

_CHUNK_BYTES = 2**18
_COPIED_BYTES = 2**24


class PredictionsFile:
    """One track on its way into a file, which may hold other tracks of the same method on the same images.

    It is made by `held_predictions`, which keeps other writers of the file out meanwhile.
    """

    def __init__(
        self, path: Path, parts: Path, dataset: Dataset, about: Subject, track: Track, attributes: dict[str, Any]
    ) -> None:
        self._path, self._dataset, self._about, self._track = path, dataset, about, track
        self._attributes = {
            "format": PREDICTIONS_FORMAT,
            "format_version": PREDICTIONS_FORMAT_VERSION,
            "object": dataset.object,
            "split": dataset.split,
            "fingerprint": dataset.fingerprint,
            **attributes,
        }
        self._kept, self._has_asked = KeptAnswers(parts, track.name, len(dataset)), False
        self._refuse_another()

    def write_answers(self, ask: Callable[[int], Answer], *, resume: Resume, progress: bool) -> None:
        """Ask about every image that was not asked about before, and write what was answered about all.

        The answers are kept until the file is written.

        Args:
            ask: from an image's index to arrays by the names of data sets.
            resume: as the writers take it.
            progress: show a bar where standard error is a terminal.

        Raises:
            PredictionsError: there are answers that may be another model's, or what was written has faults.
            OutputError: what was answered cannot be kept, or the file cannot be written.
        """
        self._kept.begin(self._attributes, resume)
        self._has_asked, images = True, len(self._dataset)
        answered = self._kept.answered()
        left = [i for i in range(images) if i not in answered]
        disable = None if progress else True
        with ThreadPoolExecutor(1) as keeper:  # deflates and writes an answer while the next one is worked out
            kept: Future[None] | None = None
            for i in tqdm(left, unit="image", total=images, initial=len(answered), disable=disable):
                answer = ask(i)
                if kept is not None:
                    kept.result()
                kept = keeper.submit(self._kept.write, i, answer)
            if kept is not None:
                kept.result()
        self.write(self._track.columns(self._kept))

    def write(self, columns: Mapping[str, Column]) -> None:
        """Write the file elsewhere, check all of it, put it in its place, and forget the answers.

        Raises:
            PredictionsError: what was written has faults; the file that was there before is left as it was.
            OutputError: it cannot be written.
        """
        if self._has_asked:
            self._refuse_another()  # it may have been put there since
        with replaced(self._path) as partial:
            with HDF5Output(partial) as output:
                self._fill(output, columns)
            self._check(partial)
        if self._has_asked:
            self._kept.forget()

    def _check(self, written: Path) -> None:
        try:
            with SandboxedFile(written) as file:
                Predictions(file, self._about).check()
        except PredictionsError as error:
            raise PredictionsError(str(self._path), error.faults) from None

    def _fill(self, output: HDF5Output, columns: Mapping[str, Column]) -> None:
        if self._path.exists():
            with SandboxedFile(self._path) as before:
                _copy_tracks(before, self._tracks_kept(before), output)
        output.file.attrs.update(self._attributes)
        output.file[IMAGE_INDEX] = np.arange(len(self._dataset), dtype=np.int64)
        for name, column in columns.items():
            _create(output, name, column)

    def _tracks_kept(self, before: SandboxedFile) -> set[str]:
        """Return the tracks that stay as they are."""
        there = {TRACK_OF_DATASET.get(name, THE_FILE) for name in before.datasets}
        return there - {self._track.name, THE_FILE}

    def _refuse_another(self) -> None:
        with output_errors(self._path):
            if not self._path.exists():
                return
        with SandboxedFile(self._path) as before:
            found, datasets, kept = before.attributes, before.datasets, self._tracks_kept(before)
            faults = self._differences(found, kept)
            faults += [
                f"{shown(name)} is {facts.found}; a track cannot be added to such a file"
                for name, facts in datasets.items()
                if facts.found
            ]
            if not faults and kept:
                faults = self._faults_of_kept(before, kept)
        if faults:
            raise PredictionsError(str(self._path), faults)

    def _differences(self, found: Mapping[str, Any], kept: set[str]) -> list[str]:
        shared = {*FILE_ATTRIBUTES, *(name for track in kept for name in TRACKS[track].attributes)}
        compared = [name for name in self._attributes if name in shared]
        return [
            f"is there already, with another {name}: {shown(found.get(name))}; choose another file, or delete it"
            for name in compared
            if found.get(name) != self._attributes[name]
        ]

    def _faults_of_kept(self, before: SandboxedFile, kept: set[str]) -> list[str]:
        """Say why tracks that are to stay cannot be copied: they are broken, or their rows are in another order."""
        if not self._has_images_in_order(before):
            return ["its rows are not in the images' order, which a track that is added has; choose another file"]
        sound = {reader.name for reader in Predictions(before, self._about).readers}
        return [
            f"its track {track!r} has faults, which `symsol-annot validate` lists; choose another file, or delete it"
            for track in sorted(kept - sound)
        ]

    def _has_images_in_order(self, before: SandboxedFile) -> bool:
        facts, count = before.datasets.get(IMAGE_INDEX), len(self._dataset)
        if facts is None or facts.found or facts.shape != (count,):
            return False
        return bool((before.read(IMAGE_INDEX, 0, count) == np.arange(count)).all())


@contextlib.contextmanager
def held_predictions(
    path: str | os.PathLike[str], dataset: Dataset, track: Track, attributes: dict[str, Any], resume: Resume
) -> Iterator[PredictionsFile]:
    """Open a track for writing, and keep other writers of the same file out until it is written.

    Args:
        path: of the predictions file; a relative one is meant from here, wherever the process goes later.
        dataset: the whole split.
        track: what is to be written.
        attributes: of the file, beyond those that follow from the dataset.
        resume: as the writers take it.

    Raises:
        SettingsError: the dataset is a slice, the method's name is none, or `resume` is nothing of the kind.
        NotAnnotatedError: the split has no symmetry sets.
        SealError: the split is sealed, and the track cannot be asked about sealed images.
        PredictionsError: the file is there and about something else.
        OutputError: another process writes the file, or nothing can be written there.
    """
    _refuse_no_dataset(dataset)
    if len(dataset) != dataset.manifest.images(dataset.split) or dataset[0].index != 0:
        raise SettingsError(f"{dataset!r} is a slice; predictions are about a whole split, in its order")
    _refuse_odd_method(attributes["method"])
    check_resume(resume)
    about = subject_of(dataset)  # which refuses a split without symmetry sets before anything is made
    if fault := track.fault_of_sealing(about):
        raise SealError(f"{dataset.folder}: {fault}")
    absolute = Path(os.path.abspath(path))  # noqa: PTH100 - links stay links
    with held_parts(absolute) as parts:
        yield PredictionsFile(absolute, parts, dataset, about, track, attributes)


def _refuse_no_dataset(dataset: Any) -> None:
    if not isinstance(dataset, Dataset):
        line = f'import symsol_annot; dataset = symsol_annot.load({str(dataset)!r}, split="test")'
        found = type(dataset).__name__
        raise SettingsError(f"dataset: expected a split, found {found}; this line opens one:\n    {line}")


def _refuse_odd_method(method: Any) -> None:
    if not is_method_name(method):
        raise SettingsError(f"method: expected {METHOD_NAME_RULE}, found {shown(method)}")


def _copy_tracks(before: SandboxedFile, tracks: set[str], output: HDF5Output) -> None:
    """Copy tracks of a file of unknown origin, which this process does not open, with the attributes that they have."""
    names = {*FILE_ATTRIBUTES, *(name for track in tracks for name in TRACKS[track].attributes)}
    output.file.attrs.update({name: value for name, value in before.attributes.items() if name in names})
    kept = [name for track in TRACKS.values() if track.name in tracks for name in track.datasets]
    for name in (name for name in kept if name in before.datasets):
        facts = before.datasets[name]
        _create(output, name, Column(facts.shape, np.dtype(facts.dtype), _blocks_of(before, name)))


def _blocks_of(before: SandboxedFile, name: str) -> Iterator[Array]:
    facts = before.datasets[name]
    row_bytes = np.dtype(facts.dtype).itemsize * int(np.prod(facts.shape[1:]))
    step = max(1, _COPIED_BYTES // max(1, row_bytes))
    for start in range(0, facts.shape[0], step):
        yield before.read(name, start, min(start + step, facts.shape[0]))


def _create(output: HDF5Output, name: str, column: Column) -> None:
    if 0 in column.shape:
        output.file.create_dataset(name, column.shape, column.dtype, track_times=False)
        return
    row_bytes = column.dtype.itemsize * int(np.prod(column.shape[1:]))
    dataset = output.file.create_dataset(
        name,
        column.shape,
        column.dtype,
        chunks=(max(1, min(column.shape[0], _CHUNK_BYTES // row_bytes)), *column.shape[1:]),
        compression="gzip",
        compression_opts=4,
        shuffle=True,
        fletcher32=True,
        track_times=False,
    )
    start = 0
    for block in column.blocks:
        dataset[start : start + len(block)] = block
        start += len(block)
        output.raise_failure()
