"""Programs that are forked from a process which has imported what they need: the same as starting Python, but sooner.

A server is a process without threads of its own. It imports the modules that it is told, then forks a process for each
program, which gets its words, environment, folder and files for what it prints, runs to its end, and is waited for.
"""

import atexit
import contextlib
import importlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from pathlib import Path

SUPPORT = Path(__file__).parent
TOOLS = SUPPORT.parents[1] / "tools"


class Server:
    """Runs functions `module:name` as programs.

    Args:
        modules: that it imports before the first.
        forks_readers: whether the programs fork the processes that they read files with, too.
        start: the words of a program that starts the server, with fewer privileges.
    """

    def __init__(self, *modules, forks_readers=False, start=()):
        self._words = [*start, sys.executable, "-P", __file__, json.dumps(modules), json.dumps(forks_readers)]
        self._process, self._lock = None, threading.Lock()

    def run(self, program, *arguments, env=None, cwd=None, path=()):
        """Run a program to its end, as `subprocess.run` does.

        Args:
            program: `module:name` of a function without arguments.
            arguments: what follows the program's name in sys.argv.
            env: its whole environment; None for that of this process.
            cwd: its folder; None for that of this process.
            path: folders that it imports from before all others.
        """
        arguments = [os.fsdecode(word) if isinstance(word, bytes) else str(word) for word in arguments]
        with tempfile.TemporaryDirectory() as folder, self._lock:
            printed = [Path(folder) / name for name in ("stdout", "stderr")]
            request = {
                "program": program,
                "arguments": arguments,
                "env": dict(os.environ if env is None else env),
                "cwd": str(cwd or Path.cwd()),
                "path": [str(one) for one in path],
                "printed": [str(one) for one in printed],
            }
            code = self._ask(request)
            return subprocess.CompletedProcess(arguments, code, *(one.read_text(encoding="utf-8") for one in printed))

    def _ask(self, request):
        if self._process is None:
            path = [str(SUPPORT), str(TOOLS), os.environ.get("PYTHONPATH", "")]
            self._process = subprocess.Popen(
                self._words,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                env={**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, path))},
                text=True,
            )
            atexit.register(self.close)
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return int(self._process.stdout.readline())

    def close(self):
        """End the server, which has no program running."""
        if self._process is not None:
            with self._process:
                self._process.stdin.close()
            self._process = None


def serve(modules, forks_readers):
    """Run the programs that standard input asks for, one after the other; answer with the code of each."""
    for name in modules:
        importlib.import_module(name)
    requests, answers = sys.stdin, sys.stdout
    with contextlib.ExitStack() as stack:
        if forks_readers:
            stack.enter_context(importlib.import_module("forked_readers").forked_children())
        for line in requests:
            pid = os.fork()
            if pid == 0:
                _run(json.loads(line))
            answers.write(f"{os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])}\n")
            answers.flush()


def _run(request):
    """Become a program, and end as Python ends."""
    try:
        _become(request)
        module, name = request["program"].split(":")
        code = _code_of(getattr(importlib.import_module(module), name))
        threading._shutdown()
        atexit._run_exitfuncs()
        for stream in (sys.stdout, sys.stderr):
            stream.flush()
    except BaseException:  # noqa: BLE001 - a fork ends here, whatever happens
        traceback.print_exc()
        sys.stderr.flush()
        code = 120
    if code == -signal.SIGINT:
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    os._exit(code)


def _become(request):
    os.environ.clear()
    os.environ.update(request["env"])
    os.chdir(request["cwd"])
    out, err = request["printed"]
    for number, file, flags in ((0, os.devnull, os.O_RDONLY), (1, out, os.O_WRONLY), (2, err, os.O_WRONLY)):
        os.dup2(os.open(file, flags | os.O_CREAT), number)
    os.closerange(3, 64)
    sys.stdin = os.fdopen(0)
    sys.stdout = os.fdopen(1, "w", encoding="utf-8")
    sys.stderr = os.fdopen(2, "w", encoding="utf-8", errors="backslashreplace", buffering=1)
    sys.__stdin__, sys.__stdout__, sys.__stderr__ = sys.stdin, sys.stdout, sys.stderr
    sys.argv, tempfile.tempdir = ["-c", *request["arguments"]], None
    sys.pycache_prefix = os.environ.get("PYTHONPYCACHEPREFIX")
    sys.dont_write_bytecode = bool(os.environ.get("PYTHONDONTWRITEBYTECODE"))
    sys.path[:0] = request["path"]
    signal.signal(signal.SIGINT, signal.default_int_handler)


def _code_of(function):
    """Call a function; return what Python would exit with after `sys.exit(function())`."""
    try:
        sys.exit(function())
    except SystemExit as ended:
        if ended.code is None or isinstance(ended.code, int):
            return ended.code or 0
        print(ended.code, file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return -signal.SIGINT
    except BaseException:  # noqa: BLE001 - as the interpreter does
        traceback.print_exc()
        return 1
    return 0


if __name__ == "__main__":
    serve(*map(json.loads, sys.argv[1:]))
