"""Executors, which make the shards of a plan: they take one shard after the other, and make several at a time.

`in_process` and `local_processes` are here; the third is `dask.executor.DaskCluster`. `generate` opens one with its
plan.
"""

import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager
from functools import partial
from threading import Lock
from typing import Protocol

from symsol_annot.errors import RendererCrashedError
from symsol_annot.generation.maker import MadeShard, OnShardImages, ShardMaker
from symsol_annot.generation.process import DEFAULT_LIMITS, Limits, ShardProcess
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.sets.manifest import ShardEntry
from symsol_annot.sets.plan import SetPlan
from symsol_annot.system.closing import Closing
from symsol_annot.system.scratch import sweep


class Executor(AbstractContextManager["Executor"], Protocol):
    """Makes shards somewhere. As a context manager, it ends what it started."""

    def capacity(self) -> int:
        """Return how many shards it can make at the same time now; 0 where it waits for workers."""

    def prepare(self, shards: int) -> None:
        """Start what takes long to start, for so many shards to come; they are not certain to come."""

    def submit(self, entry: ShardEntry, on_shard_images: OnShardImages) -> "Future[MadeShard]":
        """Begin a shard, once there is room.

        Args:
            entry: the shard.
            on_shard_images: told now and then how many of its images are made, by any thread.

        The future raises RendererCrashedError where the worker was lost and another may do better.
        """


OpenExecutor = Callable[[SetPlan], Executor]


class Maker(Protocol):
    """Makes one shard at a time; to be replaced once it is spent."""

    is_spent: bool

    def make(self, entry: ShardEntry, on_shard_images: OnShardImages) -> MadeShard:
        """Make one shard."""

    def close(self) -> None:
        """End, whatever it is doing; from any thread."""


class MakerPool:
    """Makers that wait for their next shard, so that each is started once; no more than work at the same time."""

    def __init__(self, open_maker: Callable[[], Maker]) -> None:
        self._open_maker = open_maker
        self._lock = Lock()
        self._idle: list[Maker] = []
        self._busy: list[Maker] = []
        self._used_at = 0.0
        self._is_closed = False

    def make(self, entry: ShardEntry, on_shard_images: OnShardImages) -> MadeShard:
        """Make a shard with a maker that waits, or with a new one."""
        maker = self._take()
        is_good = False
        try:
            made = maker.make(entry, on_shard_images)
            is_good = not maker.is_spent
        except RendererCrashedError:
            raise
        except BaseException:
            self._is_closed = True  # another maker would fail as well, and none is to begin
            raise
        finally:
            self._give_back(maker, is_good=is_good)
        return made

    def prepare(self, count: int) -> None:
        """Start so many makers, to wait for their first shard."""
        with self._lock:
            self._idle += [self._open_maker() for _ in range(count)]

    def close_idle_since(self, moment: float) -> None:
        """End the makers that wait, if none was used after a moment of `time.monotonic`."""
        with self._lock:
            is_idle = not self._busy and self._used_at <= moment
            makers = self._idle if is_idle else []
            self._idle = [] if is_idle else self._idle
        for maker in makers:
            maker.close()

    def close(self) -> None:
        """End all makers, also those at work."""
        with self._lock:
            self._is_closed = True
            makers = [*self._idle, *self._busy]
            self._idle = []
        for maker in makers:
            maker.close()

    def _take(self) -> Maker:
        with self._lock:
            if self._is_closed:
                raise RendererCrashedError("the workers were ended before this shard was begun")
            maker = self._idle.pop() if self._idle else self._open_maker()
            self._busy.append(maker)
            return maker

    def _give_back(self, maker: Maker, *, is_good: bool) -> None:
        with self._lock:
            self._busy.remove(maker)
            self._used_at = time.monotonic()
            is_kept = is_good and not self._is_closed
            if is_kept:
                self._idle.append(maker)
        if not is_kept:
            maker.close()


class ThreadedExecutor(Closing):
    """Makes shards by makers on this machine, with a thread to wait for each."""

    def __init__(self, open_maker: Callable[[], Maker], workers: int) -> None:
        self._workers = workers
        self._makers = MakerPool(open_maker)
        self._threads = ThreadPoolExecutor(workers, thread_name_prefix="shard")

    def capacity(self) -> int:
        """Return the number of workers."""
        return self._workers

    def prepare(self, shards: int) -> None:
        """Start the workers."""
        self._makers.prepare(min(shards, self._workers))

    def submit(self, entry: ShardEntry, on_shard_images: OnShardImages) -> "Future[MadeShard]":
        """Begin a shard, once a worker is free."""
        return self._threads.submit(self._makers.make, entry, on_shard_images)

    def close(self) -> None:
        """End all makers and the threads that wait for them."""
        self._makers.close()
        self._threads.shutdown(cancel_futures=True)


def in_process(
    plan: SetPlan, open_renderer: Callable[[], Renderer], *, workers: int = 1, exhaustive: bool = False
) -> ThreadedExecutor:
    """Return an executor that makes shards in this process, with renderers that are handed in, one a worker."""
    return ThreadedExecutor(lambda: ShardMaker(plan, open_renderer(), exhaustive=exhaustive), workers)


def local_processes(
    plan: SetPlan, *, workers: int, limits: Limits = DEFAULT_LIMITS, exhaustive: bool = False
) -> ThreadedExecutor:
    """Return an executor of worker processes, each with its own Blender; sweep up what dead ones left."""
    sweep()
    return ThreadedExecutor(partial(ShardProcess, plan, limits, exhaustive=exhaustive), workers)
