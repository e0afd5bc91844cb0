"""The executor on a Dask cluster: its workers make the shards, this process checks and writes them."""

import threading
import time
import uuid
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import ExitStack, suppress
from functools import partial
from itertools import count
from typing import Any, Self

from distributed import Client, KilledWorker
from distributed import Future as DaskFuture

from symsol_annot.errors import ClusterError, RendererCrashedError, SymsolError, bulleted
from symsol_annot.generation.dask.checks import (
    CONNECT_SECONDS,
    DECIDE_BYTES,
    check_scheduler,
    faults_of_encryption,
    silent_dask,
    worker_faults,
    worker_options,
)
from symsol_annot.generation.dask.worker import ShardMakers, make_on_worker
from symsol_annot.generation.maker import MadeShard, OnShardImages
from symsol_annot.generation.process import DEFAULT_LIMITS, Limits
from symsol_annot.sets.manifest import ShardEntry
from symsol_annot.sets.plan import SetPlan

_ANSWER_SECONDS = 20.0  # in which a scheduler and all its workers must answer
_FIRST_WORKER_SECONDS = 60.0
_LOOK_SECONDS = 1.0  # between two questions for the number of workers


class DaskCluster:
    """Makes shards on the workers of a Dask scheduler; one at a time for each of their threads.

    Args:
        plan: the set.
        address: the scheduler's, like tcp://10.0.0.1:8786 or tls://10.0.0.1:8786.
        limits: of each worker's Blender process.
        exhaustive: draw every candidate.

    Raises:
        ClusterError: no scheduler answers, TLS fails, or there are no workers, or they lack what is needed or differ.
    """

    def __init__(
        self, plan: SetPlan, address: str, *, limits: Limits = DEFAULT_LIMITS, exhaustive: bool = False
    ) -> None:
        self._address = address
        self._makers = ShardMakers(plan, limits, exhaustive=exhaustive)
        self._name = self._makers.name
        self._keys = (f"{self._name} {uuid.uuid4().hex[:8]}-{number}" for number in count())
        self._on_shard_images: dict[str, OnShardImages] = {}  # by shard
        self._threads, self._looked_at = 0, -_LOOK_SECONDS
        self._arrivals: list[threading.Thread] = []
        self._is_closed = False

    def __enter__(self) -> Self:
        """Connect, look at the workers, and hand them the plan."""
        check_scheduler(self._address)
        with ExitStack() as opened:
            opened.enter_context(silent_dask())
            try:
                client = Client(self._address, timeout=CONNECT_SECONDS, set_as_default=False)
                self._client = opened.enter_context(client)
                self._check_workers()
                _answer_of(partial(self._client.register_plugin, self._makers))
                self._client.subscribe_topic(self._name, self._hear)
            except TimeoutError:
                raise self._hung() from None
            except (OSError, CancelledError):
                raise self._lost() from None
            except SymsolError:
                raise
            except Exception as error:
                raise self._strange(error) from error
            self._opened = opened.pop_all()
        return self

    def __exit__(self, *error: object) -> None:
        self._is_closed = True
        if self._client.status == "running":
            with suppress(OSError, TimeoutError, ValueError):
                _answer_of(partial(self._client.unregister_worker_plugin, self._name))  # ends what they are making
            end = time.monotonic() + CONNECT_SECONDS
            for arrival in list(self._arrivals):
                arrival.join(max(0.0, end - time.monotonic()))  # it would wait for a closed client for ever
        self._opened.close()

    def capacity(self) -> int:
        """Return the number of the workers' threads; looked at once a second.

        Raises:
            ClusterError: the scheduler is gone, or a worker has come that listens without TLS where it speaks TLS.
        """
        if time.monotonic() - self._looked_at >= _LOOK_SECONDS:
            try:
                threads: Mapping[str, int] = _answer_of(self._client.nthreads)
            except TimeoutError:
                raise self._hung() from None
            except (OSError, CancelledError):
                raise self._lost() from None
            self._check_encryption(threads)
            self._threads, self._looked_at = sum(threads.values()), time.monotonic()
        if self._client.status != "running":
            raise self._lost()
        return self._threads

    def prepare(self, shards: int) -> None:
        """Leave it to the cluster's workers, which start with their first shard."""

    def submit(self, entry: ShardEntry, on_shard_images: OnShardImages) -> "Future[MadeShard]":
        """Begin a shard on a worker that has room."""
        self._on_shard_images[entry.file] = on_shard_images
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
            made = task.result()
            if not isinstance(made, MadeShard):
                raise TypeError(f"expected a shard from it, found {type(made).__name__}")  # noqa: TRY301 - told below
            outcome.set_result(made)
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
        if said.get("shard") in self._on_shard_images:
            self._on_shard_images[said["shard"]](said["images"])

    def _lost(self) -> ClusterError:
        return ClusterError(
            f"the Dask scheduler at {self._address} is gone. Finished shards are kept: re-running the command resumes "
            "it once the scheduler is back, or without --cluster on this machine"
        )

    def _hung(self) -> ClusterError:
        return ClusterError(
            f"the Dask scheduler at {self._address}, or a worker of it, gave no answer in {_ANSWER_SECONDS:g} s. End "
            "the one that hangs: finished shards are kept, and re-running the command resumes it"
        )

    def _strange(self, error: Exception) -> ClusterError:
        return ClusterError(
            f"the Dask scheduler at {self._address} answers otherwise than Dask does here ({type(error).__name__}: "
            f"{error}). Have the same Python and the same version of distributed there and here"
        )

    def _check_encryption(self, workers: Iterable[str]) -> None:
        faults = faults_of_encryption(self._address, workers)
        if faults:
            raise ClusterError(f"workers of {self._address} are not protected as it is:\n" + bulleted(faults))

    def _check_workers(self) -> None:
        try:
            self._client.wait_for_workers(1, timeout=_FIRST_WORKER_SECONDS)
        except TimeoutError:
            raise ClusterError(
                f"the Dask scheduler at {self._address} has no workers, and none came in {_FIRST_WORKER_SECONDS:g} s: "
                f"start some with `dask worker {self._address}{worker_options(self._address)}`"
            ) from None
        ask = partial(self._client.get_versions, packages=["symsol-annot", *DECIDE_BYTES])
        versions: Any = _answer_of(ask)
        self._check_encryption(versions["workers"])
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
