"""The shards of a small tetX set, one of which is tampered with."""

from contextlib import contextmanager

import numpy as np
import tampering

SHARDS = ("test-00000-of-00003.h5", "test-00001-of-00003.h5", "test-00002-of-00003.h5", "train-00000-of-00001.h5")
SECOND, FIRST_INDEX = SHARDS[1], 16  # the shard that is tampered with, and the index of its first image
TOLERANCE_PX = 5.0


@contextmanager
def tampered(folder, file=SECOND):
    """Open a shard for editing, and reseal the set."""
    with tampering.tampered(folder, file) as shard:
        yield shard


def rows(shard, shown):
    """The rows whose image shows the marking, or hides it."""
    return np.flatnonzero((shard["marking_pixels"][...] >= TOLERANCE_PX) == shown)
