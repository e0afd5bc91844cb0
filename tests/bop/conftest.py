"""Fixtures of BOP: a marked object with depth, a round one, and the BOP dataset of both."""

import pytest
from made_sets import make_set

from symsol_annot.bop.export import export_bop, objects_in

NAMES, IMAGES = ("tetX", "cyl"), {"tetX": 12, "cyl": 3}


@pytest.fixture(scope="session")
def sets(tmp_path_factory):
    """The folder of the sets; not to be written to."""
    folder = tmp_path_factory.mktemp("sets")
    for name in NAMES:
        make_set(folder, name, test=IMAGES[name], train=2, depth=True)
    return folder


@pytest.fixture(scope="session")
def exported(sets, tmp_path_factory):
    """The BOP dataset; not to be written to."""
    out = tmp_path_factory.mktemp("bop") / "two"
    export_bop(objects_in([sets / name for name in NAMES]), out)
    return out
