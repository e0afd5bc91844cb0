"""One attempt in a process of its own: forked from one that has imported everything, watched, and ended if need be.

A fork takes milliseconds, and what runs in it is what runs in a user's process: its crash, its memory and its time are
the user's. Processes that it starts itself are counted with it.
"""

import contextlib
import ctypes
import json
import os
import select
import signal
import sys
import time
import traceback
import warnings
from dataclasses import dataclass
from pathlib import Path

SECONDS = 10.0  # within which each attempt must end
WAITING_SECONDS = 120.0  # the same for one that has not had as much of a processor: this machine may be busy
PEAK_BYTES = 2**30
_LOOK_SECONDS = 0.02  # between two looks at the memory
_LOOKS_ASLEEP = 100  # after which it waits for what never comes
_AFTER_CTRL_C = 2.0  # seconds within which Ctrl-C must end it
_PR_SET_CHILD_SUBREAPER = 36
_PAGE, _TICKS = os.sysconf("SC_PAGESIZE"), os.sysconf("SC_CLK_TCK")


class SilentError(Exception):
    """What was read is wrong, and nothing was said."""


class EscapeError(Exception):
    """What a terminal would obey was said."""


@dataclass(frozen=True)
class Ended:
    """How an attempt ended.

    Attributes:
        how: "right", "refused", or the failure: CRASH, HANG, SILENT, TRACEBACK, ESCAPE or PEAK.
        words: what it said of it.
        seconds: until then.
        peak_bytes: the memory of the process and all that it started, at the most.
    """

    how: str
    words: str
    seconds: float
    peak_bytes: int


def adopt_orphans():
    """Have processes whose parents died become children of this one, so that none is lost."""
    ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def run_apart(action, said, seconds=SECONDS, peak_bytes=PEAK_BYTES):
    """Run an action in a fork of this process.

    Args:
        action: returns "right" or "refused", or raises.
        said: a file for what it writes to stdout and stderr.
        seconds: after which it hangs.
        peak_bytes: of memory, above which it takes too much.
    """
    answers, answer = os.pipe()
    start = time.monotonic()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about threads, of which the fork uses none
        pid = os.fork()
    if pid == 0:
        os.close(answers)
        _be_the_attempt(action, said, answer)
    os.close(answer)
    watched = _Watched(pid, start, seconds, peak_bytes)
    how, words = watched.until_it_ends()
    _, status, usage = os.wait4(pid, 0)
    took = time.monotonic() - start
    outlived = _end_children(seconds)  # they hold the pipe's other end
    peak = max(watched.peak_bytes, usage.ru_maxrss * 1024)
    with os.fdopen(answers, "rb") as pipe:
        answered = _answer_of(pipe) if how is None else None
    if how is None:
        how, words = answered or ("CRASH", _end_in_words(status))
    if peak > peak_bytes and how in ("right", "refused", "TRACEBACK"):
        how, words = "PEAK", f"{peak >> 20} MiB; {words}"
    if outlived and how in ("right", "refused"):
        how, words = "HANG", f"it ended, but {outlived} processes that it started did not"
    return Ended(how, words, took, peak)


# In the fork


def _be_the_attempt(action, said, answer):
    """Run the action, write how it ended into the pipe, and end; never returns."""
    how, words = "TRACEBACK", ""
    try:
        os.setsid()
        signal.signal(signal.SIGINT, signal.default_int_handler)
        descriptor = os.open(said, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        os.dup2(descriptor, 1)
        os.dup2(descriptor, 2)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        warnings.simplefilter("error")
        how, words = _outcome_of(action)
        with contextlib.suppress(Exception):
            sys.stdout.flush()
            sys.stderr.flush()
    except BaseException:  # noqa: BLE001 - a fork ends here, whatever happens
        words = traceback.format_exc()
    data = json.dumps([how, words[-4000:]]).encode()
    os.write(answer, data[:60_000])
    os._exit(0)


def _outcome_of(action):
    from symsol_annot.errors import SymsolError

    try:
        return action(), ""
    except SymsolError as error:
        words = str(error)
        unprintable = [line for line in words.split("\n") if not line.isprintable()]
        return ("ESCAPE", repr(unprintable[0])) if unprintable else ("refused", words)
    except SilentError as error:
        return "SILENT", str(error)
    except EscapeError as error:
        return "ESCAPE", str(error)
    except BaseException:  # noqa: BLE001 - what must not be
        return "TRACEBACK", traceback.format_exc()


# Beside it


class _Watched:
    def __init__(self, pid, start, seconds, most_bytes):
        self._pid, self._start, self._seconds, self._most_bytes = pid, start, seconds, most_bytes
        self.peak_bytes = 0
        self._asleep = 0  # looks, one after the other, at which nothing of it asked for a processor

    def until_it_ends(self):
        """Wait; return (None, ""), or the failure for which it was ended."""
        descriptor = os.pidfd_open(self._pid)
        try:
            while not select.select([descriptor], [], [], _LOOK_SECONDS)[0]:
                family = [self._pid, *descendants(self._pid)]
                self.peak_bytes = max(self.peak_bytes, sum(map(_resident_bytes, family)))
                if self.peak_bytes > self._most_bytes:
                    _kill(family)
                    return "PEAK", f"{self.peak_bytes >> 20} MiB and more"
                if self._hangs(family):
                    return "HANG", self._end(descriptor)
        finally:
            os.close(descriptor)
        return None, ""

    def _hangs(self, family):
        seconds = time.monotonic() - self._start
        self._asleep = self._asleep + 1 if all(map(_is_asleep, family)) else 0
        if seconds < self._seconds:
            return False
        if self._asleep > _LOOKS_ASLEEP:
            return True
        return seconds > max(WAITING_SECONDS, self._seconds) or sum(map(_cpu_seconds, family)) > self._seconds

    def _end(self, descriptor):
        seconds, family = time.monotonic() - self._start, descendants(self._pid)
        os.kill(self._pid, signal.SIGINT)
        obeys = bool(select.select([descriptor], [], [], _AFTER_CTRL_C)[0])
        _kill([self._pid, *family, *descendants(self._pid)])
        return f"still running after {seconds:.0f} s; Ctrl-C " + ("ends it" if obeys else "is ignored")


def descendants(pid):
    """Return the processes that a process started, and those that they did."""
    found = []
    with contextlib.suppress(OSError):
        for task in Path(f"/proc/{pid}/task").iterdir():
            with contextlib.suppress(OSError):
                found += [int(child) for child in (task / "children").read_text().split()]
    return found + [below for child in found for below in descendants(child)]


def _resident_bytes(pid):
    with contextlib.suppress(OSError, IndexError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE
    return 0


def _cpu_seconds(pid):
    with contextlib.suppress(OSError, IndexError):
        after_name = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        return (int(after_name[11]) + int(after_name[12])) / _TICKS
    return 0.0


def _is_asleep(pid):
    with contextlib.suppress(OSError, IndexError):
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] == "S"
    return True


def _kill(pids):
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)


def _end_children(seconds):
    """Reap what an attempt left, each within so many seconds; return how many had to be killed for it."""
    deadline, killed = time.monotonic() + seconds, 0
    while True:
        try:
            if os.waitpid(-1, os.WNOHANG)[0]:
                continue
        except ChildProcessError:
            return killed
        if time.monotonic() > deadline:
            left = descendants(os.getpid())
            killed += len(left)
            _kill(left)
            deadline = time.monotonic() + seconds
        time.sleep(0.01)


def _answer_of(pipe):
    with contextlib.suppress(ValueError):
        how, words = json.loads(pipe.read())
        return how, words
    return None


def _end_in_words(status):
    code = os.waitstatus_to_exitcode(status)
    return signal.Signals(-code).name if code < 0 else f"ended by itself with {code}"
