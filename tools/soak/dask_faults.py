"""Faults of a Dask cluster: no scheduler, impostors at its address, workers that differ, leave, hang or never come.

python tools/soak/dask_faults.py [--only WORDS] [--patient]

Each ends in a message that says what to do and in a set that resumes, or is survived. Workers that lack something run
in environments that lack it. `--patient` adds the case in which the command waits a minute for the first worker.
"""

import os
import signal
import socket
import sys
import time
from functools import partial

from folder_faults import FULL, disk
from installations import environment
from outcomes import run_alone
from processes import kill, wait_for
from trials import SET, try_all, undisturbed_set

from symsol_annot import __version__

GOES_ON = "re-running the command resumes it"
IMPOSTOR = """
import socket, sys
with socket.create_server(("127.0.0.1", 0)) as server:
    print(server.getsockname()[1], flush=True)
    callers = []
    while True:
        callers.append(server.accept()[0])
        callers[-1].sendall(sys.argv[1].encode())
"""
HTTP = """
from http.server import HTTPServer, SimpleHTTPRequestHandler
server = HTTPServer(("127.0.0.1", 0), SimpleHTTPRequestHandler)
print(server.server_port, flush=True)
server.serve_forever()
"""


def prove(table, only, patient):
    """Suffer all faults whose names have some words."""
    faults = (*FAULTS, NO_WORKER) if patient else FAULTS
    try_all(table, [fault for fault in faults if only in f"{fault[0]}: {fault[1]}"], undisturbed_set())
    return {"set": SET}


# Addresses


def nobody(trial):
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    trial.refuses(trial.start("--cluster", f"tcp://127.0.0.1:{port}"), "nobody answers there", "`dask scheduler`")
    trial.resumes()


def no_address(address, trial):
    trial.refuses(trial.start("--cluster", address), f"--cluster {address}: is no address", "expected one like tcp://")
    trial.resumes()


def no_scheduler_file(trial):
    trial.refuses(trial.start("--scheduler-file", "nothing.json"), "nothing.json: holds no address of a scheduler")
    trial.resumes()


def impostor(program, says, trial):
    running = trial.site.start("impostor", sys.executable, "-c", program, says)
    port = wait_for(lambda: running.said("out").strip())
    words = ("something that is no Dask scheduler answers there", "the address that `dask scheduler` prints")
    trial.refuses(trial.start("--cluster", f"tcp://127.0.0.1:{port}"), *words)
    os.kill(running.pid, signal.SIGKILL)
    running.end()
    trial.resumes()


def worker_as_scheduler(trial):
    address = min(trial.cluster.start().wait_for_workers(2))
    trial.refuses(trial.start("--cluster", address), "a Dask worker answers there", "that `dask scheduler` prints")
    trial.resumes(*on(trial.cluster))


def without_dask(trial):
    python = environment(trial.site.folder / "environment", without=("distributed",))
    trial.refuses(
        trial.start("--cluster", "tcp://127.0.0.1:8786", python=python), "pip install 'symsol-annot[cluster]'"
    )
    trial.resumes()


# Workers that differ


def other_worker(words, changes, trial):
    """One worker of two is not like the command; then it is replaced."""
    trial.cluster.start_scheduler()
    trial.cluster.start_worker(0)
    trial.cluster.start_worker(1, python=environment(trial.site.folder / "environment", **changes))
    trial.cluster.wait_for_workers(2)
    trial.refuses(trial.start(*on(trial.cluster)), "cannot make this set; nothing was begun", *words)
    trial.expect(not trial.folder.exists(), "something was begun")
    replace_worker(trial)
    trial.resumes(*on(trial.cluster))


def other_worker_joins(words, changes, trial):
    """A worker that is not like the others comes when the set is half made; then it is replaced."""
    trial.cluster.start(workers=1)
    running = trial.started(*on(trial.cluster), "--worker-frames", "1")
    trial.cluster.start_worker(1, python=environment(trial.site.folder / "environment", **changes))
    trial.refuses(running, *words)
    replace_worker(trial)
    trial.resumes(*on(trial.cluster))


def useless_worker_joins(trial):
    """A worker comes that cannot even be told of the set; Dask keeps it, though it hangs."""
    trial.cluster.start(workers=1)
    running = trial.started(*on(trial.cluster), "--worker-frames", "1")
    trial.cluster.start_worker(1, python=environment(trial.site.folder / "environment", **NO_PACKAGE))
    trial.survives(running)
    trial.refuses(trial.start(*on(trial.cluster), "--seed", "1", out=trial.site.folder / "more"), *NO_ANSWER)
    kill(trial.site.alive("worker-1"))


def scheduler_hangs(trial):
    trial.cluster.start()
    running = trial.started(*on(trial.cluster))
    hung = trial.site.alive("scheduler")
    kill(hung, signal.SIGSTOP)
    trial.refuses(running, *NO_ANSWER)
    kill(hung, signal.SIGCONT)
    trial.resumes(*on(trial.cluster))


def replace_worker(trial):
    trial.cluster.stop_worker(1)
    trial.cluster.start_worker(1)
    trial.cluster.wait_for_workers(2)


# Workers that come, go and hang


def no_worker(trial):
    trial.cluster.start_scheduler()
    words = ("has no workers, and none came in 60 s", "start some with `dask worker tcp://127.0.0.1:")
    trial.refuses(trial.start(*on(trial.cluster)), *words)
    trial.cluster.start_worker(0)
    trial.resumes(*on(trial.cluster))


def late_worker(trial):
    trial.cluster.start_scheduler()
    running = trial.start(*on(trial.cluster))
    time.sleep(4)
    trial.cluster.start_worker(0)
    trial.survives(running)


def workers_leave_and_come(trial):
    trial.cluster.start()
    running = trial.started(*on(trial.cluster))
    kill([process for pair in trial.cluster.workers_and_nannies() for process in reversed(pair)])
    trial.expect(wait_for(lambda: "There is no worker" in running.said()), "did not say that no worker is there")
    trial.cluster.start_worker(2)
    trial.survives(running, "There is no worker at the moment; waiting for one. Ctrl-C keeps the finished shards.")


def scheduler_dies(trial):
    trial.cluster.start()
    running = trial.started(*on(trial.cluster))
    kill(trial.site.alive("scheduler"))
    trial.refuses(running, "is gone. Finished shards are kept", GOES_ON, "without --cluster on this machine")
    trial.expect(not trial.site.outlasting(trial.site.blenders), "a Blender process is left")
    trial.resumes()


def disk_full(trial):
    """Some sizes of disk, so that it is full while other shards arrive."""
    trial.cluster.start()
    with disk(trial.site.out, "size=100k") as remount:
        for kibibytes in range(100, 300, 25):
            remount(f"size={kibibytes}k")
            trial.refuses(trial.start(*on(trial.cluster)), FULL)
        remount("size=4m")
        trial.resumes(*on(trial.cluster))


def interrupted(number, trial):
    trial.cluster.start()
    running = trial.started(*on(trial.cluster))
    os.kill(running.pid, number)
    trial.refuses(running, "are kept; re-running the command resumes it.", "Interrupted.", code=130)
    trial.resumes(*on(trial.cluster))


def blender_suffers(number, words, options, trial):
    trial.cluster.start()
    running = trial.started(*on(trial.cluster), *options)
    kill(trial.site.blenders()[:1], number)
    trial.survives(running, "begun again after failure 1", *words)


def too_little_allowed(trial):
    trial.cluster.start()
    words = ("more than --worker-memory allows: 64 MiB", GOES_ON)
    trial.refuses(trial.start(*on(trial.cluster), "--worker-memory", "64"), *words)
    trial.resumes(*on(trial.cluster), "--worker-memory", "2048")


def worker_hangs(trial):
    """Dask itself takes note of that, after its worker-ttl."""
    trial.cluster.start(DASK_DISTRIBUTED__SCHEDULER__WORKER_TTL="5s")
    running = trial.started(*on(trial.cluster))
    hung = trial.cluster.workers_and_nannies()[0][0]
    kill([hung], signal.SIGSTOP)
    trial.survives(running)
    kill([hung], signal.SIGCONT)


def client_is_killed(trial):
    """The workers' Blenders end by themselves, also if nobody comes back."""
    trial.cluster.start()
    running = trial.started(*on(trial.cluster))
    os.kill(running.pid, signal.SIGKILL)
    running.end()
    seconds = time.monotonic()
    trial.expect(wait_for(lambda: not trial.site.blenders(), 40), "a Blender process outlasts its command by 40 s")
    trial.note(f"Blenders ended after {time.monotonic() - seconds:.0f} s")
    trial.resumes(*on(trial.cluster))


def on(cluster):
    return "--cluster", cluster.address


HANG = (signal.SIGSTOP, ["gave no sign of life for 3 s"], ("--time-limit", "3"))
CRASH = (signal.SIGSEGV, ["ended by signal SIGSEGV"], ())
BANNER = "SSH-2.0-OpenSSH_9.2p1\r\n"
OTHER, NO_PACKAGE, NO_BPY, OTHER_HDF5 = (
    {"versions": {"symsol-annot": "0.0.9"}},
    {"without": ("symsol-annot",)},
    {"without": ("bpy",)},
    {"versions": {"h5py": "3.10.0"}},
)
IS_OTHER = ("has symsol-annot 0.0.9", f"this command is {__version__}")
JOINS_OTHER = ("makes shards with other software than", "symsol-annot: there", GOES_ON)
NO_ANSWER = ("or a worker of it, gave no answer in 20 s. End the one that hangs", GOES_ON)
NO_WORKER = ("no worker", "for a minute", no_worker)
FAULTS = (
    ("scheduler absent", "nobody at the address", nobody),
    ("scheduler absent", "no address", partial(no_address, "nonsense")),
    ("scheduler absent", "no scheduler file", no_scheduler_file),
    ("scheduler killed", "in the middle", scheduler_dies),
    ("impostor at the address", "a web server", partial(impostor, HTTP, "")),
    ("impostor at the address", "an SSH server's banner", partial(impostor, IMPOSTOR, BANNER)),
    ("impostor at the address", "accepts and says nothing", partial(impostor, IMPOSTOR, "")),
    ("impostor at the address", "a Dask worker", worker_as_scheduler),
    ("Dask not installed", "with the command", without_dask),
    ("version mismatch", "another symsol-annot, installed", partial(other_worker, IS_OTHER, OTHER)),
    ("version mismatch", "no symsol-annot", partial(other_worker, ["lacks symsol-annot: there, `pip"], NO_PACKAGE)),
    ("version mismatch", "no bpy", partial(other_worker, ["lacks bpy: there, `pip install"], NO_BPY)),
    ("version mismatch", "another h5py, only reported", partial(other_worker, ["h5py is not the same"], OTHER_HDF5)),
    ("version mismatch", "another symsol-annot joins", partial(other_worker_joins, JOINS_OTHER, OTHER)),
    (
        "version mismatch",
        "one without bpy joins",
        partial(other_worker_joins, ["module bpy, which is not inst"], NO_BPY),
    ),
    ("version mismatch", "one without symsol-annot joins", useless_worker_joins),
    ("no worker", "for 4 s", late_worker),
    ("no worker", "in the middle: all killed", workers_leave_and_come),
    ("hang: SIGSTOP, --time-limit 3", "a Dask worker's Blender", partial(blender_suffers, *HANG)),
    ("hang: SIGSTOP", "the scheduler", scheduler_hangs),
    ("hang: SIGSTOP, worker-ttl 5 s", "a Dask worker", worker_hangs),
    ("crash: SIGSEGV", "a Dask worker's Blender", partial(blender_suffers, *CRASH)),
    ("out of memory: --worker-memory 64", "every Dask worker's Blender", too_little_allowed),
    ("disk full", "the command's, 8 sizes", disk_full),
    ("interrupted: SIGINT", "the command", partial(interrupted, signal.SIGINT)),
    ("command killed", "in the middle, never resumed", client_is_killed),
)


if __name__ == "__main__":
    run_alone(__doc__, "dask_faults", prove, only="", patient=False)
