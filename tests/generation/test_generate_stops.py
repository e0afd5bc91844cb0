"""A run that fails, is interrupted or killed leaves whole shards, and the same call goes on from them."""

import itertools
import multiprocessing
import os
import signal
import stat
import subprocess
import threading
import time
from pathlib import Path

import pytest
from four_shards import (
    IMAGES,
    PER_SHARD,
    SIZE,
    Opener,
    assert_only_whole_shards,
    contents,
    failing_at,
    python,
    small_plan,
)
from made_sets import threads

from symsol_annot.errors import RenderError
from symsol_annot.generation.generate import generate
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.system import files
from symsol_annot.system.scratch import Scratch

pytestmark = pytest.mark.usefixtures("_drawn_once")


@pytest.mark.parametrize("frame", [1, PER_SHARD, PER_SHARD + 1, 40, IMAGES])
def test_run_that_failed_is_continued_to_the_bytes_of_an_undisturbed_one(tmp_path, undisturbed, frame):
    folder = tmp_path / "tet"
    with pytest.raises(RenderError, match="the lamp broke"):
        generate(small_plan(), folder, threads(Opener(on_frame=failing_at(frame, RenderError("the lamp broke")))))
    assert_only_whole_shards(folder, undisturbed)
    kept = {path: path.stat().st_mtime_ns for path in folder.glob("*.h5")}
    assert len(kept) == (frame - 1) // PER_SHARD
    drawn = []
    generate(small_plan(), folder, threads(Opener(on_frame=lambda number, frame: drawn.append(frame)), workers=2))
    assert len(drawn) == IMAGES - len(kept) * PER_SHARD
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert contents(folder) == contents(undisturbed)


def test_keyboard_interrupt_in_a_worker_leaves_whole_shards_and_stops_the_others(tmp_path, undisturbed):
    opener = Opener(on_frame=failing_at(PER_SHARD + 3, KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        generate(small_plan(), tmp_path / "tet", threads(opener, workers=2))
    assert all(renderer.is_closed for renderer in opener.renderers)
    assert list((tmp_path / "tet").glob("*.h5"))
    assert_only_whole_shards(tmp_path / "tet", undisturbed)


ENDLESS_RUN = f"""
import signal, sys, time
from functools import partial
from pathlib import Path
from made_sets import make_plan, threads
from numpy_renderer import NumpyRenderer
from symsol_annot.generation.generate import generate

class Stalling(NumpyRenderer):
    frames = 0

    def render(self, R_m2c):
        self.frames += 1
        while self.frames > {PER_SHARD + 4} and not self.is_closed:  # in the middle of the second shard
            time.sleep(0.01)
        return super().render(R_m2c)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job is born without
plan = make_plan("tet", test={IMAGES}, size={SIZE})
generate(plan, Path(sys.argv[1]), threads(partial(Stalling, "tet", {SIZE}), workers=2))
"""


def test_ctrl_c_leaves_whole_shards_from_which_the_same_call_goes_on(tmp_path, undisturbed):
    folder = tmp_path / "tet"
    command, env = python(ENDLESS_RUN, folder)
    with subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True) as process:
        try:
            deadline = time.monotonic() + 60
            while not list(folder.glob("*.h5")) and process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=30)
        finally:
            process.kill()  # does nothing to one that has ended
    assert process.returncode == -signal.SIGINT
    assert said.rstrip().endswith("KeyboardInterrupt")
    assert 0 < len(list(folder.glob("*.h5"))) < IMAGES / PER_SHARD
    assert_only_whole_shards(folder, undisturbed)
    generate(small_plan(), folder, threads(Opener()))
    assert contents(folder) == contents(undisturbed)


def killed_at_write(plan, folder, moment):
    """Make a set in a process that loses half of what it just wrote, and its life, at one of its fsyncs."""
    fsync, left = os.fsync, itertools.count(moment, -1)

    def lose(descriptor):
        if next(left) == 0:
            status = os.fstat(descriptor)
            if stat.S_ISREG(status.st_mode):
                os.ftruncate(descriptor, status.st_size // 2)
            os.kill(os.getpid(), signal.SIGKILL)
        fsync(descriptor)

    files.os.fsync = lose
    generate(plan, folder, threads(Opener()))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize(("moment", "left"), [*enumerate([1, 2, 1, 0, 1, 0, 1, 0, 1, 0])])
def test_set_whose_run_was_killed_at_any_write_is_continued_to_the_same_bytes(tmp_path, moment, left):
    """A shard, the first manifest, and both folders; a manifest and its folder; a shard and its; a manifest and its."""
    plan, killed, whole = small_plan(test=20), tmp_path / "killed", tmp_path / "whole"
    process = multiprocessing.get_context("fork").Process(target=killed_at_write, args=(plan, killed, moment))
    process.start()
    process.join(timeout=60)
    assert process.exitcode == -signal.SIGKILL
    assert len([path for path in killed.iterdir() if path.name.startswith(".symsol-annot-")]) == left
    generate(plan, killed, threads(Opener()))
    generate(plan, whole, threads(Opener()))
    assert contents(killed) == contents(whole)


def leave_scratch(folder):
    """Leave a scratch folder with half a shard, as a process does that is killed."""
    left = Scratch(beside=Path(folder))
    (left.path / "new").write_bytes(b"half of it")
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_what_a_killed_run_left_is_swept_and_nothing_else(tmp_path, half):
    strangers = (".manifest.json.partial", ".test-00000-of-00004.h5.partial", "notes", ".hidden", ".symsol-annot-notes")
    for folder in (half, tmp_path / "new"):
        folder.mkdir(exist_ok=True)
        for name in strangers:
            (folder / name).write_bytes(b"mine")
        process = multiprocessing.get_context("fork").Process(target=leave_scratch, args=(folder,))
        process.start()
        process.join(timeout=60)
        assert len(list(folder.glob(".symsol-annot-*/new"))) == 1
        generate(small_plan(), folder, threads(Opener()))
        shards = {entry.file for entry in read_manifest(folder).shards}
        assert set(contents(folder)) == {"manifest.json", *shards, *strangers}
        assert {(folder / name).read_bytes() for name in strangers} == {b"mine"}


def test_error_in_one_worker_stops_the_others_and_closes_all_renderers(tmp_path):
    failed, late, left_running = threading.Event(), [], []

    def on_frame(number, frame):
        if number == 0 and frame == 3:
            failed.set()
            raise RenderError("the lamp broke")
        if failed.is_set():
            late.append(number)
            deadline = time.monotonic() + 10
            while not opener.renderers[number].is_closed and time.monotonic() < deadline:
                time.sleep(0.005)
            if not opener.renderers[number].is_closed:
                left_running.append(number)
        time.sleep(0.005)

    opener = Opener(on_frame=on_frame)
    with pytest.raises(RenderError, match="the lamp broke"):
        generate(small_plan(), tmp_path / "tet", threads(opener, workers=3))
    assert all(renderer.is_closed for renderer in opener.renderers)
    assert left_running == []
    assert len(late) == len(set(late)), "a worker drew on after the stop"


def test_renderers_are_closed_after_a_good_run_and_there_are_no_more_than_shards(tmp_path):
    opener = Opener()
    generate(small_plan(), tmp_path / "tet", threads(opener, workers=50))
    assert 1 <= len(opener.renderers) <= IMAGES / PER_SHARD
    assert all(renderer.is_closed for renderer in opener.renderers)


def test_nothing_is_created_when_the_renderer_cannot_start(tmp_path):
    def broken():
        raise RenderError("no Blender here")

    with pytest.raises(RenderError, match="no Blender here"):
        generate(small_plan(), tmp_path / "data" / "tet", threads(broken, workers=2))
    assert list(tmp_path.iterdir()) == []
