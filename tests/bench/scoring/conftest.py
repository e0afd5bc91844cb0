"""Fixtures: small sets, and what an oracle reads of them."""

from functools import partial

import pytest
from label_sets import IMAGES, SIZE, LabelRenderer
from made_sets import make_plan, threads
from scoring_oracle import TruthOracle

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
