"""A private Dask cluster of real processes on loopback."""

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager

_START_SECONDS = 60


@contextmanager
def scheduler(folder, *options):
    """Run `dask scheduler`; its address is given."""
    file = folder / "scheduler.json"
    common = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", str(file))
    with _running("scheduler", *common, *options, folder=folder):
        yield _wait_for(lambda: file.exists() and json.loads(file.read_text() or "{}").get("address"))


@contextmanager
def workers(folder, address, count, *options):
    """Run `dask worker` processes of one thread each, without nannies; their addresses are not waited for."""
    with ExitStack() as stack:
        common = ("--no-nanny", "--nthreads", "1", "--host", "127.0.0.1", "--local-directory", str(folder))
        yield [stack.enter_context(_running("worker", address, *common, *options, folder=folder)) for _ in range(count)]


@contextmanager
def _running(*words, folder):
    with (
        (folder / f"{words[0]}.log").open("ab") as log,
        subprocess.Popen(
            [sys.executable, "-m", "dask", *words, "--no-dashboard"],
            stdout=log,
            stderr=log,
            env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        ) as process,
    ):
        try:
            yield process
        finally:
            process.kill()


def _wait_for(condition):
    end = time.monotonic() + _START_SECONDS
    while not (value := condition()):
        if time.monotonic() > end:
            raise TimeoutError("the Dask scheduler did not start")
        time.sleep(0.05)
    return value
