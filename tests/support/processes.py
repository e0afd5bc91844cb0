"""Processes seen from outside: whether one runs, and waiting for what comes true soon."""

import contextlib
import os
import time
from pathlib import Path

PROMPTLY_S = 10.0  # on a busy machine


def is_running(pid):
    """Whether a process does anything still; one that waits to be collected by its parent does not."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def comes_true(condition, within_s=PROMPTLY_S):
    end = time.monotonic() + within_s
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


def open_shards(folder):
    """How many descriptors of this process are a folder's shards, by whichever library."""
    shards, count = {path.stat().st_ino for path in folder.glob("*.h5")}, 0
    for descriptor in Path("/dev/fd").iterdir():
        with contextlib.suppress(OSError):
            count += os.fstat(int(descriptor.name)).st_ino in shards
    return count
