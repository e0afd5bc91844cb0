"""Scores that a report is made of: files of all tracks about two small sets."""

from typing import Any, NamedTuple

import numpy as np
from bench_sets import small_set

from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.rotations.so3 import uniform_rotations

LEVEL, IMAGES = 0, {"tetX": 24, "cylO": 22}
METHOD = 'a  method [of two,  "words"] {mine}'


def write_all_tracks(path, dataset, method=METHOD):
    """Predictions that are neither good nor bad; some images have no positive, and some no rejected candidate."""
    labels, rng = dataset.labels(), np.random.default_rng(3)
    strays = uniform_rotations(len(dataset), rng)
    write_hypotheses(path, dataset, lambda i: np.stack([labels.symmetry_set(i)[-1], strays[i]]), method=method)
    level = {"method": method, "level": LEVEL}
    write_classifier(path, dataset, lambda i, R: np.where(i % 3, 0.5 + 0.5 * np.sin(5 * R[:, 0, 0]), 0.0), **level)
    write_density(path, dataset, lambda i, R: 3.0 * R[:, 1, 1] * labels.rotation[i][1, 1], **level)
    return path


class Reported(NamedTuple):
    """Data sets by object, a file about each, its scores, and the document of all."""

    sets: dict[str, Any]
    paths: list[Any]
    scores: list[Any]
    document: dict[str, Any]


def report_on(folder):
    """Write sets and predictions to a folder, and score them."""
    sets = {name: small_set(folder / "sets", name, images) for name, images in IMAGES.items()}
    paths = [write_all_tracks(folder / f"{name}.h5", dataset) for name, dataset in sets.items()]
    scores = [score_file(path, dataset.folder) for path, dataset in zip(paths, sets.values(), strict=True)]
    return Reported(sets, paths, scores, report.to_document(scores))
