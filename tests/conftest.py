"""Fixtures: small sets, which are made once a session."""

import shutil
from pathlib import Path

import pytest
from made_sets import make_set


@pytest.fixture(scope="session")
def _pristine(tmp_path_factory):
    """A small tetX set of both splits, 3 shards of test and 1 of train; not to be written to."""
    return make_set(tmp_path_factory.mktemp("pristine"), train=5, test=40)


@pytest.fixture
def tetX_set(_pristine, tmp_path):
    """A copy of a small tetX set that a test may damage."""
    return Path(shutil.copytree(_pristine, tmp_path / "tetX"))
