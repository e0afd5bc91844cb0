"""A predictions file that is being written: what was collected for it, and how it is put in its place."""

import contextlib
import io
import json
import shutil
import zipfile
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from symsol_annot.bench.format import (
    FILE_ATTRIBUTES,
    IMAGE_INDEX,
    PREDICTIONS_FORMAT,
    PREDICTIONS_FORMAT_VERSION,
    track_of,
)
from symsol_annot.bench.hdf5_output import HDF5Output
from symsol_annot.bench.predictions import MAX_NAME, Predictions
from symsol_annot.bench.sandbox import SandboxedFile
from symsol_annot.bench.structure import shown
from symsol_annot.bench.truth import truth_of
from symsol_annot.dataset import Dataset
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.files import make_folder, output_errors, replaced, write_atomically

Array = npt.NDArray[Any]
Rows = dict[str, Array]  # what there is of one image, by data set

_CHUNK_BYTES = 2**18
_DAMAGE = (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile)  # what numpy makes of a damaged .npz


@dataclass(frozen=True, eq=False)
class Column:
    """A data set to be written: its shape and type, and its rows in blocks that follow one another."""

    shape: tuple[int, ...]
    dtype: np.dtype[Any]
    blocks: Iterable[Array]

    @classmethod
    def of(cls, array: Array) -> "Column":
        """Return a whole array as a column."""
        return cls(array.shape, array.dtype, [array])


class PredictionsFile:
    """One track on its way into a file, which may hold other tracks of the same method on the same images.

    Raises:
        SettingsError: the dataset is a slice, or the method's name is none.
        NotAnnotatedError: the split has no symmetry sets.
        PredictionsError: the file is there and about something else.
    """

    def __init__(
        self,
        path: Path,
        dataset: Dataset,
        track: str,
        attributes: dict[str, Any],
        settings: dict[str, Any] | None = None,
    ) -> None:
        if len(dataset) != dataset.manifest.images(dataset.split) or dataset[0].index != 0:
            raise SettingsError(f"{dataset!r} is a slice; predictions are about a whole split, in its order")
        _refuse_odd_method(attributes["method"])
        self._path, self._dataset, self._track = path, dataset, track
        self._truth = truth_of(dataset)
        self._attributes = {
            "format": PREDICTIONS_FORMAT,
            "format_version": PREDICTIONS_FORMAT_VERSION,
            "object": dataset.object,
            "split": dataset.split,
            "fingerprint": dataset.fingerprint,
            **attributes,
        }
        self._settings = {**self._attributes, **(settings or {})}
        self._folder, self._has_asked = Path(f"{path}.parts") / track, False
        self._refuse_another()

    def collect(self, ask: Callable[[int], Rows], *, progress: bool) -> "Parts":
        """Ask about every image that was not asked about before; the answers are kept until the file is written."""
        make_folder(self._folder)
        self._refuse_other_parts()
        self._has_asked = True
        parts = Parts(self._folder, len(self._dataset))
        for i in tqdm(range(len(self._dataset)), unit="image", disable=None if progress else True):
            if not parts.has(i):
                parts.write(i, ask(i))
        return parts

    def write(self, columns: Mapping[str, Column]) -> None:
        """Write the file beside its name, check all of it, put it in its place, and forget the answers.

        Raises:
            PredictionsError: what was written has faults; the file that was there before is left as it was.
            OutputError: it cannot be written.
        """
        if self._has_asked:
            self._refuse_another()  # it may have been put there since
        make_folder(self._path.parent)
        with replaced(self._path) as partial:
            with HDF5Output(partial) as output:
                self._fill(output, columns)
            self._check(partial)
        if self._has_asked:
            self._forget_answers()

    def _check(self, written: Path) -> None:
        try:
            with SandboxedFile(written) as file:
                Predictions(file, self._truth).check()
        except PredictionsError as error:
            raise PredictionsError(str(self._path), error.faults) from None

    def _forget_answers(self) -> None:
        shutil.rmtree(self._folder, ignore_errors=True)
        with contextlib.suppress(OSError):  # another track's answers are in it
            self._folder.parent.rmdir()

    def _fill(self, output: HDF5Output, columns: Mapping[str, Column]) -> None:
        file = output.file
        if self._path.exists():
            with h5py.File(self._path, "r") as before:
                file.attrs.update(before.attrs)
                for name in before:
                    if track_of(name) not in (self._track, "the file"):
                        before.copy(name, file)
        file.attrs.update(self._attributes)
        file[IMAGE_INDEX] = np.arange(len(self._dataset), dtype=np.int64)
        for name, column in columns.items():
            _create(output, name, column)

    def _refuse_another(self) -> None:
        with output_errors(self._path):
            if not self._path.exists():
                return
        with SandboxedFile(self._path) as before:
            found, datasets = before.attributes, before.datasets
            kept = {track_of(name) for name in datasets} - {self._track, "the file"}
            is_in_order = not kept or self._has_images_in_order(before)
        shares_grid = bool(kept - {"hypotheses"})
        compared = [name for name in self._attributes if name in FILE_ATTRIBUTES or (shares_grid and "grid" in name)]
        faults = [
            f"is there already, with another {name}: {shown(found.get(name))}; choose another file, or delete it"
            for name in compared
            if found.get(name) != self._attributes[name]
        ]
        faults += [
            f"{shown(name)} is {facts.found}; a track cannot be added to such a file"
            for name, facts in datasets.items()
            if facts.found
        ]
        if not faults and not is_in_order:
            faults.append("its rows are not in the images' order, which a track that is added has; choose another file")
        if faults:
            raise PredictionsError(str(self._path), faults)

    def _has_images_in_order(self, before: SandboxedFile) -> bool:
        facts, count = before.datasets.get(IMAGE_INDEX), len(self._dataset)
        if facts is None or facts.found or facts.shape != (count,):
            return False
        return bool((before.read(IMAGE_INDEX, 0, count) == np.arange(count)).all())

    def _refuse_other_parts(self) -> None:
        note, text = self._folder / "settings.json", json.dumps(self._settings, sort_keys=True)
        if note.exists() and note.read_text() != text:
            raise PredictionsError(
                str(self._folder), ["holds the beginning of other predictions; finish those, or delete the folder"]
            )
        write_atomically(note, text.encode())


class Parts:
    """The answers about single images, a small file each."""

    def __init__(self, folder: Path, images: int) -> None:
        self._folder, self._images = folder, images

    def has(self, i: int) -> bool:
        """Tell whether image i was answered."""
        return self._path(i).exists()

    def write(self, i: int, rows: Rows) -> None:
        """Keep what was answered about image i."""
        buffer = io.BytesIO()
        np.savez(buffer, **rows)
        with replaced(self._path(i)) as partial:  # may be lost with the power: it can be asked for again
            partial.write_bytes(buffer.getvalue())

    def column(self, name: str) -> list[Array]:
        """Return what all images have under a name."""
        return list(self._each(name))

    def dense(self, name: str) -> Column:
        """Return a column with one row an image."""
        first = self._read(0, name)
        return Column((self._images, *first.shape), first.dtype, (rows[None] for rows in self._each(name)))

    def sparse(self, name: str, lengths: Array) -> Column:
        """Return a column with as many entries an image as `lengths` says."""
        return Column((int(lengths.sum()),), self._read(0, name).dtype, self._each(name))

    def lengths(self, name: str) -> npt.NDArray[np.int64]:
        """Return how many entries each image has."""
        return np.array([len(rows) for rows in self._each(name)], dtype=np.int64)

    def _each(self, name: str) -> Iterator[Array]:
        return (self._read(i, name) for i in range(self._images))

    def _read(self, i: int, name: str) -> Array:
        try:
            with self._path(i).open("rb") as file, np.load(file, allow_pickle=False) as part:
                rows: Array = part[name]
        except _DAMAGE as error:
            fault = f"is damaged ({error}); delete it, and the same call asks about image {i} again"
            raise PredictionsError(str(self._path(i)), [fault]) from None
        return rows

    def _path(self, i: int) -> Path:
        return self._folder / f"{i:08d}.npz"


def _refuse_odd_method(method: Any) -> None:
    if not isinstance(method, str) or not method.isprintable() or len(method) > MAX_NAME:
        raise SettingsError(f"method: expected at most {MAX_NAME} printable characters, found {shown(method)}")


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
