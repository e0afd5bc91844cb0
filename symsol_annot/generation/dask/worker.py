"""What runs on a Dask worker: shards are made by a Blender in a process beside it.

A Dask worker must not have multiprocessing children, so each holds its Blender in a `ShardProcess`, started at its
first shard and kept for the next. Nothing but this package has to be there, and no file system is shared.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

from distributed import Worker, WorkerPlugin, get_worker

from symsol_annot.errors import ClusterError, RendererCrashedError, SymsolError
from symsol_annot.generation.executors import MakerPool
from symsol_annot.generation.maker import MadeShard
from symsol_annot.generation.process import Limits, ShardProcess
from symsol_annot.sets.manifest import ShardEntry
from symsol_annot.sets.plan import SetPlan
from symsol_annot.system.scratch import sweep

_TELL_SECONDS = 1.0  # between two reports of a worker
_IDLE_SECONDS = 30.0  # after which a worker ends its Blender: the client may have been killed


def make_on_worker(name: str, entry: ShardEntry) -> MadeShard:
    """Make a shard on the Dask worker that runs this task, with the makers that were registered there by name."""
    worker = get_worker()
    makers: Any = worker.plugins[name]
    made: MadeShard = makers.make(entry, worker)
    return made


class ShardMakers(WorkerPlugin):
    """A Dask worker's makers of shards; it ends them once they have waited for long, whatever became of the client."""

    def __init__(self, plan: SetPlan, limits: Limits, *, exhaustive: bool) -> None:
        self.name = (
            f"symsol-annot {plan.spec.name} {plan.manifest().plan_sha256[:16]}"  # the same command, the same name
        )
        self._open_maker: Callable[[], ShardProcess] = partial(ShardProcess, plan, limits, exhaustive=exhaustive)

    def setup(self, worker: Worker) -> None:  # noqa: ARG002 - as Dask calls it
        """Be ready on a worker; nothing is started yet."""
        sweep()
        self._makers = MakerPool(self._open_maker)

    def teardown(self, worker: Worker) -> None:  # noqa: ARG002
        """End all makers."""
        self._makers.close()

    def make(self, entry: ShardEntry, worker: Worker) -> MadeShard:
        """Make a shard, telling the client of its images."""
        told_at = 0.0

        def on_shard_images(images: int) -> None:
            nonlocal told_at
            if time.monotonic() - told_at >= _TELL_SECONDS:
                told_at = time.monotonic()
                worker.log_event(self.name, {"shard": entry.file, "images": images})

        try:
            made = self._makers.make(entry, on_shard_images)
        except RendererCrashedError as error:
            error.worker = worker.address
            raise
        except SymsolError as error:
            raise ClusterError(f"worker {worker.address}: {error}") from None
        finally:
            later = threading.Timer(_IDLE_SECONDS, self._makers.close_idle_since, [time.monotonic()])
            later.daemon = True
            later.start()
        return replace(made, worker=worker.address)
