"""Fixtures: small sets, and what an oracle reads of them."""

import json
from functools import partial

import numpy as np
import pytest
from bench_sets import small_set
from compared_scores import COMPARED_IMAGES, SHIFT_RAD
from label_sets import IMAGES, SIZE, LabelRenderer
from made_sets import make_plan, threads
from reported_scores import report_on
from scipy.spatial.transform import Rotation
from scoring_oracle import TruthOracle

from symsol_annot.bench.predictions.writing.submission import write_classifier, write_density, write_hypotheses
from symsol_annot.bench.scoring.reports import report
from symsol_annot.bench.scoring.scoring import score_file
from symsol_annot.generation.generate import generate


@pytest.fixture(scope="session")
def sets(tmp_path_factory):
    """A folder of small sets, and the oracle's reading of each."""
    folder = tmp_path_factory.mktemp("sets")
    for name, images in IMAGES.items():
        generate(
            make_plan(name, test=images, size=SIZE),
            folder / name,
            threads(partial(LabelRenderer, name), exhaustive=True),
        )
    return folder, {name: TruthOracle(folder / name) for name in IMAGES}


@pytest.fixture(scope="session")
def tetX(tmp_path_factory):
    return small_set(tmp_path_factory.mktemp("sets"), "tetX", COMPARED_IMAGES)


def scored(dataset, folder, method, shift_rad, with_grid=False):
    """Scores of rotations that are off by a different angle an image, and by a little more."""
    path, labels = folder / f"{method}.h5", dataset.labels()
    errors = np.random.default_rng(0).uniform(0.0, 0.5, COMPARED_IMAGES)
    turns = Rotation.from_rotvec(np.outer(errors + shift_rad, [0.6, 0.0, 0.8])).as_matrix()
    write_hypotheses(path, dataset, (labels.rotation @ turns)[:, None], method=method)
    if with_grid:
        write_classifier(path, dataset, lambda i, R: R[:, 0, 0] > 0.5 + shift_rad, method=method, level=0)
        write_density(path, dataset, lambda i, R: (3.0 + shift_rad) * R[:, 1, 1], method=method, level=0)
    return score_file(path, dataset.folder), path


@pytest.fixture(scope="session")
def pair(tetX, tmp_path_factory):
    """Two methods: the second is worse by the same angle on each image."""
    folder = tmp_path_factory.mktemp("scores")
    return [scored(tetX, folder, "first", 0.0, with_grid=True), scored(tetX, folder, "second", SHIFT_RAD)]


@pytest.fixture(scope="module")
def documents(pair):
    return [report.to_document([scores]) for scores, path in pair]


@pytest.fixture(scope="session")
def reported(tmp_path_factory):
    """Scores of all tracks on two sets, and their document; not to be written to."""
    return report_on(tmp_path_factory.mktemp("reported"))


@pytest.fixture
def save(tmp_path):
    """Write documents as files, as `score --json` does."""

    def save_all(*documents):
        paths = [tmp_path / f"{number}.json" for number in range(len(documents))]
        for path, document in zip(paths, documents, strict=True):
            path.write_text(json.dumps(document))
        return paths

    return save_all
