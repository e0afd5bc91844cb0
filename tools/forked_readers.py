"""The processes that read files of unknown origin, forked, and which files they open.

A process per file is started by a fork here, which takes milliseconds; what runs in it is what runs in the product.
"""

import contextlib
import ctypes
import os
import resource
import signal
import subprocess
import sys
import traceback
import warnings
from pathlib import Path
from types import SimpleNamespace

from symsol_annot.system.sandbox import hdf5_child
from symsol_annot.system.sandbox import hdf5_process as sandbox


class ForkedChild:
    """What `subprocess.Popen` is to the sandbox, forked from this process instead of started afresh."""

    stderr = os.devnull  # of the processes

    def __init__(self, command, **_):
        seconds, processor_seconds, memory_bytes = command[-3:]
        requests, self.stdin = _pipe()
        answers = os.pipe()
        self.stdout, self.returncode = os.fdopen(answers[0], "rb"), None
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # about threads, of which the fork uses none
            self.pid = os.fork()
        if self.pid == 0:
            limits = float(seconds), float(processor_seconds), int(memory_bytes) + _address_space()
            _serve(requests, answers[1], limits)
        os.close(requests)
        os.close(answers[1])

    def kill(self):
        if self.returncode is None:
            os.kill(self.pid, signal.SIGKILL)

    def poll(self):
        if self.returncode is None:
            pid, status = os.waitpid(self.pid, os.WNOHANG)
            self.returncode = os.waitstatus_to_exitcode(status) if pid else None
        return self.returncode

    def wait(self):
        if self.returncode is None:
            self.returncode = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.returncode


@contextlib.contextmanager
def forked_children(stderr=os.devnull):
    """Let the sandbox fork its processes."""
    ForkedChild.stderr = stderr
    with _beginning_with(SimpleNamespace(Popen=ForkedChild, PIPE=subprocess.PIPE, DEVNULL=subprocess.DEVNULL)):
        yield


def started_children():
    """Let the sandbox start its processes afresh, as the product does, within `forked_children` too."""
    return _beginning_with(subprocess)


@contextlib.contextmanager
def _beginning_with(module):
    before, sandbox.subprocess = sandbox.subprocess, module
    try:
        yield
    finally:
        sandbox.subprocess = before


def _pipe():
    read, write = os.pipe()
    return read, os.fdopen(write, "wb")


def _serve(requests, answers, limits):
    try:
        os.setsid()
        os.dup2(requests, 0)
        os.dup2(answers, 1)
        os.dup2(os.open(ForkedChild.stderr, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600), 2)
        os.closerange(3, 256)
        sys.stdin, sys.stdout, sys.stderr = os.fdopen(0), os.fdopen(1, "w"), os.fdopen(2, "w")
        hdf5_child.main(*limits)
        sys.stdout.flush()
    except BaseException:  # noqa: BLE001 - a fork ends here, whatever happens
        traceback.print_exc()
        sys.stderr.flush()
        os._exit(1)
    os._exit(0)


def _address_space():
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


class Opened:
    """Tells which files of a folder were opened since it was last asked (inotify)."""

    _IN_OPEN = 0x20

    def __init__(self, folder):
        libc = ctypes.CDLL(None, use_errno=True)
        self._descriptor = libc.inotify_init1(os.O_NONBLOCK)
        if libc.inotify_add_watch(self._descriptor, os.fsencode(folder), self._IN_OPEN) < 0:
            raise OSError(ctypes.get_errno(), "inotify_add_watch")

    def names(self):
        events, found = b"", set()
        with contextlib.suppress(BlockingIOError):
            while True:
                events += os.read(self._descriptor, 65536)
        while events:
            length = int.from_bytes(events[12:16], sys.byteorder)
            found.add(events[16 : 16 + length].rstrip(b"\0").decode(errors="replace"))
            events = events[16 + length :]
        return found

    def close(self):
        os.close(self._descriptor)
