"""Results as BOP has them, a CSV with a pose per line, written as a predictions file of the track "hypotheses".

    scene_id,im_id,obj_id,score,R,t,time

R is nine numbers row by row, t three, with spaces between. The rotations are scored; t and time are not looked at.
"""

import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.format import MAX_HYPOTHESES, ROTATION_TOLERANCE
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.bop.numbering import FIRST_SCENE, index_of
from symsol_annot.errors import DataError, bulleted, count_of, first_of
from symsol_annot.rotations.so3 import Rotations, rotation_deviation
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.reading import read_text

HEADER = "scene_id,im_id,obj_id,score,R,t,time"
_FIELDS, _IDS = len(HEADER.split(",")), ("scene_id", "im_id", "obj_id")
_MAX_BYTES = 2**32
_SHOWN_FAULTS = 20
_SHOWN_IMAGES = 8
_TOLERANCE = ROTATION_TOLERANCE["<f8"]


@dataclass(frozen=True, eq=False)
class BopResults:
    """What a CSV says of one object, n poses in the order of their images.

    Attributes:
        index: (n,) which image of the split each is about.
        rotation: (n, 3, 3) R_m2c.
        score: (n,) how sure the method is, at least 0.
        others: how many poses the file has of other objects.
    """

    index: npt.NDArray[np.int64]
    rotation: Rotations
    score: npt.NDArray[np.float64]
    others: int


def read_results(
    path: Path, images: int, obj_id: int = 1, first_scene: int = FIRST_SCENE, *, alike: bool = False
) -> BopResults:
    """Read BOP's results of one object.

    Args:
        path: of the CSV; its first line may be the header.
        images: how many images the split has.
        obj_id: the object's id in the file.
        first_scene: the id of the object's first scene.
        alike: whether scores are left out, so that every estimate counts the same.

    Raises:
        DataError: it cannot be read or has faults, all of which are listed with their lines, up to 20.
    """
    try:
        text = read_text(path, _MAX_BYTES)
    except UnicodeDecodeError:
        raise DataError(f"{path}: is no CSV of BOP: it is no text in UTF-8") from None
    except OSError as error:
        raise DataError(f"{path}: cannot be read: {error.strerror}") from None
    faults: list[str] = []
    poses, numbers, others = [], [], 0
    for number, line in _lines(text):
        try:
            pose = _pose(line, images, obj_id, first_scene, alike=alike)
        except (ValueError, DataError) as error:
            faults.append(f"line {number}: {error}")
            continue
        if pose is None:
            others += 1
        else:
            poses.append(pose)
            numbers.append(number)
    table = np.array(poses, dtype=np.float64).reshape(-1, 11)
    rotation = table[:, 2:].reshape(-1, 3, 3)
    off = rotation_deviation(rotation)
    faults += [
        f"line {numbers[row]}: R is no rotation: R^T R = I and det R = 1 are off by {off[row]:.2g} "
        f"(allowed {_TOLERANCE:g})"
        for row in np.flatnonzero(~(off <= _TOLERANCE))
    ]
    if not poses and not faults:
        found = f"has {others} poses of other objects; --obj-id says which is meant" if others else "has no poses"
        faults.append(f"expected poses of object {obj_id}: the file {found}")
    if faults:
        more = [f"and {len(faults) - _SHOWN_FAULTS} more"] if len(faults) > _SHOWN_FAULTS else []
        listed = bulleted([*faults[:_SHOWN_FAULTS], *more])
        raise DataError(f"{path}: {count_of(faults)}; docs/bop.md says what belongs there:\n{listed}")
    order = np.argsort(table[:, 0], kind="stable")
    score = np.ones(len(table)) if alike else table[order, 1]
    return BopResults(table[order, 0].astype(np.int64), rotation[order], score, others)


def write_results(path: Path, dataset: Dataset, results: BopResults, *, method: str, fill_missing: bool) -> int:
    """Write results as a predictions file, whose weights are the scores.

    Where all scores are alike there are no weights. Images with fewer estimates than others are padded with weight 0.

    Args:
        path: of the predictions file.
        dataset: the whole split that the results are about.
        results: as `read_results` returned them.
        method: what the method calls itself.
        fill_missing: whether an image without an estimate gets the identity for one; else it is refused.

    Returns:
        How many images had no estimate.

    Raises:
        DataError: images without an estimate, or one with too many.
        SymsolError: as `write_hypotheses`.
    """
    counts = np.bincount(results.index[results.score > 0], minlength=len(dataset))
    missing = np.flatnonzero(counts == 0)
    if len(missing) and not fill_missing:
        names = first_of([str(index) for index in missing], _SHOWN_IMAGES)
        raise DataError(
            f"{len(missing)} of {len(dataset)} images have no estimate with a score above 0: images {names}. Every "
            "image of the split needs one; --fill-missing gives these the identity"
        )
    if counts.max() > MAX_HYPOTHESES:
        image = int(counts.argmax())
        raise DataError(f"image {image} has {counts[image]} estimates; expected at most {MAX_HYPOTHESES}")
    most = max(int(counts.max()), 1)
    hypotheses = np.tile(np.eye(3), (len(dataset), most, 1, 1))
    weights = np.zeros((len(dataset), most))
    weights[missing, 0] = 1.0
    is_there = results.score > 0
    index = results.index[is_there]
    place = np.arange(len(index)) - np.searchsorted(index, index)  # within its image
    hypotheses[index, place] = results.rotation[is_there]
    weights[index, place] = results.score[is_there]
    given = None if np.all(weights == weights[0, 0]) else weights
    write_hypotheses(path, dataset, hypotheses, method=method, weights=given)
    return len(missing)


def _lines(text: str) -> Iterator[tuple[int, str]]:
    """Yield the lines that hold something, but for the header, with their numbers."""
    for number, line in enumerate(io.StringIO(text), start=1):
        stripped = line.strip()
        if stripped and not (number == 1 and HEADER in stripped):
            yield number, stripped


def _pose(line: str, images: int, obj_id: int, first_scene: int, *, alike: bool) -> tuple[float, ...] | None:
    """Return the image's index, the score and R's nine numbers; None for a pose of another object."""
    fields = line.split(",")
    if len(fields) != _FIELDS:
        raise ValueError(f"expected {_FIELDS} fields, {HEADER}, found {len(fields)}")
    scene_id, im_id, found_id = (_whole(field, name) for field, name in zip(fields[:3], _IDS, strict=True))
    if found_id != obj_id:
        return None
    index = index_of(first_scene, scene_id, im_id)
    if index >= images:
        raise ValueError(f"scene_id {scene_id}, im_id {im_id} is image {index}, and the split has {images} images")
    (score,) = _numbers(fields[3], 1, "score")
    R = _numbers(fields[4], 9, "R")
    _numbers(fields[5], 3, "t")
    if score < 0 and not alike:
        raise ValueError(f"score {score:g}: scores become weights, which are at least 0; --alike leaves them out")
    return (index, score, *R)


def _whole(text: str, name: str) -> int:
    try:
        return int(text)
    except ValueError:
        raise ValueError(f"{name}: expected a whole number, found {text[:40]!r}") from None


def _numbers(text: str, count: int, name: str) -> list[float]:
    try:
        numbers = [float(word) for word in text.split()]
    except ValueError:
        numbers = []
    if len(numbers) != count or not all(math.isfinite(number) for number in numbers):
        what = "a finite number" if count == 1 else f"{count} finite numbers with spaces between"
        raise ValueError(f"{name}: expected {what}, found {text[:40]!r}")
    return numbers
