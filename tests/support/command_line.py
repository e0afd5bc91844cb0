"""The command as its users start it: processes, how they end, and the small sets that they make."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from forked_programs import Server

CALL_MAIN = "from symsol_annot_cli.main import main; main()"
COMMAND = (sys.executable, "-c", CALL_MAIN)
INTERRUPTIBLE = (  # also from a background job, which is born deaf to it
    sys.executable,
    "-c",
    f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {CALL_MAIN}",
)
WITHOUT_BPY = (sys.executable, "-c", f"import sys; sys.modules['bpy'] = None; {CALL_MAIN}")
WITHOUT_EGL = {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}
PROJECT = Path(__file__).parents[2]
SHARDS = 4
REAL_SET = ("--object", "tetX", "--train", "0", "--test", str(16 * SHARDS), "--size", "24", "--workers", "2")
LONGER_SET = (*REAL_SET, "--test", "480", "--size", "96")  # takes long enough to be interrupted; the last option counts
TINY_SET = ("--object", "tetX", "--train", "0", "--test", "2", "--size", "16", "--workers", "1")
NUMPY_SET = (
    "--object",
    "tetX",
    "--annotate",
    "test",
    "--train",
    "5",
    "--test",
    "40",
    "--size",
    "32",
)  # what the fixture tetX_set was made as

AS_WHO_OBEYS_MODES = ("setpriv", "--bounding-set=-dac_override,-dac_read_search") if os.geteuid() == 0 else ()
obeying_modes = pytest.mark.skipif(
    bool(AS_WHO_OBEYS_MODES) and not shutil.which("setpriv"), reason="root ignores modes, and setpriv is not here"
)


def run(*command, env=None, cwd=None):
    """Run a program to its end; whatever happened, it was no traceback."""
    done = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        env={**os.environ, **(env or {})},
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    assert "Traceback" not in done.stderr + done.stdout, done.stderr
    return done


_MODULES = [
    f"symsol_annot_cli.{name}"
    for name in ("info", "objects", "publish", "render", "score", "seal", "validate", "verify")
]
_PROGRAMS = Server(*_MODULES, forks_readers=True)
_OBEYING = Server(*_MODULES, forks_readers=True, start=AS_WHO_OBEYS_MODES)


def symsol(*arguments, env=None, cwd=None, obeys_modes=False):
    """Run the command to its end: in a fork, but afresh where variables may change how Python starts.

    Args:
        obeys_modes: whether it is refused what modes of files forbid, which root is not.
    """
    if env:
        return run(*COMMAND, *arguments, env=env, cwd=cwd)
    done = (_OBEYING if obeys_modes else _PROGRAMS).run("symsol_annot_cli.main:main", *arguments, cwd=cwd)
    assert "Traceback" not in done.stderr + done.stdout, done.stderr
    return done


def contents(folder):
    """The files of a folder, with their bytes and when they were written."""
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


def edit(path, old, new):
    """Replace what occurs once in a file; return the number of the line where it stands."""
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    return text[: text.index(old)].count("\n") + 1
