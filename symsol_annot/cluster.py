"""The executor on a Dask cluster: its workers make the shards, this process checks and writes them.

A Dask worker must not have multiprocessing children, so each holds its Blender in a `ShardProcess`, started at its
first shard and kept for the next. Nothing but this package has to be on a worker, and no file system is shared.
"""

import asyncio
import json
import logging
import socket
import threading
import time
import uuid
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from functools import partial
from itertools import count
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from distributed import Client, KilledWorker, Security, Worker, WorkerPlugin, get_worker
from distributed import Future as DaskFuture
from distributed.comm.addressing import get_address_host_port
from distributed.core import rpc

from symsol_annot import __version__
from symsol_annot.blender_process import RENDERING_PYTHON
from symsol_annot.errors import ClusterError, RendererCrashedError, SymsolError, bulleted
from symsol_annot.executors import MakerPool
from symsol_annot.manifest import ShardEntry
from symsol_annot.plan import SetPlan
from symsol_annot.scratch import sweep
from symsol_annot.shard_maker import MadeShard, OnImages
from symsol_annot.shard_process import DEFAULT_LIMITS, Limits, ShardProcess

_DECIDE_BYTES = ("bpy", "h5py", "numpy", "zlib-ng")  # Mesa and HDF5 are compared when a shard arrives
_CONNECT_SECONDS = 10.0
_ANSWER_SECONDS = 20.0  # in which a scheduler and all its workers must answer
_FIRST_WORKER_SECONDS = 60.0
_LOOK_SECONDS = 1.0  # between two questions for the number of workers
_TELL_SECONDS = 1.0  # between two reports of a worker
_IDLE_SECONDS = 30.0  # after which a worker ends its Blender: this process may have been killed


class DaskCluster:
    """Makes shards on the workers of a Dask scheduler; one at a time for each of their threads.

    Args:
        plan: the set.
        address: the scheduler's, like tcp://10.0.0.1:8786.
        limits: of each worker's Blender process.
        exhaustive: draw every candidate.

    Raises:
        ClusterError: no scheduler answers, it has no workers, or they lack what is needed or are not alike.
    """

    def __init__(
        self, plan: SetPlan, address: str, *, limits: Limits = DEFAULT_LIMITS, exhaustive: bool = False
    ) -> None:
        self._address = address
        self._makers = _ShardMakers(plan, limits, exhaustive=exhaustive)
        self._name = self._makers.name
        self._keys = (f"{self._name} {uuid.uuid4().hex[:8]}-{number}" for number in count())
        self._on_images: dict[str, OnImages] = {}  # by shard
        self._threads, self._looked_at = 0, -_LOOK_SECONDS
        self._arrivals: list[threading.Thread] = []
        self._is_closed = False

    def __enter__(self) -> Self:
        """Connect, look at the workers, and hand them the plan."""
        check_scheduler(self._address)
        with ExitStack() as opened:
            opened.enter_context(_silent_dask())
            try:
                client = Client(self._address, timeout=_CONNECT_SECONDS, set_as_default=False)
                self._client = opened.enter_context(client)
                self._check_workers()
                _answer_of(partial(self._client.register_plugin, self._makers))
                self._client.subscribe_topic(self._name, self._hear)
            except TimeoutError:
                raise self._hung() from None
            except (OSError, CancelledError):
                raise self._lost() from None
            self._opened = opened.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_closed = True
        if self._client.status == "running":
            with suppress(OSError, TimeoutError, ValueError):
                _answer_of(partial(self._client.unregister_worker_plugin, self._name))  # ends what they are making
            end = time.monotonic() + _CONNECT_SECONDS
            for arrival in list(self._arrivals):
                arrival.join(max(0.0, end - time.monotonic()))  # it would wait for a closed client for ever
        self._opened.close()

    def capacity(self) -> int:
        """Return the number of the workers' threads; looked at once a second.

        Raises:
            ClusterError: the scheduler is gone.
        """
        if time.monotonic() - self._looked_at >= _LOOK_SECONDS:
            try:
                self._threads = sum(_answer_of(self._client.nthreads).values())
            except TimeoutError:
                raise self._hung() from None
            except (OSError, CancelledError):
                raise self._lost() from None
            self._looked_at = time.monotonic()
        if self._client.status != "running":
            raise self._lost()
        return self._threads

    def submit(self, entry: ShardEntry, on_images: OnImages) -> "Future[MadeShard]":
        """Begin a shard on a worker that has room."""
        self._on_images[entry.file] = on_images
        outcome: Future[MadeShard] = Future()
        task = self._client.submit(make_on_worker, self._name, entry, key=next(self._keys), pure=False)
        task.add_done_callback(partial(self._begin_arrival, outcome))
        return outcome

    def _begin_arrival(self, outcome: "Future[MadeShard]", task: "DaskFuture[MadeShard]") -> None:
        """Fetch a shard in a thread of its own: Dask's has all others wait, and this process when it ends."""
        if not self._is_closed:
            arrival = threading.Thread(target=self._arrive, args=[outcome, task], daemon=True)
            arrival.start()
            self._arrivals = [*(thread for thread in self._arrivals if thread.is_alive()), arrival]

    def _arrive(self, outcome: "Future[MadeShard]", task: "DaskFuture[MadeShard]") -> None:
        try:
            outcome.set_result(task.result())
        except KilledWorker as error:
            lost = RendererCrashedError(f"Dask lost {error.allowed_failures + 1} workers that were making it")
            lost.worker = str(error.last_worker.address)
            outcome.set_exception(lost)
        except SymsolError as error:
            outcome.set_exception(error)
        except (OSError, TimeoutError, CancelledError):
            outcome.set_exception(self._lost())
        except Exception as error:  # noqa: BLE001 - whatever a worker may raise
            outcome.set_exception(ClusterError(f"a worker of {self._address} failed: {type(error).__name__}: {error}"))
        finally:
            task.release()

    def _hear(self, event: tuple[float, dict[str, Any]]) -> None:
        _, said = event
        self._on_images[said["shard"]](said["images"])

    def _lost(self) -> ClusterError:
        return ClusterError(
            f"the Dask scheduler at {self._address} is gone. Finished shards are kept: the same command goes on once "
            "it is back, or without --cluster on this machine"
        )

    def _hung(self) -> ClusterError:
        return ClusterError(
            f"the Dask scheduler at {self._address}, or a worker of it, gave no answer in {_ANSWER_SECONDS:g} s. End "
            "the one that hangs: finished shards are kept, and the same command goes on"
        )

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_SECONDS)
        except TimeoutError:
            raise ClusterError(
                f"the Dask scheduler at {self._address} has no workers, and none came in {_FIRST_WORKER_SECONDS:g} s: "
                f"start some with `dask worker {self._address}`"
            ) from None
        ask = partial(self._client.get_versions, packages=["symsol-annot", *_DECIDE_BYTES])
        versions: Any = _answer_of(ask)
        faults = worker_faults({worker: about["packages"] for worker, about in versions["workers"].items()})
        if faults:
            raise ClusterError(
                f"workers of {self._address} cannot make this set; nothing was begun:\n" + bulleted(faults)
            )


def _answer_of(ask: Callable[[], Any]) -> Any:
    """Ask Dask for something, and return its answer; for a worker that hangs, it would wait for ever.

    Raises:
        TimeoutError: there was none in time.
    """
    answer: Future[Any] = Future()

    def wait() -> None:
        try:
            answer.set_result(ask())
        except BaseException as error:  # noqa: BLE001 - whatever it is, it is for the one who asked
            answer.set_exception(error)

    threading.Thread(target=wait, daemon=True).start()
    return answer.result(_ANSWER_SECONDS)


@contextmanager
def _silent_dask() -> Iterator[None]:
    """Keep Dask's client from printing tracebacks of what becomes a ClusterError here."""
    logs = [logging.getLogger(name) for name in ("distributed", "distributed.client")]
    levels = [log.level for log in logs]
    for log in logs:
        log.setLevel(logging.CRITICAL)
    try:
        yield
    finally:
        for log, level in zip(logs, levels, strict=True):
            log.setLevel(level)


def check_scheduler(address: str) -> None:
    """Check that a Dask scheduler answers at an address.

    Raises:
        ClusterError: nobody answers, or something else does.
    """

    async def identity() -> Any:
        connection_args = Security().get_connection_args("client")
        async with rpc(address, connection_args=connection_args) as scheduler:
            return await asyncio.wait_for(scheduler.identity(), _CONNECT_SECONDS)

    _check_somebody_listens(address)
    try:
        answer = asyncio.run(identity())
        found = answer["type"] if isinstance(answer, dict) and "type" in answer else answer
    except Exception as error:  # noqa: BLE001 - whatever a stranger's answer makes of Dask
        found = type(error).__name__
    if found != "Scheduler":
        what = {"Worker": "a Dask worker", "Nanny": "a Dask nanny"}.get(
            str(found), "something that is no Dask scheduler"
        )
        raise ClusterError(
            f"--cluster {address}: {what} answers there. Give the address that `dask scheduler` prints at its start"
        )


def _check_somebody_listens(address: str) -> None:
    try:
        socket.create_connection(get_address_host_port(address), timeout=_CONNECT_SECONDS).close()
    except (ValueError, OverflowError) as error:
        raise ClusterError(
            f"--cluster {address}: is no address ({error}); expected one like tcp://10.0.0.1:8786"
        ) from None
    except OSError as error:
        why = error.strerror or str(error)
        raise ClusterError(
            f"--cluster {address}: nobody answers there ({why}). Start a scheduler with `dask scheduler`, "
            "or correct the address"
        ) from None


def address_in(scheduler_file: Path) -> str:
    """Return the address in a file that `dask scheduler --scheduler-file` wrote.

    Raises:
        ClusterError: it holds none.
    """
    try:
        return str(json.loads(scheduler_file.read_text())["address"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ClusterError(
            f"{scheduler_file}: holds no address of a scheduler ({type(error).__name__}: {error}); "
            f"`dask scheduler --scheduler-file {scheduler_file}` writes one"
        ) from None


def worker_faults(packages: Mapping[str, Mapping[str, str | None]]) -> list[str]:
    """Say what keeps workers from making the same bytes: a line each.

    Args:
        packages: by worker, the versions of Python and of packages; None for one that is not installed.
    """
    faults = []
    for worker, versions in packages.items():
        python = ".".join(str(versions["python"]).split(".")[:2])
        needed = ".".join(map(str, RENDERING_PYTHON))
        if python != needed:
            faults.append(f"{worker} runs Python {python}; Blender's module bpy needs {needed}")
        elif versions["symsol-annot"] is None:
            faults.append(f"{worker} lacks symsol-annot: there, `pip install 'symsol-annot[render,cluster]'`")
        elif versions["symsol-annot"] != __version__:
            faults.append(f"{worker} has symsol-annot {versions['symsol-annot']}, this command is {__version__}")
        elif versions["bpy"] is None:
            faults.append(f"{worker} lacks bpy: there, `pip install 'symsol-annot[render]'`")
    return faults or _differences(packages)


def _differences(packages: Mapping[str, Mapping[str, str | None]]) -> list[str]:
    differences = []
    for name in _DECIDE_BYTES:
        found: dict[str | None, str] = {}
        for worker, versions in packages.items():
            found.setdefault(versions[name], worker)
        if len(found) > 1:
            having = ", ".join(f"{version} on {worker}" for version, worker in found.items())
            differences.append(f"{name} is not the same everywhere, and would make other bytes: {having}")
    return differences


def make_on_worker(name: str, entry: ShardEntry) -> MadeShard:
    """Make a shard on the Dask worker that runs this task, with the makers that were registered there by name."""
    worker = get_worker()
    makers: Any = worker.plugins[name]
    made: MadeShard = makers.make(entry, worker)
    return made


class _ShardMakers(WorkerPlugin):
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

        def on_images(images: int) -> None:
            nonlocal told_at
            if time.monotonic() - told_at >= _TELL_SECONDS:
                told_at = time.monotonic()
                worker.log_event(self.name, {"shard": entry.file, "images": images})

        try:
            made = self._makers.make(entry, on_images)
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
