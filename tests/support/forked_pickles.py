"""The processes that read files of torch.save, forked from one that has imported torch, which takes a second."""

import contextlib
import os
import signal
import subprocess
import sys
import traceback
from types import SimpleNamespace

import torch

from symsol_annot.bench.models.weights import pickle_child, state_dicts

torch.set_num_threads(1)  # threads are not forked


@contextlib.contextmanager
def forked_pickles():
    """Let files of torch.save be read in forks; what runs in them is what runs in the product."""
    state_dicts.subprocess = SimpleNamespace(run=_run, PIPE=subprocess.PIPE, DEVNULL=subprocess.DEVNULL)
    try:
        yield
    finally:
        state_dicts.subprocess = subprocess


def _run(command, *, stdin, **_):
    """Do what `subprocess.run` does to the program `pickle_child.py`."""
    answer, printed = os.pipe()
    pid = os.fork()
    if pid == 0:
        _read(command[-3:], stdin, printed)
    os.close(printed)
    with os.fdopen(answer, "rb") as file:
        stdout = file.read()
    return SimpleNamespace(returncode=os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]), stdout=stdout)


def _read(limits, stdin, printed):
    try:
        os.setsid()
        os.dup2(stdin, 0)
        os.dup2(printed, 1)
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        os.closerange(3, 256)
        sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w")
        signal.signal(signal.SIGPROF, signal.SIG_DFL)
        pickle_child.main(float(limits[0]), int(limits[1]), int(limits[2]))
        sys.stdout.flush()
    except BaseException:  # noqa: BLE001 - a fork ends here, whatever happens
        traceback.print_exc()
        os._exit(1)
    os._exit(0)
