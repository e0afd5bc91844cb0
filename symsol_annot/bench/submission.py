"""Writing predictions files: arrays in, or a callable an image, which may be stopped and gone on with.

Each writer takes the split that the predictions are about, as `symsol_annot.load` returns it:

    test = symsol_annot.load("data/cylO")
    write_hypotheses("preds.h5", test, lambda i: model(test[i].image), method="mine")

A second writer adds its track to the same file. What a callable returned is kept beside the file, in `preds.h5.parts`,
until all images are done; the same call goes on from there. A file is put in its place once it passed every check.
"""

import io
import json
import os
import shutil
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeAlias

import h5py
import numpy as np
import numpy.typing as npt
from tqdm import tqdm

from symsol_annot.bench.format import (
    FILE_ATTRIBUTES,
    PREDICTIONS_FORMAT,
    PREDICTIONS_FORMAT_VERSION,
    STANDARD_THRESHOLD,
    TRACKS,
)
from symsol_annot.bench.predictions import Predictions
from symsol_annot.bench.queries import Queries, group_sha256
from symsol_annot.bench.sandbox import SandboxedFile
from symsol_annot.bench.truth import truth_of
from symsol_annot.dataset import Dataset
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.files import make_folder, output_errors
from symsol_annot.grid import STANDARD_LEVEL, equivolumetric_grid, grid_sha256
from symsol_annot.so3 import Rotations, check_rotations

Array: TypeAlias = npt.NDArray[Any]
PathLike: TypeAlias = str | os.PathLike[str]
Rows: TypeAlias = dict[str, Array]  # one image's rows, or entries, by data set

DEFAULT_FLOOR = 0.1
DEFAULT_BATCH = 2**16
DENSITY_FLOOR = 1e-9
_UNLISTED_MASS = 1e-12  # what is left to the cells not listed, at the least
_OFFSETS = {"classifier": "grid_offsets", "density": "density_offsets"}


def write_hypotheses(
    path: PathLike,
    dataset: Dataset,
    hypotheses: Array | Callable[[int], Array],
    *,
    method: str,
    weights: Array | None = None,
    progress: bool = True,
) -> None:
    """Write the track "hypotheses".

    Args:
        path: of the predictions file.
        dataset: the whole split.
        hypotheses: (N, M, 3, 3) R_m2c in the order of the images; or a callable from an image's index to (m, 3, 3),
            where m may differ from image to image: the others are padded with hypotheses of weight 0.
        method: what the method calls itself.
        weights: (N, M), with an array; the precision metrics use them, and 0 means absent.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: a wrong shape, or a slice instead of the whole split.
        RotationError: what the callable returned is no rotation.
        PredictionsError: what was to be written has faults, or the file is there and about something else.
    """
    file = _File(path, dataset, "hypotheses", {"method": method})
    if callable(hypotheses):
        ask = hypotheses
        parts = file.collect(lambda i: {"hypotheses": _checked_hypotheses(ask(i), i)}, progress=progress)
        columns = _padded([part["hypotheses"] for part in parts])
    else:
        columns = {"hypotheses": np.asarray(hypotheses)}
        if weights is not None:
            columns["hypothesis_weights"] = np.asarray(weights)
    file.write(columns, {})


def write_classifier(
    path: PathLike,
    dataset: Dataset,
    classify: Callable[[int, Rotations], Array],
    *,
    method: str,
    floor: float = DEFAULT_FLOOR,
    level: int = STANDARD_LEVEL,
    batch_size: int = DEFAULT_BATCH,
    progress: bool = True,
) -> None:
    """Write the track "classifier", asking at each image's queries and on the grid.

    Args:
        path: of the predictions file.
        dataset: the whole split.
        classify: from an image's index and rotations R_m2c (n, 3, 3) to probabilities (n,) that they are in its set.
        method: what the method calls itself.
        floor: probabilities on the grid up to it are not stored.
        level: of the grid; other levels than the standard one do not rank.
        batch_size: how many rotations are asked about at once.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: a wrong shape or floor, or a slice instead of the whole split.
        PredictionsError: what was to be written has faults, or the file is there and about something else.
    """
    if not 0.0 <= floor <= STANDARD_THRESHOLD:
        raise SettingsError(f"floor: expected 0 to {STANDARD_THRESHOLD}, found {floor}")
    attributes = {"grid_level": level, "grid_sha256": grid_sha256(level), "floor": floor}
    attributes["group_sha256"] = group_sha256(dataset.symmetry_group)
    file = _File(path, dataset, "classifier", {"method": method, **attributes})
    grid, queries = equivolumetric_grid(level), Queries(dataset.fingerprint, dataset.symmetry_group)
    rotation = dataset.labels().rotation

    def ask(i: int) -> Rows:
        at_queries = _ask(classify, i, queries.rotations(i, rotation[i]), batch_size).astype(np.float32)
        on_grid = _ask(classify, i, grid, batch_size).astype(np.float32)
        listed = np.flatnonzero(~(on_grid <= np.float32(floor)))  # NaN is listed, and refused
        return {
            "query_probability": at_queries,
            "grid_indices": listed.astype(np.int32),
            "grid_probabilities": on_grid[listed],
        }

    file.write(*_joined(file.collect(ask, progress=progress), ("query_probability",)))


def write_density(
    path: PathLike,
    dataset: Dataset,
    log_density: Callable[[int, Rotations], Array],
    *,
    method: str,
    floor: float = DENSITY_FLOOR,
    level: int = STANDARD_LEVEL,
    batch_size: int = DEFAULT_BATCH,
    progress: bool = True,
) -> None:
    """Write the track "density", asking on the grid and making the cells' probabilities add up to 1.

    Args:
        path: of the predictions file.
        dataset: the whole split.
        log_density: from an image's index and rotations R_m2c (n, 3, 3) to log-densities (n,), up to a constant an
            image.
        method: what the method calls itself.
        floor: cells with a probability up to it are not stored; they share what is left evenly.
        level: of the grid; other levels than the standard one do not rank.
        batch_size: how many rotations are asked about at once.
        progress: show a bar where standard error is a terminal.

    Raises:
        SettingsError: a wrong shape, or a slice instead of the whole split.
        PredictionsError: what was to be written has faults, or the file is there and about something else.
    """
    attributes = {"grid_level": level, "grid_sha256": grid_sha256(level)}
    file = _File(path, dataset, "density", {"method": method, **attributes}, {"floor": floor})
    grid = equivolumetric_grid(level)

    def ask(i: int) -> Rows:
        log_p = _ask(log_density, i, grid, batch_size)
        log_p = log_p - log_p.max()
        log_p -= np.log(np.exp(log_p).sum())
        return _listed_density(log_p, floor)

    file.write(*_joined(file.collect(ask, progress=progress), ()))


def write_columns(
    path: PathLike, dataset: Dataset, track: str, columns: Mapping[str, Array], *, method: str, **attributes: Any
) -> None:
    """Write a track from arrays that have the form of the file already (docs/submission.md), images in order.

    Raises:
        SettingsError: there is no such track, or the dataset is a slice.
        PredictionsError: the arrays have faults, or the file is there and about something else.
    """
    if track not in TRACKS:
        raise SettingsError(f"there is no track {track!r}; tracks are {', '.join(TRACKS)}")
    if track != "hypotheses":
        level = attributes.setdefault("grid_level", STANDARD_LEVEL)
        attributes.setdefault("grid_sha256", grid_sha256(level))
    if track == "classifier":
        attributes.setdefault("group_sha256", group_sha256(dataset.symmetry_group))
        attributes.setdefault("floor", DEFAULT_FLOOR)
    _File(path, dataset, track, {"method": method, **attributes}).write(columns, {})


class _File:
    """A predictions file that is being written: what was collected for it, and how it is put in place."""

    def __init__(
        self,
        path: PathLike,
        dataset: Dataset,
        track: str,
        attributes: dict[str, Any],
        settings: dict[str, Any] | None = None,
    ) -> None:
        if len(dataset) != dataset.manifest.images(dataset.split):
            raise SettingsError(f"{dataset!r} is a slice; predictions are about a whole split")
        self._path, self._dataset, self._track = Path(path), dataset, track
        about = {"object": dataset.object, "split": dataset.split, "fingerprint": dataset.fingerprint}
        self._attributes = {
            "format": PREDICTIONS_FORMAT,
            "format_version": PREDICTIONS_FORMAT_VERSION,
            **about,
            **attributes,
        }
        self._settings = {**self._attributes, **(settings or {})}
        self._parts = Path(f"{path}.parts") / track
        self._refuse_another()

    def collect(self, ask: Callable[[int], Rows], *, progress: bool) -> list[Rows]:
        """Ask about every image that was not asked about before; what is answered is kept."""
        make_folder(self._parts)
        self._refuse_other_parts()
        for i in tqdm(range(len(self._dataset)), unit="image", disable=None if progress else True):
            part = self._part(i)
            if not part.exists():
                _write_part(part, ask(i))
        return [_read_part(self._part(i)) for i in range(len(self._dataset))]

    def write(self, columns: Mapping[str, Array], offsets: Mapping[str, Array]) -> None:
        """Write the file beside its name, check all of it, put it in place and forget the parts."""
        partial = self._path.with_name(f".{self._path.name}.partial")
        try:
            with output_errors(self._path), h5py.File(partial, "w", libver=("earliest", "v108")) as file:
                self._copy_other_tracks(file)
                file.attrs.update(self._attributes)
                if "image_index" not in file:
                    file["image_index"] = np.arange(len(self._dataset), dtype=np.int64)
                for name, column in {**columns, **offsets}.items():
                    _create(file, name, column)
            with SandboxedFile(partial) as written:
                Predictions(written, truth_of(self._dataset)).check()
            with output_errors(self._path):
                partial.replace(self._path)
        except PredictionsError as error:
            raise PredictionsError(str(self._path), error.faults) from None
        finally:
            partial.unlink(missing_ok=True)
        shutil.rmtree(self._parts, ignore_errors=True)
        if self._parts.parent.is_dir() and not any(self._parts.parent.iterdir()):
            self._parts.parent.rmdir()

    def _copy_other_tracks(self, file: h5py.File) -> None:
        if self._path.exists():
            with h5py.File(self._path, "r") as before:
                file.attrs.update(before.attrs)
                for name in before:
                    if name not in TRACKS[self._track]:
                        before.copy(name, file)

    def _refuse_another(self) -> None:
        """Refuse to add to a file that is about something else, before anything is asked."""
        if not self._path.exists():
            return
        with SandboxedFile(self._path) as before:
            found, names = before.attributes, before.datasets
        shares_grid = any(name in names for track in TRACKS if track != self._track for name in TRACKS[track])
        compared = [name for name in self._attributes if name in FILE_ATTRIBUTES or (shares_grid and name in found)]
        differing = [name for name in compared if found.get(name) != self._attributes[name]]
        if differing:
            raise PredictionsError(
                str(self._path),
                [
                    f"is there already, with another {name}: {found.get(name)!r}; choose another file"
                    for name in differing
                ],
            )

    def _refuse_other_parts(self) -> None:
        note, text = self._parts / "settings.json", json.dumps(self._settings, sort_keys=True)
        if note.exists() and note.read_text() != text:
            raise PredictionsError(
                str(self._parts), ["holds the beginning of other predictions; finish those, or delete the folder"]
            )
        with output_errors(note):
            note.write_text(text)

    def _part(self, i: int) -> Path:
        return self._parts / f"{i:08d}.npz"


def _checked_hypotheses(returned: Array, i: int) -> Array:
    hypotheses = np.asarray(returned)
    if hypotheses.ndim != 3 or len(hypotheses) == 0 or hypotheses.dtype not in (np.float32, np.float64):
        raise SettingsError(
            f"hypotheses of image {i}: expected float32 or float64 of shape (m, 3, 3), "
            f"found {hypotheses.dtype} of shape {hypotheses.shape}"
        )
    check_rotations(hypotheses, f"hypotheses of image {i}", 1e-5 if hypotheses.dtype == np.float32 else 1e-6)
    return hypotheses


def _padded(hypotheses: list[Array]) -> dict[str, Array]:
    most = max(len(h) for h in hypotheses)
    rows = np.tile(np.eye(3, dtype=np.result_type(*hypotheses)), (len(hypotheses), most, 1, 1))
    weights = np.zeros((len(hypotheses), most), dtype=np.float32)
    for row, weight, h in zip(rows, weights, hypotheses, strict=True):
        row[: len(h)], weight[: len(h)] = h, 1.0
    return {"hypotheses": rows} if weights.all() else {"hypotheses": rows, "hypothesis_weights": weights}


def _ask(
    f: Callable[[int, Rotations], Array], i: int, rotations: Rotations, batch_size: int
) -> npt.NDArray[np.float64]:
    answers = []
    for start in range(0, len(rotations), batch_size):
        batch = rotations[start : start + batch_size]
        answer = np.asarray(f(i, batch), dtype=np.float64)
        if answer.shape != (len(batch),):
            raise SettingsError(
                f"image {i}: asked about {len(batch)} rotations, the answer has the shape {answer.shape}"
            )
        answers.append(answer)
    return np.concatenate(answers)


def _listed_density(log_p: npt.NDArray[np.float64], floor: float) -> Rows:
    listed = np.flatnonzero(~(log_p <= np.log(floor)))
    kept = log_p[listed]
    if len(listed) < len(log_p):
        mass = np.exp(kept).sum()
        kept = kept - max(0.0, np.log(mass) - np.log1p(-_UNLISTED_MASS)) if mass > 0 else kept
    return {"density_indices": listed.astype(np.int32), "density_log_probabilities": np.minimum(kept, 0.0)}


def _joined(parts: list[Rows], dense: tuple[str, ...]) -> tuple[dict[str, Array], dict[str, Array]]:
    """Return the columns of all images, and the offsets of the sparse ones."""
    names = list(parts[0])
    columns = {name: (np.stack if name in dense else np.concatenate)([part[name] for part in parts]) for name in names}
    sparse = next(name for name in names if name not in dense)
    offsets = np.concatenate([[0], np.cumsum([len(part[sparse]) for part in parts])]).astype(np.int64)
    return columns, {sparse.replace("indices", "offsets"): offsets}


def _create(file: h5py.File, name: str, column: Array) -> None:
    if column.size == 0:
        file.create_dataset(name, data=column, track_times=False)
        return
    rows = max(1, min(len(column), 2**20 // max(1, column[:1].nbytes)))
    file.create_dataset(
        name,
        data=column,
        chunks=(rows, *column.shape[1:]),
        compression="gzip",
        compression_opts=4,
        shuffle=True,
        fletcher32=True,
        track_times=False,
    )


def _write_part(path: Path, rows: Rows) -> None:
    buffer = io.BytesIO()
    np.savez(buffer, **rows)
    with output_errors(path):
        partial = path.with_suffix(".partial")
        partial.write_bytes(buffer.getvalue())
        partial.replace(path)


def _read_part(path: Path) -> Rows:
    with np.load(path, allow_pickle=False) as part:
        return {name: part[name] for name in part.files}
