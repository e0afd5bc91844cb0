"""Who makes the shards: makers that are kept, replaced, ended in time, and make the same bytes as any other."""

import fcntl
import os
import signal
import subprocess
import sys
import threading
import time
from functools import partial
from pathlib import Path

import pytest
from made_sets import make_plan
from processes import comes_true, is_running

from symsol_annot.errors import RendererCrashedError, RendererHungError, RenderError
from symsol_annot.generation.events import ShardBegunAgain
from symsol_annot.generation.executors import MakerPool, in_process, local_processes
from symsol_annot.generation.generate import generate
from symsol_annot.generation.process import Limits, ShardProcess
from symsol_annot.rendering.render_process import RenderProcess

PLAN = make_plan("tetX", test=40, size=48)
ENTRY = PLAN.manifest().shards[0]
MIB = 2**20
SILENCE_S = 15.0  # a start on a busy machine takes seconds

PARENT = """
from made_sets import make_plan
from symsol_annot.generation.process import Limits, ShardProcess
plan = make_plan("tetX", test=40, size=48)
process = ShardProcess(plan, Limits())
print(process.worker, flush=True)
while True:
    process.make(plan.manifest().shards[0], lambda made: None)
"""


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def pid_of(process):
    return int(process.worker.rpartition("/")[2])


def make_for_ever(process):
    while True:
        process.make(ENTRY, lambda _: None)


class FakeMaker:
    """Makes nothing; `fate` says how its shards end."""

    def __init__(self, fate=None, *, spent_after=10**9):
        self.fate, self.left, self.is_closed = fate, spent_after, False

    @property
    def is_spent(self):
        return self.left <= 0

    def make(self, entry, on_images):
        self.left -= 1
        if self.fate:
            raise self.fate
        return entry

    def close(self):
        self.is_closed = True


class Makers:
    def __init__(self, *fates, **arguments):
        self.fates, self.arguments, self.opened = list(fates), arguments, []

    def __call__(self):
        self.opened.append(FakeMaker(self.fates.pop(0) if self.fates else None, **self.arguments))
        return self.opened[-1]


def test_a_maker_is_kept_for_the_next_shard():
    makers = Makers()
    pool = MakerPool(makers)
    assert [pool.make(shard, None) for shard in "abc"] == ["a", "b", "c"]
    assert [maker.is_closed for maker in makers.opened] == [False]
    pool.close()
    assert [maker.is_closed for maker in makers.opened] == [True]


def test_a_spent_maker_is_replaced_after_its_shard():
    makers = Makers(spent_after=2)
    pool = MakerPool(makers)
    assert [pool.make(shard, None) for shard in "abcde"] == list("abcde")
    assert [maker.is_closed for maker in makers.opened] == [True, True, False]


def test_a_crashed_maker_is_replaced_and_a_failed_one_lets_no_other_begin():
    makers = Makers(RendererCrashedError("lost"), RenderError("broken"))
    pool = MakerPool(makers)
    with pytest.raises(RendererCrashedError, match="lost"):
        pool.make("a", None)
    with pytest.raises(RenderError, match="broken"):
        pool.make("a", None)
    with pytest.raises(RendererCrashedError, match="before this shard was begun"):
        pool.make("a", None)
    assert [maker.is_closed for maker in makers.opened] == [True, True]


def test_makers_that_waited_for_long_are_ended_unless_one_was_used_since():
    makers = Makers()
    pool = MakerPool(makers)
    before = time.monotonic()
    pool.make("a", None)
    pool.close_idle_since(before)
    assert [maker.is_closed for maker in makers.opened] == [False]
    pool.close_idle_since(time.monotonic())
    assert [maker.is_closed for maker in makers.opened] == [True]
    assert pool.make("b", None) == "b"
    assert len(makers.opened) == 2


@pytest.fixture
def opened():
    """Opens shard processes and ends them after the test."""
    processes = []

    def open_process(plan=PLAN, **limits):
        processes.append(ShardProcess(plan, Limits(**limits)))
        return processes[-1]

    yield open_process
    for process in processes:
        process.close()


@pytest.mark.blender
def test_worker_processes_make_the_bytes_of_a_renderer_handed_in(tmp_path):
    """One and two of them, and after each shard another one."""
    spec, camera, settings = PLAN.spec, PLAN.camera, PLAN.settings
    ways = {
        "handed in": partial(in_process, open_renderer=partial(RenderProcess, spec, camera, settings)),
        "one": partial(local_processes, workers=1),
        "two": partial(local_processes, workers=2, limits=Limits(frames=1)),
        "exhaustive": partial(local_processes, workers=2, exhaustive=True),
    }
    for name, way in ways.items():
        generate(PLAN, tmp_path / name, way)
        assert contents(tmp_path / name) == contents(tmp_path / "handed in")


@pytest.mark.blender
def test_a_process_tells_of_each_image_and_keeps_its_blender(opened):
    process, told = opened(), []
    first = process.make(ENTRY, told.append)
    assert sorted(set(told)) == list(range(1, ENTRY.images + 1))
    assert told == sorted(told)
    assert process.make(ENTRY, told.append) == first
    assert first.worker == process.worker
    assert not process.is_spent


@pytest.mark.blender
def test_a_process_is_spent_after_its_frames_or_with_three_quarters_of_its_memory(opened):
    frames = opened(frames=ENTRY.images)
    frames.make(ENTRY, lambda _: None)
    assert frames.is_spent
    held = opened(memory_bytes=540 * MIB)  # Blender and so small a shard take about 440
    held.make(ENTRY, lambda _: None)
    assert held.is_spent


@pytest.mark.blender
def test_a_process_that_hangs_is_ended_in_its_time_limit(opened):
    process = opened(silence_s=SILENCE_S)
    process.make(ENTRY, lambda _: None)
    stopping = threading.Timer(0.05, os.kill, [pid_of(process), signal.SIGSTOP])
    stopping.start()
    start = time.monotonic()
    with pytest.raises(RendererHungError, match=rf"gave no sign of life for {SILENCE_S:g} s, and was ended") as error:
        make_for_ever(process)
    assert SILENCE_S <= time.monotonic() - start < SILENCE_S + 4.5
    assert error.value.worker == process.worker
    assert not is_running(pid_of(process))


@pytest.mark.blender
def test_a_process_that_outgrows_its_memory_is_ended_and_says_so(opened):
    process = opened(memory_bytes=150 * MIB)
    with pytest.raises(RendererCrashedError, match=r"ended itself: it held \d+ MiB, more than --worker-memory.*: 150"):
        process.make(ENTRY, lambda _: None)


def is_armed(pid):
    """Tell whether the kernel has been asked to end a process with its parent: one of its files is asynchronous."""
    try:
        flags = [path.read_text().split()[3] for path in Path(f"/proc/{pid}/fdinfo").iterdir()]
    except OSError:  # one was closed meanwhile
        return False
    return any(int(of_file, 8) & fcntl.FASYNC for of_file in flags)


@pytest.mark.blender
@pytest.mark.skipif(sys.platform != "linux", reason="elsewhere a stopped process outlives its parent until it goes on")
def test_a_process_dies_with_its_parent_even_if_it_is_stopped(tmp_path):
    path = os.pathsep.join([str(Path(__file__).parents[1] / "support"), *(part for part in sys.path if part)])
    environment = {**os.environ, "PYTHONPATH": path, "TMPDIR": str(tmp_path)}
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True, env=environment) as parent:
        pid = int(parent.stdout.readline().rpartition("/")[2])
        assert comes_true(lambda: is_armed(pid), within_s=60.0)
        os.kill(pid, signal.SIGSTOP)
        assert is_running(pid)
        parent.kill()
    assert comes_true(lambda: not is_running(pid), within_s=2.0)


@pytest.mark.blender
def test_a_hung_worker_costs_its_shard_and_nothing_else(tmp_path):
    whole, events, stopped = tmp_path / "whole", [], []
    generate(PLAN, whole, partial(local_processes, workers=1))

    def on_event(event):
        events.append(event)
        if type(event).__name__ == "ShardFinished" and not stopped:
            stopped.append(int(event.worker.rpartition("/")[2]))
            os.kill(stopped[0], signal.SIGSTOP)

    limits = Limits(silence_s=SILENCE_S)
    generate(PLAN, tmp_path / "again", partial(local_processes, workers=1, limits=limits), on_event)
    assert contents(tmp_path / "again") == contents(whole)
    (failure,) = [event for event in events if isinstance(event, ShardBegunAgain)]
    assert failure.worker.endswith(f"/{stopped[0]}")
    assert "no sign of life" in failure.reason
