"""Faults of workers on this machine, one of them or every one: they hang, crash, run out of memory, are interrupted.

python tools/soak/worker_faults.py [--only WORDS]

What happens to one is survived; what happens to every one ends in a message that says so, and the set resumes once
it stops. Memory runs out by the command's own limit, by a limit on the address space of a running process, and by
the kernel's OOM killer in a control group; that needs root.
"""

import os
import signal
import subprocess
import time
from functools import partial
from pathlib import Path

from outcomes import run_alone
from processes import END_S, finished, kill, wait_for
from trials import SET, try_all, undisturbed_set

GOES_ON = "re-running the command resumes it"
TIME_LIMIT = ("--time-limit", "3")
_GROUPS = Path("/sys/fs/cgroup/memory")  # version 1 of control groups
_MIB = 2**20


def prove(table, only):
    """Suffer all faults whose names have some words."""
    try:
        try_all(table, [fault for fault in FAULTS if only in f"{fault[0]}: {fault[1]}"], undisturbed_set())
    finally:
        for group in _GROUPS.glob("soak-*"):
            group.rmdir()
    return {"set": SET}


def one_worker(suffer, words, options, trial):
    running = trial.started(*options)
    suffer(trial.site.blenders()[0])
    trial.survives(running, *words, "begun again after failure 1")


def every_worker(suffer, words, options, trial):
    make_all_suffer(suffer, trial.started(*options), words, trial)
    trial.expect(finished(trial.folder), "no finished shard was kept")
    trial.resumes()


def one_starting_worker(suffer, words, options, trial):
    running = trial.start(*options)
    suffer(wait_for(trial.site.blenders)[0])
    trial.survives(running, *words, "begun again after failure 1")


def every_starting_worker(suffer, words, options, trial):
    make_all_suffer(suffer, trial.start(*options), words, trial)
    trial.resumes()


def make_all_suffer(suffer, running, words, trial):
    """Be on the watch for workers until the command gives up."""
    done = set()
    while running.is_running and running.seconds < END_S:
        for blender in trial.site.blenders():
            if blender.pid not in done:
                suffer(blender)
                done.add(blender.pid)
        time.sleep(0.02)
    trial.refuses(running, *words, GOES_ON)


def too_little_allowed(trial):
    trial.refuses(trial.start("--worker-memory", "64"), "more than --worker-memory allows: 64 MiB", GOES_ON)
    trial.resumes("--worker-memory", "2048")


def interrupted(number, trial):
    running = trial.started()
    os.kill(running.pid, number)
    trial.refuses(running, "are kept; re-running the command resumes it.", "Interrupted.", code=130)
    trial.resumes()


def send(number, blender):
    kill([blender], number)


def limit_address_space(blender):
    subprocess.run(["prlimit", f"--pid={blender.pid}", f"--as={_MIB}"], check=False, capture_output=True)


def limit_in_a_control_group(blender):
    group = _GROUPS / f"soak-{blender.pid}"
    group.mkdir()
    (group / "memory.limit_in_bytes").write_text(str(_MIB))
    (group / "cgroup.procs").write_text(str(blender.pid))


HANG = ("hang: SIGSTOP, --time-limit 3", partial(send, signal.SIGSTOP), ["gave no sign of life for 3 s"], TIME_LIMIT)
CRASH = ("crash: SIGSEGV", partial(send, signal.SIGSEGV), ["ended by signal SIGSEGV"], ())
NO_ADDRESSES = ("out of memory: prlimit --as", limit_address_space, ["emory"], ())
KILLED = ("out of memory: the kernel kills", limit_in_a_control_group, ["when memory runs out"], ())
FAULTS = (
    *((what, "one worker", partial(one_worker, *how)) for what, *how in (HANG, CRASH)),
    *((what, "every worker", partial(every_worker, *how)) for what, *how in (HANG, CRASH)),
    *((what, "one worker at its start", partial(one_starting_worker, *how)) for what, *how in (NO_ADDRESSES, KILLED)),
    *(
        (what, "every worker at its start", partial(every_starting_worker, *how))
        for what, *how in (NO_ADDRESSES, KILLED)
    ),
    ("out of memory: --worker-memory 64", "every worker", too_little_allowed),
    ("interrupted: SIGINT", "the command", partial(interrupted, signal.SIGINT)),
    ("interrupted: SIGTERM", "the command", partial(interrupted, signal.SIGTERM)),
)


if __name__ == "__main__":
    run_alone(__doc__, "worker_faults", prove, only="")
