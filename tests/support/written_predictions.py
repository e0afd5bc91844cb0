"""The three tracks written by their callables, and what is in the files that they make."""

from itertools import pairwise

import h5py
import numpy as np
import pytest
from methods import random_rotations

from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses

IMAGES, LEVEL, CELLS = 24, 0, 72


METHOD = "test's method"


def probability(i, R):
    """Of an image and rotations; nothing special."""
    return 0.5 + 0.5 * np.sin(7.0 * R[:, 0, 0] + 5.0 * R[:, 1, 2] + i)


def log_density(i, R):
    return 4.0 * R[:, 0, 0] + R[:, 2, 1] - 100.0 * i


def hypothesise(i):
    return random_rotations()[i]


def write(track, path, dataset, answer=None, *, method=METHOD, **options):
    """Write a track by its callable; `answer` is asked instead of the usual function."""
    if track == "hypotheses":
        write_hypotheses(path, dataset, answer or hypothesise, method=method, **options)
    elif track == "classifier":
        write_classifier(path, dataset, answer or probability, **{"method": method, "level": LEVEL, **options})
    else:
        write_density(path, dataset, answer or log_density, **{"method": method, "level": LEVEL, **options})


def usual(track):
    return {"hypotheses": hypothesise, "classifier": probability, "density": log_density}[track]


def contents(path):
    """The data sets and the attributes."""
    with h5py.File(path) as file:
        return {name: file[name][...] for name in file}, dict(file.attrs)


def rows_of(values, offsets):
    return [values[a:b] for a, b in pairwise(offsets)]


def left_beside(path):
    return sorted(p.name for p in path.parent.iterdir() if p.name != path.name)


every_track = pytest.mark.parametrize("track", list(TRACKS))


def refuse_to_answer(*_):
    pytest.fail("was asked")


class Interrupted:
    """Answers as usual, until the image at which it fails; notes which images it was asked about."""

    def __init__(self, track, failing_at=None, error=RuntimeError):
        self._answer, self._failing_at, self._error, self.asked = usual(track), failing_at, error, []

    def __call__(self, i, *R):
        if i == self._failing_at:
            raise self._error("out of memory")
        self.asked.append(i)
        return self._answer(i, *R)
