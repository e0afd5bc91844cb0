"""A renderer that crashes costs its shard, which is begun again, and nothing else."""

import contextlib
import os
import signal
import subprocess
import sys
import time
from functools import partial
from pathlib import Path

import pytest
from made_sets import SIZE, make_plan, make_set, threads
from numpy_renderer import NumpyRenderer

from symsol_annot.errors import RendererCrashedError, RenderError
from symsol_annot.generation.events import ImagesMade, ShardBegunAgain
from symsol_annot.generation.generate import MAX_CRASHES_PER_SHARD, generate

CALL_MAIN = "from symsol_annot_cli.main import main; main()"
DAMAGE_THE_FIRST_WORKER = """
import os
import sys
from dataclasses import replace

if "symsol_annot.generation.process" in sys.orig_argv:
    import symsol_annot.rendering.frames.supersampling as frames

    views, pixel_averages = 0, frames.pixel_averages
    try:
        os.close(os.open({flag!r}, os.O_CREAT | os.O_EXCL))
        is_damaged = True
    except FileExistsError:
        is_damaged = False

    def damaged_averages(colours, n):
        global views
        views += 1
        rgb = pixel_averages(colours, n)
        if is_damaged and views > {good_views}:
            rgb[0, 0, 0] ^= 1
        return rgb

    frames.pixel_averages = damaged_averages
"""


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


class Crashing:
    """Opens renderers of which each crashes at one of its frames, as long as `frames` has one for it."""

    def __init__(self, *frames):
        self.frames, self.opened = list(frames), 0

    def __call__(self):
        crash_at, drawn = (self.frames.pop(0) if self.frames else None), []
        self.opened += 1

        def on_frame():
            drawn.append(1)
            if len(drawn) == crash_at:
                raise RendererCrashedError("the lamp blew up")

        return NumpyRenderer("tetX", SIZE, on_frame)


@pytest.mark.parametrize("workers", [1, 2])
def test_a_set_is_finished_to_the_same_bytes_and_each_image_counted_once(tmp_path, workers):
    whole, events = make_set(tmp_path / "a", test=40), []
    opener = Crashing(3, 5)
    generate(
        make_plan(test=40),
        tmp_path / "b" / "tetX",
        threads(opener, workers=workers),
        events.append,
    )
    assert contents(tmp_path / "b" / "tetX") == contents(whole)
    assert sum(event.images for event in events if isinstance(event, ImagesMade)) == 40
    crashes = [event for event in events if isinstance(event, ShardBegunAgain)]
    assert [crash.reason for crash in crashes] == ["the lamp blew up"] * 2
    assert all(crash.attempt in (1, 2) for crash in crashes)
    assert opener.opened <= 2 + workers


def test_a_shard_that_crashes_every_renderer_is_given_up_and_the_others_are_kept(tmp_path):
    opener = Crashing(20, 4, 4, 4, 4)
    with pytest.raises(RendererCrashedError, match="the lamp blew up"):
        generate(make_plan(test=40), tmp_path / "tetX", threads(opener))
    assert opener.opened - (1 + 2 * MAX_CRASHES_PER_SHARD) in (
        0,
        1,
    )  # a crashed shard waits behind one that did not yet
    assert len(list((tmp_path / "tetX").glob("*.h5"))) == 1
    assert not list((tmp_path / "tetX").glob(".*"))
    generate(make_plan(test=40), tmp_path / "tetX", threads(partial(NumpyRenderer, "tetX", SIZE)))
    assert contents(tmp_path / "tetX") == contents(make_set(tmp_path / "whole", test=40))


def test_a_renderer_that_is_closed_while_it_draws_is_no_crash_to_begin_again_after(tmp_path):
    """As a RenderProcess does, it says that it crashed when another worker's failure closes it."""
    opened, events = [], []

    class Closed(NumpyRenderer):
        def render(self, R_m2c):
            if self is opened[0] and len(opened) == 2:
                raise RenderError("the lamp broke")
            while not self.is_closed and len(opened) == 2:
                time.sleep(0.005)
            if self.is_closed:
                raise RendererCrashedError("was closed while it was drawing")
            return super().render(R_m2c)

    def open_renderer():
        opened.append(Closed("tetX", SIZE))
        return opened[-1]

    with pytest.raises(RenderError, match="the lamp broke"):
        generate(
            make_plan(test=640),
            tmp_path / "tetX",
            threads(open_renderer, workers=2),
            events.append,
        )
    assert len(opened) == 2
    assert not [event for event in events if isinstance(event, ShardBegunAgain)]


@pytest.mark.blender
def test_a_killed_blender_is_replaced_and_the_command_says_so(tmp_path):
    words = "render --object tetX --train 0 --test 128 --size 128 --workers 1 --out"
    command = [sys.executable, "-c", CALL_MAIN, *words.split()]
    quiet = subprocess.run([*command, str(tmp_path / "a")], capture_output=True, text=True, check=True)
    with subprocess.Popen(
        [*command, str(tmp_path / "b")], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as run:
        while not list((tmp_path / "b" / "tetX").glob("*.h5")) and run.poll() is None:
            time.sleep(0.01)
        (blender,) = blenders_of(run.pid)
        os.kill(blender, signal.SIGKILL)
        out, err = run.communicate(timeout=120)
    assert run.returncode == 0, err
    assert "ended by signal SIGKILL" in err
    assert "begun again after a worker failed: test-0000" in out
    assert "begun again" not in quiet.stdout
    assert contents(tmp_path / "a" / "tetX") == contents(tmp_path / "b" / "tetX")


@pytest.mark.blender
def test_no_frame_of_a_damaged_blender_gets_into_a_set_and_the_command_says_so(tmp_path):
    """From the middle of its second shard on, one bit of every picture of the first worker is another."""
    (tmp_path / "sitecustomize.py").write_text(
        DAMAGE_THE_FIRST_WORKER.format(flag=str(tmp_path / "flag"), good_views=2 + 16 + 1 + 5)
    )
    words = "render --object tetX --train 0 --test 64 --size 32 --workers 1 --out"
    command = [sys.executable, "-c", CALL_MAIN, *words.split()]
    subprocess.run([*command, str(tmp_path / "a")], capture_output=True, check=True)
    path = os.pathsep.join([str(tmp_path), *filter(None, sys.path)])
    ended = subprocess.run(
        [*command, str(tmp_path / "b")],
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": path},
        check=False,
    )
    assert ended.returncode == 0, ended.stderr
    assert "begun again after a worker failed: test-00001" in ended.stdout
    assert "its memory is damaged" in ended.stdout + ended.stderr
    assert contents(tmp_path / "a" / "tetX") == contents(tmp_path / "b" / "tetX")


def blenders_of(pid):
    """The worker processes that a command has now; a process that reads HDF5 for it is none."""
    return [
        child for child, parent in parents().items() if parent == pid and "generation.process" in command_line(child)
    ]


def parents():
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it has ended meanwhile
            found[int(path.parent.name)] = int(path.read_text().rsplit(")", 1)[1].split()[1])
    return found


def command_line(pid):
    try:
        return Path(f"/proc/{pid}/cmdline").read_text()
    except OSError:
        return ""
