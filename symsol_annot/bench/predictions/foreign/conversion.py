"""From arrays in other forms and frames to what the writers of predictions files take."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.faults import FaultLog
from symsol_annot.bench.predictions.foreign.files import by_image
from symsol_annot.bench.predictions.foreign.forms import to_rotations
from symsol_annot.bench.predictions.foreign.frames import to_opencv
from symsol_annot.bench.predictions.format import IMAGE_INDEX
from symsol_annot.bench.predictions.tracks.table import TRACK_OF_DATASET, TRACKS
from symsol_annot.errors import PredictionsError, SettingsError
from symsol_annot.system.text.names import did_you_mean

_WEIGHTS = ("hypothesis_weights", "weights")
_TOLD = ("object", "split", "fingerprint", "method")  # what a file may say of itself


@dataclass(frozen=True)
class Given:
    """How rotations are given.

    Attributes:
        array: the name of the array that holds them; None for the only one there is.
        form: of `forms.FORMS`; None to tell it from the shape.
        order: of quaternions, "wxyz" or "xyzw".
        frames: of `frames.FRAMES`, undone in that order.
    """

    array: str | None = None
    form: str | None = None
    order: str | None = None
    frames: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class Hypotheses:
    """Hypotheses R_m2c in the order of the images.

    Attributes:
        rotations: (N, M, 3, 3), or N arrays (M_i, 3, 3).
        weights: (N, M) of the former, or None.
    """

    rotations: Array | list[Array]
    weights: Array | None = None


def is_in_the_files_form(arrays: Mapping[str, Array]) -> bool:
    """Tell whether arrays are a classifier's or a density's by the names of docs/submission.md."""
    of_grids = {name for name, track in TRACK_OF_DATASET.items() if track != "hypotheses"}
    return any(name in of_grids for name in arrays)


def columns_of(arrays: Mapping[str, Array]) -> dict[str, dict[str, Any]]:
    """Return track to data sets and attributes, given arrays by those names.

    Raises:
        SettingsError: a name is none of the format.
    """
    attributes = {name for track in TRACKS.values() for name in track.attributes}
    known = [*TRACK_OF_DATASET, *attributes, *_TOLD]
    for name in arrays:
        if name not in known:
            raise SettingsError(f"the array {name!r} is not part of the format{did_you_mean(name, known)}")
    found: dict[str, dict[str, Any]] = {}
    for name, array in arrays.items():
        if name in TRACK_OF_DATASET:
            found.setdefault(TRACK_OF_DATASET[name], {})[name] = array
    for track, columns in found.items():
        columns |= {name: arrays[name].item() for name in TRACKS[track].attributes if name in arrays}
    return found


def to_hypotheses(arrays: Mapping[str, Array], images: int, given: Given) -> Hypotheses:
    """Return hypotheses about every image of a split.

    Args:
        arrays: by name: rotations (N, M, ...), or (N, ...) for one per image; "hypothesis_weights" or "weights" (N, M);
            "image_index" (N,), which image each row is about, without which rows are in the order of the images. With
            fewer axes than that, and several rows per image, a row is one hypothesis.
        images: N.
        given: how the rotations are given.

    Raises:
        SettingsError: it is not clear what the arrays are; the message says what to name.
        RotationError: they are no rotations.
        PredictionsError: images are missing, or are there more than once.
    """
    name = given.array or _only_one(arrays)
    if name not in arrays:
        raise SettingsError(f"there is no array {name!r}{did_you_mean(name, arrays)}")
    array = arrays[name]
    if array.dtype.kind not in "iuf" or array.ndim < 2:
        raise SettingsError(
            f"{name}: expected real numbers with a row per image, found {array.dtype} of shape {array.shape}"
        )
    R = to_opencv(to_rotations(array, given.form, given.order), given.frames)
    weights = next((arrays[other] for other in _WEIGHTS if other in arrays), None)
    index = arrays.get(IMAGE_INDEX)
    if R.ndim == 3 and index is not None:
        return _of_rows(R, weights, np.asarray(index), images)
    R = R[:, None] if R.ndim == 3 else R
    if R.ndim != 4:
        raise SettingsError(f"{name}: expected (images, hypotheses, ...), found {array.ndim} axes: {array.shape}")
    if index is None:
        index = np.arange(images)
        if len(R) != images:
            raise SettingsError(f"{name}: expected a row for each of the {images} images, found {len(R)} rows")
    order = _order(np.asarray(index), images)
    return Hypotheses(R[order], None if weights is None else np.asarray(weights)[order])


def _only_one(arrays: Mapping[str, Array]) -> str:
    """Return the name of the only array that may hold rotations."""
    names = [name for name in arrays if name not in {IMAGE_INDEX, *_WEIGHTS, *_TOLD}]
    if len(names) != 1:
        which = f"these are {', '.join(names)}" if names else "there is none"
        raise SettingsError(f"one array of rotations is read, and {which}: --array names it")
    return names[0]


def _of_rows(R: Array, weights: Array | None, index: Array, images: int) -> Hypotheses:
    """Return hypotheses of which each has a row of its own, which says its image."""
    if index.shape != (len(R),):
        raise SettingsError(
            f"image_index: expected one number per row, {len(R)} of them, found the shape {index.shape}"
        )
    rows = by_image(index, np.arange(len(R)))
    _order(np.array(sorted(rows)), images)
    each = [R[rows[i]] for i in range(images)]
    if weights is None:
        counts = {len(one) for one in each}
        return Hypotheses(np.stack(each) if len(counts) == 1 else each)
    most = max(map(len, each))
    padded, padded_weights = np.tile(np.eye(3), (images, most, 1, 1)), np.zeros((images, most))
    for i, one in enumerate(each):
        padded[i, : len(one)], padded_weights[i, : len(one)] = one, weights[rows[i]]
    return Hypotheses(padded, padded_weights)


def _order(index: Array, images: int) -> Array:
    """Return which row each image has, given which image each row is about."""
    log = FaultLog()
    inside = index[(index >= 0) & (index < images)]
    seen = np.bincount(inside, minlength=images)
    for words, found in (
        (f"of the {images} images are missing", np.flatnonzero(seen == 0)),
        (f"of the {images} images are there more than once", np.flatnonzero(seen > 1)),
        (f"rows are about images outside the {images} of the split", index[(index < 0) | (index >= images)]),
    ):
        if len(found):
            some = ", ".join(str(i) for i in found[:5]) + (", ..." if len(found) > 5 else "")
            log.add("image_index", f"{len(found)} {words}: {some}")
    if log:
        raise PredictionsError("the predictions", log.lines())
    return np.argsort(index, kind="stable")


def told(arrays: Mapping[str, Array], name: str) -> str:
    """Return what arrays say of themselves by a name like "object"; "" where they say nothing."""
    found = arrays.get(name)
    return str(found.item()) if found is not None and found.dtype.kind in "US" and found.size == 1 else ""
