"""Real processes for the soak: a command, a private Dask cluster, and who of them is still alive.

Whatever is started at a `Site` carries its mark in its environment, as does all that it starts in turn, so that
none is overlooked. TMPDIR and HOME are folders of the site that hold nothing in the end; Dask's files lie elsewhere.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import uuid
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from distributed import Client

from symsol_annot.system import scratch

GRACE_S = 2.0  # in which what was started must have ended
END_S = 180.0  # in which every command must have ended
_MARK, _ROLE = "SYMSOL_SOAK_MARK", "SYMSOL_SOAK_ROLE"


@dataclass(frozen=True)
class Ended:
    """How a command ended: its exit code, negative for a signal, what it said, and after how many seconds."""

    code: int
    out: str
    err: str
    seconds: float

    @property
    def is_hung(self):
        return self.seconds >= END_S


@dataclass(frozen=True)
class Alive:
    """A process of a site: its number, the role of the command that it comes from, and its command line."""

    pid: int
    role: str
    line: str

    @property
    def is_blender(self):
        return "symsol_annot.generation.process" in self.line


class Running:
    """A command that was started at a site."""

    def __init__(self, process, folder):
        self._process, self._folder, self._start = process, folder, time.monotonic()

    @property
    def pid(self):
        return self._process.pid

    @property
    def is_running(self):
        return self._process.poll() is None

    @property
    def seconds(self):
        return time.monotonic() - self._start

    def said(self, stream="err"):
        return (self._folder / stream).read_text(errors="replace")

    def end(self):
        """Wait until it has ended, but not for ever."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(END_S - self.seconds)
        seconds = self.seconds
        self._process.kill()
        return Ended(self._process.wait(), self.said("out"), self.said("err"), seconds)


class Site:
    """A folder to work in, and all processes that were started there; on leaving, none is left.

    Attributes:
        out: for sets.
        temporary, home: TMPDIR and HOME of all that runs here.
        dask: for what Dask keeps.
    """

    def __init__(self):
        self._mark, self._started = uuid.uuid4().hex, 0

    def __enter__(self):
        self.folder = Path(tempfile.mkdtemp(prefix="soak-"))
        self.out, self.temporary, self.home, self.dask, self._logs = (
            self.folder / name for name in ("out", "tmp", "home", "dask", "logs")
        )
        for folder in (self.out, self.temporary, self.home, self.dask, self._logs):
            folder.mkdir()
        return self

    def __exit__(self, *_):
        for process in self.alive():
            with suppress(ProcessLookupError):
                os.kill(process.pid, signal.SIGKILL)
        shutil.rmtree(self.folder)

    def start(self, role, *words, **variables):
        """Start a program in a session of its own."""
        self._started += 1
        logs = self._logs / f"{self._started}"
        logs.mkdir()
        with (logs / "out").open("wb") as out, (logs / "err").open("wb") as err:
            process = subprocess.Popen(
                [str(word) for word in words],
                env=self._environment(role, variables),
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=self.folder,
                start_new_session=True,
            )
        return Running(process, logs)

    def render(self, words, *options, before=(), python=sys.executable, out=None, **variables):
        """Start `symsol-annot render` with the words that say which set, and options."""
        code = "from symsol_annot_cli.main import main; main()"
        command = [python, "-P", "-c", code, "render", *words.split(), "--out", out or self.out, *options]
        return self.start("command", *before, *command, **variables)

    def alive(self, *roles):
        """Return all processes of this site that have not ended, or those of some roles."""
        found = []
        for folder in Path("/proc").glob("[0-9]*"):
            with suppress(OSError):
                variables = (folder / "environ").read_bytes()  # empty once a process has ended
                if f"{_MARK}={self._mark}".encode() in variables.split(b"\0"):
                    line = (folder / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
                    found.append(Alive(int(folder.name), _role_in(variables), line.strip()))
        return [process for process in found if not roles or process.role in roles]

    def blenders(self, *roles):
        """Return the Blender processes."""
        return [process for process in self.alive(*roles) if process.is_blender]

    def faults(self):
        """Say which process or temporary file is left, after a short grace; no Dask cluster of the site may run.

        What a Blender that was killed in its first second has left, the next command removes; so it is removed first.
        """
        left = self.outlasting(self.alive)
        for folder in self.temporary.glob(f"{scratch.PREFIX}*"):
            scratch._remove_if_abandoned(folder)
        faults = [f"a process is left: {process.role} {process.line[:100]}" for process in left]
        for folder in (self.temporary, self.home):
            faults += [f"a file is left: {path.relative_to(self.folder)}" for path in folder.rglob("*")]
        return faults

    def outlasting(self, who):
        """Return the processes that a function still finds after the grace."""
        end = time.monotonic() + GRACE_S
        while (left := who()) and time.monotonic() < end:
            time.sleep(0.05)
        return left

    def _environment(self, role, variables):
        ours = {_MARK: self._mark, _ROLE: role, "TMPDIR": str(self.temporary), "HOME": str(self.home)}
        kept = {key: value for key, value in os.environ.items() if not key.startswith(("DASK_", "XDG_"))}
        return {**kept, **ours, **variables}


class Cluster:
    """`dask scheduler`, and `dask worker`s of one thread, each with its nanny, over TCP on loopback."""

    def __init__(self, site):
        self._site, self._running = site, {}

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.stop()

    def start(self, workers=2, **variables):
        """Start a scheduler, which gets the variables, and workers; wait until they know each other."""
        self.start_scheduler(**variables)
        for number in range(workers):
            self.start_worker(number)
        self.wait_for_workers(workers)
        return self

    def start_scheduler(self, **variables):
        file = self._site.dask / f"scheduler-{uuid.uuid4().hex[:8]}.json"
        words = ("--host", "127.0.0.1", "--port", "0", "--scheduler-file", file)
        self._start("scheduler", "scheduler", *words, **variables)
        self.address = wait_for(lambda: file.exists() and json.loads(file.read_text() or "{}").get("address"))

    def start_worker(self, number, python=sys.executable):
        words = (self.address, "--nthreads", "1", "--host", "127.0.0.1", "--local-directory", self._site.dask)
        self._start(f"worker-{number}", "worker", *words, python=python)

    def wait_for_workers(self, count):
        with Client(self.address, set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)
            return sorted(client.nthreads())

    def workers_and_nannies(self):
        """Return the process that works and the nanny that watches over it, for each worker that has started."""
        pairs = {}
        for process in self._site.alive():
            place = {"spawn_main": 0, "dask worker": 1}
            found = [place[words] for words in place if words in process.line]
            if process.role.startswith("worker") and found:
                pairs.setdefault(process.role, {})[found[0]] = process
        return [[pair[0], pair[1]] for _, pair in sorted(pairs.items()) if len(pair) == 2]

    def stop(self):
        """End all as Ctrl-C does, the scheduler last; what outlasts that is for `Site.faults` to find."""
        for role in reversed(self._running):
            self._stop(role)
        self._running = {}

    def stop_worker(self, number):
        """End one worker."""
        self._stop(f"worker-{number}")
        del self._running[f"worker-{number}"]

    def _stop(self, role):
        if self._running[role].is_running:
            os.kill(self._running[role].pid, signal.SIGINT)
        self._running[role].end()

    def _start(self, role, *words, python=sys.executable, **variables):
        command = (python, "-P", "-m", "dask", *words, "--no-dashboard")
        variables["DASK_TEMPORARY_DIRECTORY"] = str(self._site.dask)
        self._running[role] = self._site.start(role, *command, **variables)


def wait_for(condition, seconds=60.0):
    """Return what a condition returns once it is true; None if it stays false for too long."""
    end = time.monotonic() + seconds
    while not (value := condition()):
        if time.monotonic() > end:
            return None
        time.sleep(0.01)
    return value


def kill(processes, number=signal.SIGKILL):
    """Send all processes a signal."""
    for process in processes:
        with suppress(ProcessLookupError):
            os.kill(process.pid, number)


def contents(folder):
    """Return the bytes of all files in a folder, by name."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def differences(folder, undisturbed):
    """Say in what a folder differs from what `contents` said of another: a line each."""
    found = contents(folder)
    faults = [f"{name}: is missing" for name in sorted(set(undisturbed) - set(found))]
    faults += [f"{name}: is a stray file" for name in sorted(set(found) - set(undisturbed))]
    both = sorted(set(found) & set(undisturbed))
    return faults + [f"{name}: has other bytes" for name in both if found[name] != undisturbed[name]]


def finished(folder):
    """Return what would change if a finished shard were written again: its inode and time, by name."""
    try:
        splits = json.loads((folder / "manifest.json").read_text())["splits"].values()
    except FileNotFoundError:
        return {}
    names = [shard["file"] for split in splits for shard in split["shards"] if shard["sha256"]]
    paths = [folder / name for name in names if (folder / name).exists()]
    return {path.name: (path.stat().st_ino, path.stat().st_mtime_ns) for path in paths}


def _role_in(variables):
    role = f"{_ROLE}=".encode()
    return next((entry[len(role) :].decode() for entry in variables.split(b"\0") if entry.startswith(role)), "")
