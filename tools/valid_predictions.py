"""Predictions files of all tracks as they should be, written with h5py alone, and stored in several ways."""

import sys
from pathlib import Path

import h5py
import numpy as np

from symsol_annot import load
from symsol_annot.bench.predictions.queries import group_sha256, query_count
from symsol_annot.bench.predictions.tracks.table import TRACKS
from symsol_annot.rotations.grid import grid_sha256, grid_size

IMAGES, LEVEL, HYPOTHESES = 6, 0, 3
DATASETS = ("image_index", *(name for track in TRACKS.values() for name in track.datasets))
STORAGE = {
    "contiguous": {},
    "chunked": {"chunks": True},
    "gzip": {"chunks": True, "compression": "gzip", "shuffle": True, "fletcher32": True},
    "resizable": {"chunks": True, "compression": "gzip", "maxshape": True},
}


def valid_columns(dataset, rng):
    """Return every data set of a file with all tracks, made with numpy alone."""
    labels, size = dataset.labels(), grid_size(LEVEL)
    images, queries = len(labels), query_count(len(labels.symmetry_group))
    listed = [np.sort(rng.choice(size, rng.integers(0, 9), replace=False)) for _ in range(images)]
    offsets = np.concatenate([[0], np.cumsum([len(indices) for indices in listed])])
    indices = np.concatenate(listed).astype(np.int32)
    weights = rng.uniform(0.1, 1.0, (images, HYPOTHESES))
    weights[0, 1] = 0.0
    return {
        "image_index": np.arange(images),
        "hypotheses": np.stack([labels.members(i)[:HYPOTHESES] for i in range(images)]),
        "hypothesis_weights": weights,
        "query_probability": rng.uniform(0.0, 1.0, (images, queries)).astype(np.float32),
        "grid_offsets": offsets,
        "grid_indices": indices,
        "grid_probabilities": rng.uniform(0.2, 1.0, len(indices)).astype(np.float32),
        "density_offsets": offsets,
        "density_indices": indices,
        "density_log_probabilities": np.log(rng.uniform(0.001, 0.1, len(indices))),
    }


def valid_attributes(dataset):
    """Return every attribute of a file with all tracks."""
    return {
        "format": "symsol-annot predictions",
        "format_version": 1,
        "method": "made to be broken",
        "object": dataset.object,
        "split": dataset.split,
        "fingerprint": dataset.fingerprint,
        "group_sha256": group_sha256(dataset.symmetry_group),
        "grid_level": LEVEL,
        "grid_sha256": grid_sha256(LEVEL),
        "floor": 0.1,
    }


def write_file(path, columns, attributes, storage=None, libver=("earliest", "v108")):
    """Write a predictions file with h5py alone."""
    with h5py.File(path, "w", libver=libver) as file:
        file.attrs.update(attributes)
        for name, column in columns.items():
            stored = dict(storage or {})
            if stored.get("maxshape"):
                stored["maxshape"] = (None, *np.shape(column)[1:])
            file.create_dataset(name, data=column, track_times=False, **stored)


def make_bases(folder):
    """Make a set and valid files about it."""
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
    from made_sets import make_set

    dataset = load(make_set(folder / "data", "tetX", test=IMAGES))
    columns, attributes = valid_columns(dataset, np.random.default_rng(0)), valid_attributes(dataset)
    (folder / "bases").mkdir()
    for name, storage in STORAGE.items():
        for libver in ("earliest", "v108"), ("latest", "latest"):
            for track in ("all", *TRACKS):
                wanted = columns if track == "all" else ("image_index", *TRACKS[track].datasets)
                chosen = {n: c for n, c in columns.items() if n in wanted}
                write_file(folder / "bases" / f"{name}-{libver[0]}-{track}.h5", chosen, attributes, storage, libver)
