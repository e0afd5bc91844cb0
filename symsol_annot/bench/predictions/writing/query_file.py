"""The query file: what `queries.py` and `grid.py` compute, for those who write predictions in another language."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from symsol_annot.bench.predictions.format import MAX_GRID_LEVEL, is_level
from symsol_annot.bench.predictions.queries import Queries, group_sha256
from symsol_annot.bench.predictions.writing.hdf5_output import HDF5Output
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.grid import STANDARD_LEVEL, equivolumetric_grid, grid_sha256
from symsol_annot.sets.dataset import Dataset
from symsol_annot.system.files import replaced

QUERIES_FORMAT = "symsol-annot queries"
QUERIES_FORMAT_VERSION = 1


def write_queries(
    path: Path, dataset: Dataset, level: int = STANDARD_LEVEL, on_image: Callable[[], object] = lambda: None
) -> None:
    """Write the queries of every image and the grid, as float32, to an HDF5 file.

    Data sets: `query_rotation` (N, Q, 3, 3), row i about image i, and `grid_rotation` (72 x 8^level, 3, 3). Attributes:
    what a predictions file has to repeat.

    Args:
        path: of the query file; one that is there is replaced.
        dataset: the whole split.
        level: of the grid.
        on_image: called after each image.

    Raises:
        SettingsError: the dataset is a slice, or predictions cannot be on a grid of that level.
        NotAnnotatedError: the split has no symmetry sets.
        OutputError: the file cannot be written.
    """
    if len(dataset) != dataset.manifest.images(dataset.split) or dataset[0].index != 0:
        raise SettingsError(f"{dataset!r} is a slice; queries are about a whole split")
    if not is_level(level):
        raise SettingsError(f"predictions are on grids of levels 0 to {MAX_GRID_LEVEL}, not {level!r}")
    labels = dataset.labels()
    queries = Queries(dataset.fingerprint, labels.symmetry_group)
    with replaced(path) as partial, HDF5Output(partial) as output:
        output.file.attrs.update(
            {
                "format": QUERIES_FORMAT,
                "format_version": QUERIES_FORMAT_VERSION,
                "object": dataset.object,
                "split": dataset.split,
                "fingerprint": dataset.fingerprint,
                "group_sha256": group_sha256(labels.symmetry_group),
                "grid_level": level,
                "grid_sha256": grid_sha256(level),
            }
        )
        stored = {"dtype": "f4", "compression": "gzip", "compression_opts": 1, "shuffle": True, "fletcher32": True}
        shape = (len(labels), len(queries), 3, 3)
        rows = output.file.create_dataset("query_rotation", shape, chunks=(1, *shape[1:]), track_times=False, **stored)
        for i, R_gt in enumerate(labels.rotation):
            rows[i] = queries.rotations(i, R_gt)
            output.raise_failure()
            on_image()
        grid = equivolumetric_grid(level).astype(np.float32)
        output.file.create_dataset("grid_rotation", data=grid, chunks=True, track_times=False, **stored)
