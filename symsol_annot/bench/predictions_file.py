"""A predictions file that is being written: what was collected for it, and how it is put in its place."""

import io
import json
import shutil
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
from symsol_annot.bench.predictions import Predictions
from symsol_annot.bench.sandbox import SandboxedFile
from symsol_annot.bench.truth import truth_of
from symsol_annot.dataset import Dataset
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.files import make_folder, output_errors

Array = npt.NDArray[Any]
Rows = dict[str, Array]  # what there is of one image, by data set

_CHUNK_BYTES = 2**18
_CACHE_BYTES = 2**26


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
        SettingsError: the dataset is a slice.
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
        if len(dataset) != dataset.manifest.images(dataset.split):
            raise SettingsError(f"{dataset!r} is a slice; predictions are about a whole split")
        self._path, self._dataset, self._track = path, dataset, track
        self._attributes = {
            "format": PREDICTIONS_FORMAT,
            "format_version": PREDICTIONS_FORMAT_VERSION,
            "object": dataset.object,
            "split": dataset.split,
            "fingerprint": dataset.fingerprint,
            **attributes,
        }
        self._settings = {**self._attributes, **(settings or {})}
        self._folder = Path(f"{path}.parts") / track
        self._refuse_another()

    def collect(self, ask: Callable[[int], Rows], *, progress: bool) -> "Parts":
        """Ask about every image that was not asked about before; the answers are kept until the file is written."""
        make_folder(self._folder)
        self._refuse_other_parts()
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
        partial = self._path.with_name(f".{self._path.name}.partial")
        try:
            with output_errors(self._path):
                self._write_to(partial, columns)
            with SandboxedFile(partial) as written:
                Predictions(written, truth_of(self._dataset)).check()
            with output_errors(self._path):
                partial.replace(self._path)
        except PredictionsError as error:
            raise PredictionsError(str(self._path), error.faults) from None
        finally:
            partial.unlink(missing_ok=True)
        shutil.rmtree(self._folder, ignore_errors=True)
        if self._folder.parent.is_dir() and not any(self._folder.parent.iterdir()):
            self._folder.parent.rmdir()

    def _write_to(self, path: Path, columns: Mapping[str, Column]) -> None:
        with h5py.File(path, "w", libver=("earliest", "v108"), rdcc_nbytes=_CACHE_BYTES) as file:
            if self._path.exists():
                with h5py.File(self._path, "r") as before:
                    file.attrs.update(before.attrs)
                    for name in before:
                        if track_of(name) not in (self._track, "the file"):
                            before.copy(name, file)
            file.attrs.update(self._attributes)
            file[IMAGE_INDEX] = np.arange(len(self._dataset), dtype=np.int64)
            for name, column in columns.items():
                _create(file, name, column)

    def _refuse_another(self) -> None:
        if not self._path.exists():
            return
        with SandboxedFile(self._path) as before:
            found, tracks = before.attributes, {track_of(name) for name in before.datasets}
        shares_grid = bool(tracks - {self._track, "hypotheses", "the file"})
        compared = [name for name in self._attributes if name in FILE_ATTRIBUTES or (shares_grid and "grid" in name)]
        faults = [
            f"is there already, with another {name}: {found.get(name)!r}; choose another file, or delete it"
            for name in compared
            if found.get(name) != self._attributes[name]
        ]
        if faults:
            raise PredictionsError(str(self._path), faults)

    def _refuse_other_parts(self) -> None:
        note, text = self._folder / "settings.json", json.dumps(self._settings, sort_keys=True)
        if note.exists() and note.read_text() != text:
            raise PredictionsError(
                str(self._folder), ["holds the beginning of other predictions; finish those, or delete the folder"]
            )
        with output_errors(note):
            note.write_text(text)


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
        partial = self._path(i).with_suffix(".partial")
        with output_errors(self._path(i)):
            partial.write_bytes(buffer.getvalue())
            partial.replace(self._path(i))

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
        with np.load(self._path(i), allow_pickle=False) as part:
            rows: Array = part[name]
        return rows

    def _path(self, i: int) -> Path:
        return self._folder / f"{i:08d}.npz"


def _create(file: h5py.File, name: str, column: Column) -> None:
    if 0 in column.shape:
        file.create_dataset(name, column.shape, column.dtype, track_times=False)
        return
    row_bytes = column.dtype.itemsize * int(np.prod(column.shape[1:]))
    dataset = file.create_dataset(
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
