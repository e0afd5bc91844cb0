"""Reference rows: what methods score that know the answer, half of it, or nothing. Made from a set's labels alone.

Each row goes the way of any submission: predictions files, then scores.
"""

import os
from collections.abc import Callable, Iterator, Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import Volume
from symsol_annot.bench.predictions.counted import grid_inside
from symsol_annot.bench.predictions.queries import DECOY_COSETS, Queries, query_count
from symsol_annot.bench.predictions.truth import Truth, truth_of
from symsol_annot.bench.predictions.writing.submission import write_columns, write_hypotheses
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.scoring import ObjectScores, score_file
from symsol_annot.errors import ScoresError
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_index, grid_size
from symsol_annot.rotations.so3 import Rotations, uniform_rotations
from symsol_annot.rotations.spreading import farthest_points
from symsol_annot.sets.dataset import Dataset

HYPOTHESES = 30
IN_VOLUME = 720  # hypotheses that stand for a volume, as many as the members of the largest set without
_SEED = 0
_SPREAD_LEVEL = 2  # of the grid whose rotations are chosen where some are to be far from one another
_LISTED_MASS = 1.0 - 1e-12  # a density leaves something to every cell

Write = Callable[[Path, Dataset, Truth, int], None]  # the last is the grid's level


def truth(path: Path, dataset: Dataset, known: Truth, level: int = STANDARD_LEVEL) -> None:
    """Write the symmetry sets themselves, as hypotheses, classifier and density; of a volume, 720 hypotheses in it."""
    write_hypotheses(path, dataset, lambda i: _listed(known, i, IN_VOLUME), method="truth", progress=False)
    _write_classifier(path, dataset, known.labels.symmetry_mask, _inside(known, level), "truth", level)
    cells = [np.unique(of_image, return_counts=True) for of_image in _cells(known, level)]
    columns = {
        "density_offsets": _offsets([indices for indices, _ in cells]),
        "density_indices": np.concatenate([indices.astype(np.int32) for indices, _ in cells]),
        "density_log_probabilities": np.log(
            np.concatenate([_LISTED_MASS * counts / counts.sum() for _, counts in cells])
        ),
    }
    write_columns(path, dataset, "density", columns, method="truth", grid_level=level)


def one_true_rotation(path: Path, dataset: Dataset, known: Truth, _level: int = STANDARD_LEVEL) -> None:
    """Write the one rotation that each image was drawn at."""
    write_hypotheses(path, dataset, known.labels.rotation[:, None], method="one true rotation")


def body_group(path: Path, dataset: Dataset, known: Truth, level: int = STANDARD_LEVEL) -> None:
    """Write all rotations of the body, as a method does that is blind to the marking.

    Of a ball these are all rotations: as hypotheses 720 of them, and the uniform density.
    """
    labels, method = known.labels, "the body's group, blind to the marking"
    if labels.volume is not None:
        grid = equivolumetric_grid(_SPREAD_LEVEL)
        everywhere = grid[farthest_points(grid, IN_VOLUME)]
        write_hypotheses(path, dataset, lambda _: everywhere, method=method, progress=False)
        uniform_log_p = np.full(len(known), -np.log(grid_size(level)))
        columns = {
            "density_offsets": np.arange(len(known) + 1),
            "density_indices": np.zeros(len(known), dtype=np.int64),
            "density_log_probabilities": uniform_log_p,
        }
        write_columns(path, dataset, "density", columns, method=method, grid_level=level)
        return
    everything = np.ones((len(labels), len(dataset.symmetry_group)), dtype=bool)
    nowhere = [np.zeros(0, dtype=np.int64)] * len(known)
    write_hypotheses(path, dataset, labels.candidates, method=method, progress=False)
    _write_classifier(path, dataset, everything, nowhere, method, level)


def uniform(path: Path, dataset: Dataset, known: Truth, _level: int = STANDARD_LEVEL) -> None:
    """Write 30 uniform rotations per image."""
    rng = np.random.default_rng(_SEED)
    rotations = uniform_rotations(HYPOTHESES * len(known), rng).reshape(len(known), HYPOTHESES, 3, 3)
    write_hypotheses(path, dataset, rotations, method="30 uniform rotations")


def evenly_placed(path: Path, dataset: Dataset, known: Truth, _level: int = STANDARD_LEVEL) -> None:
    """Write the set where it has up to 30 members, else 30 of them, even along its arcs."""
    write_hypotheses(path, dataset, lambda i: _even(known, i), method="30 placed evenly", progress=False)


def rounded_to_grid(path: Path, dataset: Dataset, known: Truth, level: int = STANDARD_LEVEL) -> None:
    """Write the grid rotations nearest to the truth: as hypotheses, and as what a classifier claims on the grid."""
    grid, method = grid_index(level), "truth rounded to the grid"
    write_hypotheses(path, dataset, lambda i: grid.rotations[_rounded(known, i, level)], method=method, progress=False)
    cells = [np.union1d(_rounded(known, i, level), inside) for i, inside in enumerate(_inside(known, level))]
    _write_classifier(path, dataset, known.labels.symmetry_mask, cells, method, level)


def yes_to_queries(path: Path, dataset: Dataset, known: Truth, level: int = STANDARD_LEVEL) -> None:
    """Write a classifier that says yes to whatever it is asked and claims nothing on the grid; it must not rank."""
    count = query_count(len(dataset.symmetry_group))
    columns = {
        "query_probability": np.ones((len(known), count), dtype=np.float32),
        **_on_grid([np.zeros(0, dtype=np.int64)] * len(known)),
    }
    write_columns(path, dataset, "classifier", columns, method="yes to every query", grid_level=level)


ROWS: dict[str, Write] = {
    "truth": truth,
    "rounded-to-grid": rounded_to_grid,
    "evenly-placed": evenly_placed,
    "one-true-rotation": one_true_rotation,
    "body-group": body_group,
    "uniform": uniform,
    "yes-to-queries": yes_to_queries,
}


def score_row(
    name: str,
    datasets: Sequence[Dataset],
    workplace: str | os.PathLike[str],
    level: int = STANDARD_LEVEL,
    decimals: int | None = None,
) -> dict[str, Any]:
    """Return the scores document of one reference row on some sets.

    Args:
        name: of the row, one of `ROWS`.
        datasets: whole splits, one per object.
        workplace: an empty folder for the predictions files.
        level: of the grid; other levels than the standard one do not rank.
        decimals: to how many the figures of single images are rounded; None for all digits.

    Raises:
        ScoresError: two sets are of one object.
    """
    if len({dataset.object for dataset in datasets}) < len(datasets):
        raise ScoresError("more than one of the sets is of the same object; score one set per object")
    paths = [Path(workplace) / f"{dataset.object}.h5" for dataset in datasets]
    scores: list[ObjectScores] = []
    for path, dataset in zip(paths, datasets, strict=True):
        ROWS[name](path, dataset, truth_of(dataset), level)
        scores.append(score_file(path, dataset.folder))
    return report.to_document(scores, decimals)


def _even(known: Truth, i: int) -> Rotations:
    """Return up to 30 rotations (m, 3, 3) of an image's set: members even along its arcs, or spread over its volume."""
    if known.labels.volume_of(i) is not None:
        return _listed(known, i, HYPOTHESES)
    in_order = known.labels.symmetry_set(i).along_arcs
    if len(in_order) <= HYPOTHESES:
        return known.labels.members(i)
    return in_order[((np.arange(HYPOTHESES) + 0.5) * len(in_order) / HYPOTHESES).astype(int)]


def _listed(known: Truth, i: int, most: int) -> Rotations:
    """Return the members (m, 3, 3) of an image's set or, if it has a volume, so many rotations spread over that."""
    volume = known.labels.volume_of(i)
    return known.labels.members(i) if volume is None else _spread(volume, most)


@lru_cache(maxsize=8)
def _spread(volume: Volume, count: int) -> Rotations:
    """Return rotations (count, 3, 3) of a volume that are far from one another."""
    inside = grid_inside(volume, _SPREAD_LEVEL)
    if len(inside) < count:
        return volume.sample(count, np.random.default_rng(_SEED))
    found = equivolumetric_grid(_SPREAD_LEVEL)[inside]
    return found[farthest_points(found, count)]


def _rounded(known: Truth, i: int, level: int) -> npt.NDArray[np.int64]:
    """Return the ascending indices of the grid rotations nearest to the members, or to rotations in the volume."""
    return np.unique(grid_index(level).nearest(_listed(known, i, IN_VOLUME)))


def _inside(known: Truth, level: int) -> list[npt.NDArray[np.int64]]:
    """Return of each image the indices of the grid's rotations inside its set's volume; none of a set without."""
    volumes = [known.labels.volume_of(i) for i in range(len(known))]
    nowhere = np.zeros(0, dtype=np.int64)
    return [nowhere if volume is None else grid_inside(volume, level) for volume in volumes]


def _cells(known: Truth, level: int) -> Iterator[npt.NDArray[np.int64]]:
    """Yield of each image the cells (|S|,) of what its set consists of."""
    counted, grid = known.counted_on(level), grid_index(level)
    for i, inside in enumerate(_inside(known, level)):
        members = known.labels.candidates(i)[counted.is_counted[i]]
        yield np.concatenate([grid.nearest(members), inside]) if len(members) else inside


def _write_classifier(
    path: Path,
    dataset: Dataset,
    claimed: npt.NDArray[np.bool_],
    on_grid: Sequence[npt.NDArray[np.int64]],
    method: str,
    level: int,
) -> None:
    """Write a classifier that is certain of some candidates (N, G) and grid rotations, and denies the rest."""
    queries = Queries(dataset.fingerprint, dataset.symmetry_group)
    probability = np.zeros((len(claimed), len(queries)), dtype=np.float32)
    for i, row in enumerate(claimed):
        asked = np.zeros((1 + DECOY_COSETS, len(row)))
        asked[0] = row
        probability[i] = queries.shuffle(i, asked)
    columns = {"query_probability": probability, **_on_grid(on_grid)}
    write_columns(path, dataset, "classifier", columns, method=method, grid_level=level)


def _on_grid(cells: Sequence[npt.NDArray[np.int64]]) -> dict[str, npt.NDArray[Any]]:
    indices = np.concatenate([of_image.astype(np.int32) for of_image in cells])  # many, of sets that fill a volume
    return {
        "grid_offsets": _offsets(cells),
        "grid_indices": indices,
        "grid_probabilities": np.ones(len(indices), dtype=np.float32),
    }


def _offsets(rows: Sequence[npt.NDArray[np.int64]]) -> npt.NDArray[np.int64]:
    return np.concatenate([[0], np.cumsum([len(row) for row in rows])]).astype(np.int64)
