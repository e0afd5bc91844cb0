"""The commands, run in this process: the same code as in a terminal, without the second that starting Python takes."""

import sys
from pathlib import Path

from attack.apart import EscapeError

_CODES = (0, 1, 2)


class TracebackSaidError(Exception):
    """A command printed a traceback, or ended with a code that it has not."""


def run_command(*arguments):
    """Run `symsol-annot` with arguments; return its exit code. stdout and stderr are a file that only it writes to.

    Raises:
        TracebackSaidError: it printed a traceback.
        EscapeError: it printed what a terminal would obey.
    """
    from symsol_annot_cli.main import main

    sys.argv = ["symsol-annot", *map(str, arguments)]
    code = 0
    try:
        main()
    except SystemExit as ended:
        code = ended.code
    sys.stdout.flush()
    sys.stderr.flush()
    said = Path("/proc/self/fd/1").readlink().read_text(errors="surrogateescape")
    if "Traceback (most recent call last)" in said or code not in _CODES:
        raise TracebackSaidError(f"exit code {code}: {said[-3000:]}")
    strange = [line for line in said.split("\n") if not line.replace("\t", " ").replace("\r", " ").isprintable()]
    if strange:
        raise EscapeError(f"{' '.join(map(str, arguments[:2]))}: {strange[0]!r}")
    return code


def outcome_of_command(*arguments):
    """Run a command; return "right" where it ends with 0, else "refused"."""
    return "right" if run_command(*arguments) == 0 else "refused"
