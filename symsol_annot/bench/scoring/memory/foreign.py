"""Scoring an .npz as it is, where what it holds has one meaning."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.foreign.conversion import (
    Given,
    columns_of,
    is_in_the_files_form,
    to_hypotheses,
    told,
)
from symsol_annot.bench.predictions.foreign.files import read_arrays
from symsol_annot.bench.predictions.truth import find_set
from symsol_annot.bench.scoring.memory.in_memory import score
from symsol_annot.bench.scoring.scoring import ObjectScores
from symsol_annot.errors import DataError, PredictionsError, RotationError, SettingsError
from symsol_annot.sets.dataset import Dataset, load
from symsol_annot.sets.folders import set_folders
from symsol_annot.system.reading import file_sha256
from symsol_annot.system.text.names import is_method_name


def score_npz(path: Path, data: Path) -> ObjectScores:
    """Score an .npz of rotation matrices (N, M, 3, 3) R_m2c, or of arrays by the names of docs/submission.md.

    Args:
        path: of the file; its name is the method's, unless the file says one.
        data: the set that it is about, or the folder of that set alone; the file may say the object and the split.

    Raises:
        PredictionsError: it is damaged, or what it holds has more than one meaning; the message has the command that
            converts it.
        DataError: it is not clear which set it is about.
    """
    arrays = read_arrays(path)
    dataset = split_of(arrays, data)
    method = told(arrays, "method") or path.stem
    try:
        predictions = _predictions(arrays, len(dataset))
        found = score(predictions, dataset, method=method if is_method_name(method) else "npz")
    except (SettingsError, RotationError) as error:
        line = f"symsol-annot convert {path} --data {dataset.folder} --split {dataset.split} --out preds.h5"
        fault = f"{error}; `{line}` takes it in other forms and frames, which it is told"
        raise PredictionsError(str(path), [fault]) from None
    return replace(found.scored, file=path.name, sha256=file_sha256(path))


def split_of(arrays: Mapping[str, Array], data: Path, split: str = "", object_name: str = "") -> Dataset:
    """Return the split that arrays are about: what they say, else the test split of the only set under `data`.

    Args:
        arrays: which may say "object" and "split".
        data: a set's folder, or the folder of sets.
        split: its name, where the caller knows it.
        object_name: the object's name, where the caller knows it.

    Raises:
        DataError: there is no such set, or there are several.
    """
    name = object_name or told(arrays, "object")
    folders = set_folders(data)
    if name:
        folder = find_set(data, name)
    elif len(folders) == 1:
        (folder,) = folders
    else:
        names = ", ".join(str(folder) for folder in folders)
        there = f"holds several sets: {names}" if folders else "holds no set"
        raise DataError(f"{data}: {there}; --data names the set that the predictions are about")
    return load(folder, split or told(arrays, "split") or "test")


def _predictions(arrays: Mapping[str, Array], images: int) -> object:
    """Return what `score` takes."""
    if is_in_the_files_form(arrays):
        by_track = columns_of(arrays)
        return {name: value for columns in by_track.values() for name, value in columns.items()}
    hypotheses = to_hypotheses(arrays, images, Given())
    if hypotheses.weights is None:
        return hypotheses.rotations
    return {"hypotheses": hypotheses.rotations, "hypothesis_weights": hypotheses.weights}
