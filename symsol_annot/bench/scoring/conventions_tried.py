"""Would predictions that fit no better than chance fit in another convention of rotations?

Transposed matrices, a camera that looks along -z, another model frame and quaternions read in the wrong order all give
rotations that pass every check, and a table of scores that says nothing of the reason.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.truth import Truth
from symsol_annot.rotations.nearest import nearest_angles_both_ways
from symsol_annot.rotations.so3 import Rotations, quat_wxyz_to_rotation, rotation_to_quat_wxyz, rotations_about

_IMAGES = 64  # are looked at, evenly over the split
_LEAST_IMAGES = 10  # under which chance is not known well enough
_ROTATIONS = 64  # per image
_MEMBERS = 720  # per image
_NEAR_CHANCE = 0.6  # of the error of predictions that belong to other images
_FAR_BETTER = 3.0  # times

_FLIP = np.diag([1.0, -1.0, -1.0])  # between a camera that looks along z, y down, and one that looks along -z, y up
_Z_UP = rotations_about((1.0, 0.0, 0.0), np.pi / 2.0)  # takes y to z: a model whose z is up, as one whose y is


@dataclass(frozen=True)
class Convention:
    """A way in which somebody may have meant rotations.

    Attributes:
        words: what it is called: "transposed".
        code: what to write in place of R.
        to_ours: takes (n, 3, 3) rotations as they stand in a file to what they would be here.
    """

    words: str
    code: str
    to_ours: Callable[[Rotations], Rotations]


def _transposed(R: Rotations) -> Rotations:
    return np.swapaxes(R, -1, -2)


def _quaternions_turned(R: Rotations, places: int) -> Rotations:
    return quat_wxyz_to_rotation(np.roll(rotation_to_quat_wxyz(R), places, axis=-1))


_D = "np.diag([1, -1, -1])"
_T = "R.swapaxes(-1, -2)"
_X = "Rotation.from_euler('x', {}, degrees=True).as_matrix()"
_QUATERNIONS = "quat_wxyz_to_rotation(np.roll(rotation_to_quat_wxyz(R), {}, axis=-1))"
CONVENTIONS = (  # the plainest first: where the body's symmetries make several alike, the first is named
    Convention("transposed", _T, _transposed),
    Convention("with the camera of OpenGL and Blender", f"{_D} @ R", lambda R: _FLIP @ R),
    Convention("with the model's y and z reversed", f"R @ {_D}", lambda R: R @ _FLIP),
    Convention("with camera's and model's y and z reversed", f"{_D} @ R @ {_D}", lambda R: _FLIP @ R @ _FLIP),
    Convention("transposed, with the camera of OpenGL and Blender", f"{_D} @ {_T}", lambda R: _FLIP @ _transposed(R)),
    Convention("transposed, with the model's y and z reversed", f"{_T} @ {_D}", lambda R: _transposed(R) @ _FLIP),
    Convention(
        "transposed, with camera's and model's y and z reversed",
        f"{_D} @ {_T} @ {_D}",
        lambda R: _FLIP @ _transposed(R) @ _FLIP,
    ),
    Convention("with the model's y up", f"R @ {_X.format(-90)}", lambda R: R @ _Z_UP.T),
    Convention("with the model's z up where y was", f"R @ {_X.format(90)}", lambda R: R @ _Z_UP),
    Convention("with quaternions read as (x, y, z, w)", _QUATERNIONS.format(1), lambda R: _quaternions_turned(R, 1)),
    Convention("with quaternions read as (w, x, y, z)", _QUATERNIONS.format(-1), lambda R: _quaternions_turned(R, -1)),
)


@dataclass(frozen=True)
class _Errors:
    """The means over images of the recall and the precision error, in rad."""

    recall: float
    precision: float


class ConventionsTried:
    """Some images' rotations as a file has them, tried in other conventions once all are there.

    Attributes:
        truth: what they are held against.
        found: image to the rotations that were kept.
    """

    def __init__(self, truth: Truth) -> None:
        self.truth = truth
        count = min(len(truth), _IMAGES)
        self._wanted = frozenset(np.linspace(0, len(truth) - 1, count).astype(int).tolist())
        self.found: dict[int, Rotations] = {}

    def wants(self, image: int) -> bool:
        """Tell whether this image is one of those that are looked at."""
        return image in self._wanted

    def add(self, image: int, rotations: Rotations) -> None:
        """Take an image's rotations (n, 3, 3); of many, some are kept."""
        if len(rotations):
            self.found[image] = rotations[_evenly(len(rotations), _ROTATIONS)]

    def notes(self, advice: str) -> tuple[str, ...]:
        """Return a line where the rotations are no better than chance, and far better in another convention.

        Args:
            advice: what to do, with "{code}" where the convention's code belongs.
        """
        images = sorted(self.found)
        if len(images) < _LEAST_IMAGES:
            return ()
        given = [self.found[i] for i in images]
        as_given = self._errors(images, given)
        of_others = self._errors(images, given[len(given) // 2 :] + given[: len(given) // 2])
        if as_given.recall < _NEAR_CHANCE * of_others.recall or as_given.precision < _NEAR_CHANCE * of_others.precision:
            return ()
        tried = [(c, self._errors(images, [c.to_ours(R) for R in given])) for c in CONVENTIONS]
        found = [_note(c, as_given, errors, advice) for c, errors in tried if _is_far_better(errors, as_given)]
        gains = [_gain(errors, as_given) for _, errors in tried if _is_far_better(errors, as_given)]
        if not found:
            return ()
        best = next(n for n, gain in enumerate(gains) if gain >= 0.9 * max(gains))
        return (found[best],)

    def _errors(self, images: Sequence[int], rotations: Sequence[Rotations]) -> _Errors:
        labels = self.truth.labels
        recall, precision = np.zeros((2, len(images)))
        for n, (i, R) in enumerate(zip(images, rotations, strict=True)):
            volume, members = labels.volume_of(i), labels.members(i)
            if volume is not None:
                members = volume.sample(_MEMBERS, np.random.default_rng(0))
            of_members, of_predictions = nearest_angles_both_ways(members[_evenly(len(members), _MEMBERS)], R)
            if volume is not None:
                of_predictions = volume.distance(R)
            recall[n], precision[n] = of_members.mean(), of_predictions.mean()
        return _Errors(float(recall.mean()), float(precision.mean()))


def _evenly(count: int, most: int) -> npt.NDArray[np.intp]:
    """Return up to `most` indices of `count` things, evenly over them."""
    return np.linspace(0, count - 1, min(count, most)).astype(np.intp)


def _gain(errors: _Errors, as_given: _Errors) -> float:
    """Return by which factor the better of the two errors is smaller."""
    least = 1e-6  # rad; the truth's own errors are 0
    return max(
        as_given.recall / max(errors.recall, least),
        as_given.precision / max(errors.precision, least),
    )


def _is_far_better(errors: _Errors, as_given: _Errors) -> bool:
    is_worse = errors.recall > 1.1 * as_given.recall or errors.precision > 1.1 * as_given.precision
    return not is_worse and _gain(errors, as_given) >= _FAR_BETTER


def _note(convention: Convention, as_given: _Errors, errors: _Errors, advice: str) -> str:
    is_recall = as_given.recall / max(errors.recall, 1e-6) >= as_given.precision / max(errors.precision, 1e-6)
    what = "recall" if is_recall else "precision"
    before, after = (one.recall if is_recall else one.precision for one in (as_given, errors))
    times = f"{before / after:.0f} times better" if before < 1e4 * after else "exactly"
    return (
        f"the {what} error of its rotations, {before:.3f} rad, is that of rotations that know nothing of the image; "
        f"{convention.words} it is {after:.3f} rad, so that they fit {times}. If that is how they are meant, "
        f"{advice.format(code=convention.code)} (docs/conventions.md)"
    )
