"""The command's entry point: finds the command and turns errors into messages and exit codes.

Exit codes: 0 done, 1 the input or the data is wrong, 2 the command line is, 130 interrupted.
"""

import ast
import io
import logging
import os
import signal
import sys
import traceback
from importlib import import_module, resources

import click
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import TerminalHandler, say

from symsol_annot import SymsolError, __version__
from symsol_annot.system.text.names import nearest

_INTERRUPTED = 130
_STANDARD_ERROR = 2
_OWN = {*sys.stdlib_module_names, "click", "symsol_annot", "symsol_annot_cli"}
_EXAMPLE = example(
    "symsol-annot render --object cylO --train 0 --test 64",
    "symsol-annot verify data/cylO",
    "symsol-annot score preds.h5",
)


_GROUPS = {
    "Make or get a set": (
        "render",
        "fetch",
        "import-object",
        "import-symsol",
        "import-bop",
        "objects",
        "symmetries",
        "doctor",
    ),
    "Look at it": ("info", "verify", "plot", "gallery", "view"),
    "Score a method": (
        "convert",
        "import-bop-results",
        "validate",
        "score",
        "compare",
        "queries",
        "reference",
        "leaderboard",
    ),
    "Run a reference model": ("train", "predict", "retrieve"),
    "Publish": ("publish", "export-bop", "seal"),
    "Set up the shell": ("completion",),
}
_COMMANDS = tuple(name for names in _GROUPS.values() for name in names)


class _Commands(click.Group):
    """The commands, each in a module of its name that is imported when it is asked for: to render takes no scorer."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        """Return the names."""
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002 - click's signature
        """Return a command; None where there is none of that name."""
        if cmd_name not in _COMMANDS:
            return None
        name = cmd_name.replace("-", "_")
        command: click.Command = getattr(import_module(f"symsol_annot_cli.{name}"), name)
        return command

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Return the command that the first word names; of a mistyped one, the nearest is named."""
        if args and not args[0].startswith("-") and args[0] not in _COMMANDS:
            ctx.fail(f"No such command {args[0]!r}{nearest(args[0], _COMMANDS)}")
        return super().resolve_command(ctx, args)

    def format_commands(
        self,
        ctx: click.Context,  # noqa: ARG002 - click's signature
        formatter: click.HelpFormatter,
    ) -> None:
        """Write the commands in groups, each with the whole first sentence of its help."""
        for title, names in _GROUPS.items():
            with formatter.section(title):
                formatter.write_dl([(name, _summary(name)) for name in names], col_max=16)


def _summary(name: str) -> str:
    """Return the first paragraph of a command's help, out of its source: to import all commands takes a second."""
    function = name.replace("-", "_")
    tree = ast.parse(resources.files("symsol_annot_cli").joinpath(f"{function}.py").read_text(encoding="utf-8"))
    (found,) = (node for node in tree.body if isinstance(node, ast.FunctionDef) and node.name == function)
    return (ast.get_docstring(found) or "").partition("\n\n")[0]


@click.group(cls=_Commands, context_settings={"help_option_names": ["-h", "--help"]}, epilog=_EXAMPLE)
@click.version_option(__version__, prog_name="symsol-annot")
def app() -> None:
    """Images of symmetric objects, each with the set of all rotations that could have produced it."""


def main() -> None:
    """Run the command line and exit."""
    _open_closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without arrows gets question marks, not a traceback
    logging.basicConfig(handlers=[TerminalHandler()], format="Warning: %(message)s", level=logging.WARNING)
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: what is half done goes
    try:
        code = app.main(standalone_mode=False)
    except click.ClickException as error:
        shown = io.StringIO()
        error.show(shown)
        say(shown.getvalue().rstrip("\n"), err=True)
        code = error.exit_code
    except (SymsolError, OSError, ImportError) as error:
        say(f"Error: {_in_words(error)}", err=True)
        code = 1
    except (click.Abort, KeyboardInterrupt):
        say("Interrupted.", err=True)
        code = _INTERRUPTED
    sys.exit(code or 0)


def _open_closed_streams() -> None:
    """Give standard input, output and error, where they are closed, to nobody.

    Else the next file that is opened would get their number, and what a library prints would be written into it.
    """
    while (descriptor := os.open(os.devnull, os.O_RDWR)) <= _STANDARD_ERROR:
        os.set_inheritable(descriptor, True)
    os.close(descriptor)
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w", encoding="utf-8"))  # noqa: PTH123, SIM115 - until the end


def _in_words(error: SymsolError | OSError | ImportError) -> str:
    match error:
        case SymsolError():  # a package that is not installed is one
            return str(error)
        case OSError():
            return _os_error_in_words(error)
        case ImportError():
            return _import_error_in_words(error)


def _os_error_in_words(error: OSError) -> str:
    """Name the file, or standard output, of which the system says no name."""
    name, reason = error.filename, error.strerror or str(error)
    if name is None and _modules_of(error)[-1].startswith("click."):  # its echo
        name = "standard output"
        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # or Python's end would fail on what is still to be written
    return reason if name is None else f"{name}: {reason}"


def _import_error_in_words(error: ImportError) -> str:
    """Name the package that this program asked for, which need not be the one that was not found."""
    packages = [module.partition(".")[0] for module in (*_modules_of(error), error.name or "a package")]
    package = next((name for name in packages if name not in _OWN), "symsol-annot")
    reason = str(error).strip().partition("\n")[0]
    return f"{package} is broken: {reason}; reinstall it: `pip install --force-reinstall {package}`"


def _modules_of(error: Exception) -> list[str]:
    """Return the names of the modules that an error passed through, its own last."""
    return [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
