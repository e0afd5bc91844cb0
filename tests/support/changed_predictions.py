"""Changes of a valid predictions file, each of which a reader has to name or to take as nothing."""

import numpy as np
from valid_predictions import HYPOTHESES, IMAGES

CELLS = 72  # of the grid of level 0
MISSING = object()


def figures(scored):
    """Return every figure of every track, over all images."""
    return {
        (name, metric): figure.value
        for name, track in scored.tracks.items()
        for metric, figure in track.figures["all"].items()
    }


def changed(column, at, value):
    """Return a copy with something else at a place."""
    copy = np.array(column)
    copy[at] = value
    return copy


def with_rows(*rows):
    """Return offsets and a joined column of these rows."""
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    return offsets, np.concatenate([np.asarray(row, dtype=np.asarray(rows[0]).dtype) for row in rows])


def replaced(name, **how):
    """Return what puts another data set in the place of one."""

    def replace(file):
        del file[name]
        file.create_dataset(name, **how)

    return replace


def linked(name, link):
    """Return what puts a link in the place of a data set."""

    def replace(file):
        del file[name]
        file[name] = link

    return replace


SHAPE = (IMAGES, HYPOTHESES, 3, 3)


GRID = {"classifier": ("grid", "grid_probabilities", 0.5), "density": ("density", "density_log_probabilities", -5.0)}


def sparse(track, rows):
    prefix, values, value = GRID[track]
    offsets, indices = with_rows(*rows)
    return {f"{prefix}_offsets": offsets, f"{prefix}_indices": indices, values: np.full(len(indices), value)}
