"""Shards made on a Dask cluster: real schedulers and workers over TCP, and all that can answer in their place."""

import http.server
import os
import resource
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress
from functools import partial

import dask_cluster
import pytest
from distributed import Client
from made_sets import make_plan

from symsol_annot import __version__
from symsol_annot.errors import ClusterError
from symsol_annot.generation.dask.checks import check_scheduler, worker_faults
from symsol_annot.generation.dask.executor import DaskCluster
from symsol_annot.generation.events import ShardBegunAgain, ShardFinished
from symsol_annot.generation.executors import local_processes
from symsol_annot.generation.generate import generate
from symsol_annot.sets.manifest import read_manifest

pytestmark = [
    pytest.mark.blender,
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),  # Dask's and tornado's own
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
]
PLAN = make_plan("tetX", train=32, test=40, size=48)  # 2 + 3 shards


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("whole") / "tetX"
    generate(PLAN, folder, partial(local_processes, workers=2))
    return folder


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """The address of a scheduler with two workers."""
    folder = tmp_path_factory.mktemp("cluster")
    with dask_cluster.scheduler(folder) as address, dask_cluster.workers(folder, address, 2):
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        yield address


def blenders_of(pid):
    """The Blender processes that a process has started."""
    found = subprocess.run(
        ["pgrep", "-P", str(pid), "-f", "generation.process"], capture_output=True, text=True, check=False
    )
    return [int(line) for line in found.stdout.split()]


def test_a_cluster_makes_the_bytes_of_local_processes_and_leaves_no_process_there(tmp_path, cluster, whole):
    events = []
    generate(PLAN, tmp_path / "tetX", partial(DaskCluster, address=cluster), events.append)
    assert contents(tmp_path / "tetX") == contents(whole)
    finished = [event for event in events if isinstance(event, ShardFinished)]
    assert {event.shard for event in finished} == {entry.file for entry in read_manifest(whole).shards}
    assert len({event.worker for event in finished}) == 2
    assert all(event.worker.startswith("tcp://127.0.0.1:") for event in finished)
    with Client(cluster, set_as_default=False) as client:
        assert client.run(blenders_of_this_worker) == {worker: [] for worker in client.nthreads()}


def blenders_of_this_worker():
    return blenders_of(os.getpid())


def test_a_killed_dask_worker_costs_its_shard_and_nothing_else(tmp_path, whole):
    with dask_cluster.scheduler(tmp_path) as address, dask_cluster.workers(tmp_path, address, 2) as processes:
        killed = []

        def on_event(event):
            if isinstance(event, ShardFinished) and not killed:
                killed.append(next(process.pid for process in processes if blenders_of(process.pid)))
                os.kill(killed[0], signal.SIGKILL)

        generate(PLAN, tmp_path / "tetX", partial(DaskCluster, address=address), on_event)
    assert killed
    assert contents(tmp_path / "tetX") == contents(whole)


def test_a_killed_blender_on_a_dask_worker_is_begun_again_and_told_of_with_the_worker(tmp_path, cluster, whole):
    events, killed = [], []
    with Client(cluster, set_as_default=False) as client:
        workers = list(client.run(os.getpid).values())

    def on_event(event):
        events.append(event)
        if isinstance(event, ShardFinished) and not killed:
            killed.append(next(blender for worker in workers for blender in blenders_of(worker)))
            os.kill(killed[0], signal.SIGKILL)

    generate(PLAN, tmp_path / "tetX", partial(DaskCluster, address=cluster), on_event)
    assert contents(tmp_path / "tetX") == contents(whole)
    again = [event for event in events if isinstance(event, ShardBegunAgain)]
    assert again
    assert all(event.worker.startswith("tcp://") for event in again)
    assert all("ended by signal SIGKILL" in event.reason for event in again)


def test_a_lost_scheduler_is_an_error_from_which_the_set_resumes(tmp_path, whole):
    with dask_cluster.scheduler(tmp_path) as address, dask_cluster.workers(tmp_path, address, 1):
        pids = subprocess.run(["pgrep", "-f", f"scheduler-file {tmp_path}"], capture_output=True, text=True, check=True)

        def on_event(event):
            if isinstance(event, ShardFinished):
                for pid in pids.stdout.split():
                    os.kill(int(pid), signal.SIGKILL)

        with pytest.raises(ClusterError, match=r"the Dask scheduler at tcp://.* is gone\. Finished shards are kept"):
            generate(PLAN, tmp_path / "tetX", partial(DaskCluster, address=address), on_event)
    kept = [entry.file for entry in read_manifest(tmp_path / "tetX").shards if entry.is_finished]
    assert len(kept) >= 1
    generate(PLAN, tmp_path / "tetX", partial(local_processes, workers=2))
    assert contents(tmp_path / "tetX") == contents(whole)


PRETEND = """
from importlib.metadata import version
from distributed import versions

def pretended(package):
    if package == {missing!r}:
        raise ImportError(package)
    return {other!r}.get(package) or version(package)

versions.version = pretended
versions._version_cached.cache_clear()
"""


@pytest.mark.parametrize(
    ("missing", "other", "words"),
    [
        ("bpy", {}, r"tcp://\S+ lacks bpy: there, `pip install 'symsol-annot\[render\]'`"),
        ("", {"symsol-annot": "0.0.9"}, rf"tcp://\S+ has symsol-annot 0\.0\.9, this command is {__version__}"),
        ("", {"h5py": "3.10.0"}, r"h5py is not the same everywhere.*3\.10\.0 on tcp://"),
    ],
)
def test_workers_that_would_make_nothing_or_other_bytes_are_refused_before_work(tmp_path, missing, other, words):
    """The second worker's process says that it has other versions; what it has is the same."""
    (tmp_path / "pretend.py").write_text(PRETEND.format(missing=missing, other=other))
    preload = ("--preload", str(tmp_path / "pretend.py"))
    with (
        dask_cluster.scheduler(tmp_path) as address,
        dask_cluster.workers(tmp_path, address, 1),
        dask_cluster.workers(tmp_path, address, 1, *preload),
    ):
        with Client(address, set_as_default=False) as client:
            client.wait_for_workers(2, timeout=60)
        with pytest.raises(ClusterError, match=rf"(?s)nothing was begun.*{words}"):
            generate(PLAN, tmp_path / "tetX", partial(DaskCluster, address=address))
    assert not (tmp_path / "tetX").exists()


def test_a_worker_that_answers_with_something_else_than_a_shard_is_an_error(tmp_path):
    preloaded = (
        "from symsol_annot.generation.dask import worker\nworker.make_on_worker = lambda name, entry: 'no shard'\n"
    )
    (tmp_path / "pretend.py").write_text(preloaded)
    with (
        dask_cluster.scheduler(tmp_path) as address,
        dask_cluster.workers(tmp_path, address, 1, "--preload", str(tmp_path / "pretend.py")),
        pytest.raises(
            ClusterError, match=r"a worker of tcp://\S+ failed: TypeError: expected a shard from it, found str"
        ),
    ):
        generate(PLAN, tmp_path / "tetX", partial(DaskCluster, address=address))


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({}, []),
        ({"python": "3.12.1.final.0"}, ["b runs Python 3.12; Blender's module bpy needs 3.11"]),
        ({"symsol-annot": None}, ["b lacks symsol-annot: there, `pip install 'symsol-annot[render,cluster]'`"]),
        ({"numpy": "1.26.3"}, ["numpy is not the same everywhere, and would make other bytes: 1 on a, 1.26.3 on b"]),
    ],
)
def test_faults_name_the_worker_and_what_to_install(changes, expected):
    good = {"python": "3.11.7.final.0", "symsol-annot": __version__, **dict.fromkeys(("bpy", "h5py", "numpy"), "1")}
    good["zlib-ng"] = "1"
    assert worker_faults({"a": good, "b": {**good, **changes}}) == expected


@contextmanager
def listening(say):
    """Somebody who takes connections, and with each, at once and in a thread of its own, does what `say` does."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        connections = []

        def speak(connection):
            with suppress(OSError):
                say(connection)

        def serve():
            with suppress(OSError):
                while True:
                    connections.append(server.accept()[0])
                    threading.Thread(target=speak, args=[connections[-1]], daemon=True).start()

        threading.Thread(target=serve, daemon=True).start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
        for connection in connections:
            connection.close()


GREETING = (
    b":\0\0\0\0\0\0\0\1\0\0\0\0\0\0\0*\0\0\0\0\0\0\0\x83\xabcompression\xc0\xa6python\x93\3\x0b\7\xafpickle-protocol\5"
)


def endless(what):
    def say(connection):
        while True:
            connection.sendall(what)

    return say


def dripping(what):
    def say(connection):
        for number in what:
            connection.sendall(bytes([number]))
            time.sleep(0.5)

    return say


def then_closes(what):
    def say(connection):
        connection.sendall(what)
        connection.shutdown(socket.SHUT_RDWR)

    return say


TWO_GIB = struct.pack("<Q", 2**31)
IMPOSTORS = {
    "silent": lambda connection: None,
    "ssh": lambda connection: connection.sendall(b"SSH-2.0-OpenSSH_9.2p1\r\n"),
    "zeros": lambda connection: connection.sendall(b"\0" * 64),
    "closes": then_closes(b""),
    "closes in the middle of a greeting": then_closes(GREETING[:40]),
    "closes after a greeting": then_closes(GREETING),
    "greets and falls silent": lambda connection: connection.sendall(GREETING),
    "drips": dripping(GREETING * 100),
    "greets and sends what is no message": lambda connection: connection.sendall(GREETING + struct.pack("<QQ", 8, 0)),
}
ENDLESS = {
    "zeros": endless(b"\0" * 2**16),
    "noise": endless(bytes(range(256)) * 2**8),
    "lines": endless(b"GET / HTTP/1.1\r\n" * 2**12),
    "2 GiB announced": endless(TWO_GIB * 2**13),
    "a greeting without the words": endless(struct.pack("<Q", 2**16) + b"\0" * 2**16),
}


def assert_refused(address, words):
    start = time.monotonic()
    with pytest.raises(ClusterError, match=words):
        check_scheduler(address)
    assert time.monotonic() - start < 15


def test_nobody_at_the_address_is_an_error_that_says_so():
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    assert_refused(f"tcp://127.0.0.1:{port}", r"nobody answers there \(Connection refused\)\. Start a scheduler")


@pytest.mark.parametrize("impostor", IMPOSTORS)
def test_whatever_else_is_at_the_address_is_refused_in_bounded_time_without_a_traceback(impostor, monkeypatch, caplog):
    monkeypatch.setattr("symsol_annot.generation.dask.checks.CONNECT_SECONDS", 3.0)
    with listening(IMPOSTORS[impostor]) as address:
        assert_refused(address, "something that is no Dask scheduler answers there. Give the address")
    assert not caplog.records


@pytest.mark.parametrize("impostor", ENDLESS)
def test_endless_bytes_are_refused_at_once_and_take_no_memory(impostor):
    before_kib, start = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss, time.monotonic()
    with listening(ENDLESS[impostor]) as address:
        assert_refused(address, "something that is no Dask scheduler answers there. Give the address")
    assert time.monotonic() - start < 5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before_kib < 2**16


def test_a_web_server_is_no_scheduler(monkeypatch):
    monkeypatch.setattr("symsol_annot.generation.dask.checks.CONNECT_SECONDS", 2.0)
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), QuietHandler) as web:
        threading.Thread(target=web.serve_forever, daemon=True).start()
        assert_refused(f"tcp://127.0.0.1:{web.server_address[1]}", "something that is no Dask scheduler answers there")
        web.shutdown()


class QuietHandler(http.server.BaseHTTPRequestHandler):
    timeout = 5

    def log_message(self, *_):
        pass


def test_the_address_of_a_worker_is_told_from_a_scheduler_s(cluster):
    with Client(cluster, set_as_default=False) as client:
        worker = next(iter(client.nthreads()))
    assert_refused(worker, "a Dask worker answers there")


@pytest.mark.parametrize(
    "address", ["somewhere", "carrier-pigeon://host:1", "tcp://127.0.0.1:99999", "inproc://1/2", "ucx://h:1"]
)
def test_what_is_no_address_is_refused(address):
    assert_refused(address, rf"--cluster {address}: is no address: .*expected one like tcp://")


def test_importing_the_package_or_the_commands_does_not_import_dask():
    said = "import sys, symsol_annot, symsol_annot_cli.main; print('distributed' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", said], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
