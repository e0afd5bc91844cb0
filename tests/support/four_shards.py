"""The set of four small shards that is made again and again: its plan, its renderers, and what its folder holds."""

import itertools
import os
import sys
from pathlib import Path

import pytest
from made_sets import make_plan
from numpy_renderer import NumpyRenderer

from symsol_annot.sets.manifest import read_manifest

SIZE, IMAGES, PER_SHARD = 16, 64, 16


def small_plan(name="tet", test=IMAGES, **changes):
    """4 shards of 16 images that cost next to nothing, unless told otherwise."""
    return make_plan(name, **{"test": test, "size": SIZE, **changes})


class Opener:
    """Opens numpy renderers and keeps them; `on_frame` gets the renderer's number and the number of its frame."""

    def __init__(self, name="tet", on_frame=lambda number, frame: None):
        self.name, self.on_frame, self.renderers = name, on_frame, []

    def __call__(self):
        number, frames = len(self.renderers), itertools.count(1)
        self.renderers.append(NumpyRenderer(self.name, SIZE, lambda: self.on_frame(number, next(frames))))
        return self.renderers[-1]


def unopened():
    pytest.fail("a renderer was started")


def failing_at(frame, error):
    def on_frame(_, found):
        if found == frame:
            raise error

    return on_frame


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def state(folder):
    """All that a touch would change: names, contents, identities and times; reading changes none of it."""

    def of(path):
        status = path.stat()
        return path.name, status.st_ino, status.st_mode, status.st_mtime_ns, status.st_ctime_ns

    return of(folder), [(of(path), path.read_bytes()) for path in sorted(folder.iterdir())]


def assert_only_whole_shards(folder, undisturbed):
    """Every shard is the one that an undisturbed run makes, and no half of anything lies beside them."""
    there = contents(folder) if folder.exists() else {}
    manifest = there.pop("manifest.json", None)
    expected = contents(undisturbed)
    assert set(there) <= set(expected)
    assert [name for name, data in there.items() if data != expected[name]] == []
    if manifest:
        assert {entry.file for entry in read_manifest(folder).shards if entry.is_finished} <= set(there)


def python(script, *arguments):
    path = os.pathsep.join([str(Path(__file__).parent), *(p for p in sys.path if p)])
    return [sys.executable, "-c", script, *map(str, arguments)], {**os.environ, "PYTHONPATH": path}
