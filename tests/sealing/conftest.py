"""A sealed test, made once; tests that change it get a copy."""

import shutil
from pathlib import Path

import pytest
from sealed_tests import sealed_test


@pytest.fixture(scope="session")
def made(tmp_path_factory):
    """A sealed test that is not to be written to."""
    return sealed_test(tmp_path_factory.mktemp("sealed") / "tetX")


@pytest.fixture
def folder(made, tmp_path):
    """A sealed test that a test may damage."""
    return Path(shutil.copytree(made, tmp_path / "tetX"))
