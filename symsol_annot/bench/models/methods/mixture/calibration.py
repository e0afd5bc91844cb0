"""Fitting what a mixture claims, on validation images alone."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt
import torch

from symsol_annot.bench.models.methods.mixture.cells import grid_of
from symsol_annot.bench.models.methods.mixture.claims import Calibration, Floats, f_measure
from symsol_annot.bench.models.methods.mixture.image_density import ImageDensity
from symsol_annot.bench.models.methods.mixture.recipe import MARKED_CIRCLE
from symsol_annot.bench.predictions.counted import grid_inside
from symsol_annot.rotations.grid import STANDARD_LEVEL
from symsol_annot.sets.shard.labels import Labels

PRECISIONS = (0.35, 0.5, 0.71, 1.0, 1.41, 2.0, 2.8, 4.0, 5.7)
_THRESHOLDS = (0.06, 0.12, 0.18, 0.25, 0.35, 0.5, 0.71, 0.84, 1.0, 1.19, 1.41, 2.0, 2.8, 4.0, 5.7, 8.0)
_LOGITS = np.linspace(-3.0, 3.0, 25)

Flags = npt.NDArray[np.bool_]
T = TypeVar("T")
Densities = Callable[[Calibration], Iterator[ImageDensity]]


def fit(structure: str, densities: Densities, labels: Labels, few: int) -> tuple[Calibration, float]:
    """Return the calibration with the highest mean F-measure on validation images, and that mean.

    Args:
        structure: of the densities.
        densities: from a calibration to the densities of all images, in order.
        labels: the images'.
        few: how many members a set has at most whose image shows the marking of a body with a circle.
    """
    every = np.ones(len(labels), dtype=bool)
    if structure != MARKED_CIRCLE:

        def with_precision(precision: float) -> tuple[float, Calibration]:
            of_images = _f_measures(densities(Calibration(precision, precision)), labels, every)
            threshold, mean = _best(of_images)
            return mean, Calibration(precision, precision, threshold)

        f, best = climb(PRECISIONS, with_precision)
        return best, f
    is_shown = labels.set_sizes <= few
    best, _ = _fitted(densities, labels, ~is_shown, Calibration(), ("axis_precision", "hidden_threshold"))
    best, _ = _fitted(densities, labels, is_shown, best, ("precision", "threshold"))
    return _with_shown_logit(densities, labels, is_shown, best)


def _fitted(
    densities: Densities, labels: Labels, chosen: Flags, before: Calibration, names: tuple[str, str]
) -> tuple[Calibration, float]:
    """Fit a precision and a threshold, by their names, on the images of one branch, which are told that they are."""
    if not chosen.any():
        return before, 0.0

    def with_precision(precision: float) -> tuple[float, Calibration]:
        one = replace(before, **{names[0]: precision})
        threshold, f = _best(_f_measures(densities(one), labels, chosen, is_shown=names[0] == "precision"))
        return f, replace(one, **{names[1]: threshold})

    f, best = climb(PRECISIONS, with_precision)
    return best, f


def climb(values: Sequence[float], ask: Callable[[float], tuple[float, T]]) -> tuple[float, T]:
    """Return the best answer that is reached from the value 1 by steps to the better neighbour.

    Args:
        values: ascending, 1 among them.
        ask: from a value to how good it is, and an answer; each value is asked about once at most.
    """
    known: dict[int, tuple[float, T]] = {}

    def at(place: int) -> float:
        if not 0 <= place < len(values):
            return -math.inf
        if place not in known:
            known[place] = ask(values[place])
        return known[place][0]

    place = list(values).index(1.0)
    while True:
        better = max((place, place + 1, place - 1), key=at)
        if better == place:
            return known[place]
        place = better


def _with_shown_logit(
    densities: Callable[[Calibration], Iterator[Any]], labels: Labels, is_shown: Flags, before: Calibration
) -> tuple[Calibration, float]:
    """Fit the logit that is added; an image that is taken for what it is not counts as F = 0."""
    rows = []
    every = zip(densities(before), is_shown.tolist(), strict=True)
    for i, (density, shows) in enumerate(every):
        promised = math.log(max(density.shown_threshold[1], 1e-6)) - math.log(max(density.hidden_threshold[1], 1e-6))
        logit = math.log(max(density.probability_shown, 1e-9)) - math.log(max(1.0 - density.probability_shown, 1e-9))
        density.__dict__["takes_it_for_shown"] = shows
        rows.append((logit + promised, float(_of_image(density, labels, i, np.zeros(1))[0])))
    scores, f = np.array(rows).T
    means = [float(np.mean(np.where((scores + logit > 0) == is_shown, f, 0.0))) for logit in _LOGITS]
    best = int(np.argmax(means))
    return replace(before, shown_logit=float(_LOGITS[best])), means[best]


def _f_measures(
    densities: Iterator[ImageDensity], labels: Labels, chosen: Flags, *, is_shown: bool | None = None
) -> Floats:
    """Return the F-measures (n, k) of chosen images at factors of the threshold."""
    rows = []
    for i, density in enumerate(densities):
        if chosen[i]:
            if is_shown is not None:
                density.__dict__["takes_it_for_shown"] = is_shown
            rows.append(_of_image(density, labels, i, np.log(_THRESHOLDS)))
    return np.array(rows)


def _of_image(density: ImageDensity, labels: Labels, i: int, log_factors: Floats) -> Floats:
    near, on_grid = density.claimed_on(grid_of(STANDARD_LEVEL))
    at_members = density.log_claim(torch.from_numpy(labels.members(i)).float()).numpy()
    volume = labels.volume_of(i)
    if volume is None:
        return f_measure(at_members, on_grid.numpy(), log_factors)
    inside = grid_inside(volume, STANDARD_LEVEL)
    is_inside, counts = np.isin(near, inside, assume_unique=True), ~volume.contains(labels.members(i))
    at_set = np.concatenate([at_members[counts], on_grid.numpy()[is_inside]])
    return f_measure(at_set, on_grid.numpy()[~is_inside], log_factors, int(counts.sum()) + len(inside))


def _best(of_images: Floats) -> tuple[float, float]:
    means = of_images.mean(axis=0)
    return _THRESHOLDS[int(means.argmax())], float(means.max())
