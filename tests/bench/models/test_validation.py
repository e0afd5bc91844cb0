"""What a training tells of hypotheses about validation images is what `score` says of them."""

import numpy as np
import pytest
from balls import MARKED, ball_set

from symsol_annot import load
from symsol_annot.bench.models.validation import hypothesis_figures
from symsol_annot.bench.scoring.memory.in_memory import score
from symsol_annot.rotations.so3 import uniform_rotations

IMAGES, M = 16, 5


@pytest.fixture(scope="module")
def dataset(tmp_path_factory):
    return load(ball_set(tmp_path_factory.mktemp("object"), *MARKED, IMAGES))


@pytest.mark.parametrize("turns_every", [1, 3], ids=["all at random", "a third at random, else R_gt"])
def test_figures_are_the_scorers_for_sets_with_volume_too(dataset, turns_every):
    labels = dataset.labels()
    assert 2 < (labels.volume >= 0).sum() < IMAGES - 2
    hypotheses = uniform_rotations(IMAGES * M, np.random.default_rng(0)).reshape(IMAGES, M, 3, 3)
    is_right = np.arange(IMAGES) % turns_every > 0
    hypotheses[is_right, 0] = labels.rotation[is_right]
    figures = hypothesis_figures(labels, hypotheses)
    scored = score(hypotheses, dataset).tracks["hypotheses"].figures["all"]
    for name, value in figures.items():
        assert value == pytest.approx(scored[name].value, rel=1e-6, abs=1e-9), name


def test_the_first_images_alone_may_have_hypotheses(dataset):
    labels, hypotheses = dataset.labels(), uniform_rotations(4 * M, np.random.default_rng(1)).reshape(4, M, 3, 3)
    figures = hypothesis_figures(labels, hypotheses)
    assert figures == pytest.approx(hypothesis_figures(dataset[:4].labels(), hypotheses))
