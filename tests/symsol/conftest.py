"""Fixtures of the original SYMSOL: a zip of its layout, and the sets that were imported from it."""

import pytest
import symsol_source
from imported_sets import NAMES, imported
from symsol_source import write_zip

pytest.register_assert_rewrite("hostile_zips")  # its claims say what they compared, as those of tests do


@pytest.fixture(scope="session")
def source(tmp_path_factory):
    """A zip of four objects, what is in it, and its sets by name; not to be written to."""
    files, arrays = symsol_source.content(NAMES)
    folder = tmp_path_factory.mktemp("symsol")
    path = write_zip(folder / "symsol.zip", files)
    return path, arrays, imported(path, folder / "sets")
