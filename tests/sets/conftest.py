"""Fixtures of the tests of sets."""

import pytest
from made_shards import build


@pytest.fixture
def shard(tmp_path):
    """A good shard that a test may damage."""
    path = tmp_path / "test-00002-of-00003.h5"
    path.write_bytes(build().data)
    return path
