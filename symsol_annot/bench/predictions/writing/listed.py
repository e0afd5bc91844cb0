"""Writing the tracks on the grid for models of this package that know by themselves which of its rotations count.

They resume as `submission`'s writers do. A model that is asked rotation by rotation goes to those.
"""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.predictions.columns import Array
from symsol_annot.bench.predictions.queries import Queries
from symsol_annot.bench.predictions.tracks.classifier import CLASSIFIER, DEFAULT_FLOOR
from symsol_annot.bench.predictions.tracks.density import DENSITY
from symsol_annot.bench.predictions.writing.answer_file import Answer
from symsol_annot.bench.predictions.writing.asked import classifier_attributes, density_attributes
from symsol_annot.bench.predictions.writing.given_answers import listed_density
from symsol_annot.bench.predictions.writing.kept_answers import Resume
from symsol_annot.bench.predictions.writing.predictions_writer import held_predictions
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import Dataset

Indices = npt.NDArray[np.int64]
Around = Callable[[Callable[[int], Answer]], Callable[[int], Answer]]


def write_claims(
    path: Path,
    dataset: Dataset,
    at_queries: Callable[[int, Rotations], Array],
    on_grid: Callable[[int], tuple[Indices, Array]],
    *,
    method: str,
    level: int,
    resume: Resume,
    around: Around = lambda answer: answer,
) -> None:
    """Write the track "classifier".

    Args:
        path: of the predictions file.
        dataset: the whole split.
        at_queries: from an image's index and its queries R_m2c (n, 3, 3) to probabilities (n,).
        on_grid: from an image's index to ascending grid indices (k,), all of more than the floor among them, and
            probabilities (k,).
        method: what the method calls itself.
        level: of the grid.
        resume: as `write_classifier` takes it.
        around: is put around what answers about an image, to answer sooner.

    Raises:
        SettingsError, NotAnnotatedError, PredictionsError, OutputError: as by `write_classifier`.
    """
    queries, rotation = Queries(dataset.fingerprint, dataset.symmetry_group), dataset.labels().rotation

    def answer(i: int) -> Answer:
        indices, probabilities = on_grid(i)
        listed = probabilities > np.float32(DEFAULT_FLOOR)
        return {
            "query_probability": at_queries(i, queries.rotations(i, rotation[i])).astype(np.float32),
            "grid_indices": indices[listed].astype(np.int32),
            "grid_probabilities": probabilities[listed].astype(np.float32),
        }

    attributes: dict[str, Any] = {"method": method, **classifier_attributes(dataset, DEFAULT_FLOOR, level, 1)}
    with held_predictions(path, dataset, CLASSIFIER, attributes, resume) as file:
        file.write_answers(around(answer), resume=resume, progress=True)


def write_cells(
    path: Path,
    dataset: Dataset,
    log_density: Callable[[int], npt.NDArray[np.float64]],
    *,
    method: str,
    floor: float,
    level: int,
    resume: Resume,
    around: Around = lambda answer: answer,
) -> None:
    """Write the track "density".

    Args:
        path: of the predictions file.
        dataset: the whole split.
        log_density: from an image's index to the logarithms (N,) of all cells' densities, up to a constant per image.
        method: what the method calls itself.
        floor: what a smaller probability of a cell is counted as, at most.
        level: of the grid.
        resume: as `write_density` takes it.
        around: is put around what answers about an image, to answer sooner.

    Raises:
        SettingsError, NotAnnotatedError, PredictionsError, OutputError: as by `write_density`.
    """

    def answer(i: int) -> Answer:
        log_p = log_density(i)
        highest = log_p.max()
        return listed_density(log_p - (highest + np.log(np.exp(log_p - highest).sum())), floor)

    attributes: dict[str, Any] = {"method": method, **density_attributes(floor, level, 1)}
    with held_predictions(path, dataset, DENSITY, attributes, resume) as file:
        file.write_answers(around(answer), resume=resume, progress=True)
