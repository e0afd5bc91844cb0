"""The command's entry point: gathers the commands and turns errors into messages and exit codes.

Exit codes: 0 done, 1 the input or the data is wrong, 2 the command line is, 130 interrupted.
"""

import io
import signal
import sys

import click
from symsol_annot_cli.compare import compare
from symsol_annot_cli.completion import completion
from symsol_annot_cli.doctor import doctor
from symsol_annot_cli.gallery import gallery
from symsol_annot_cli.import_symsol import import_symsol
from symsol_annot_cli.info import info
from symsol_annot_cli.leaderboard import leaderboard
from symsol_annot_cli.objects import objects
from symsol_annot_cli.parameters import example
from symsol_annot_cli.plot import plot
from symsol_annot_cli.predict import predict
from symsol_annot_cli.publish import publish
from symsol_annot_cli.queries import queries
from symsol_annot_cli.reference import reference
from symsol_annot_cli.render import render
from symsol_annot_cli.score import score
from symsol_annot_cli.train import train
from symsol_annot_cli.validate import validate
from symsol_annot_cli.verify import verify

from symsol_annot import SymsolError, __version__

_INTERRUPTED = 130
_EXAMPLE = example(
    "symsol-annot render --object cylO --train 0 --test 64",
    "symsol-annot verify data/cylO",
    "symsol-annot score preds.h5",
)


@click.group(context_settings={"help_option_names": ["-h", "--help"]}, epilog=_EXAMPLE)
@click.version_option(__version__, prog_name="symsol-annot")
def app() -> None:
    """Images of symmetric objects, each with the set of all rotations that could have produced it."""


_DATA_COMMANDS = (render, objects, doctor, info, verify, plot, gallery, import_symsol, publish)
_BENCHMARK_COMMANDS = (train, predict, queries, validate, score, compare, leaderboard, reference)
for command in (*_DATA_COMMANDS, *_BENCHMARK_COMMANDS, completion):
    app.add_command(command)


def main() -> None:
    """Run the command line and exit."""
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal without arrows gets question marks, not a traceback
    signal.signal(signal.SIGTERM, signal.default_int_handler)  # as Ctrl-C: what is half done goes
    try:
        code = app.main(standalone_mode=False)
    except click.ClickException as error:
        error.show()
        code = error.exit_code
    except SymsolError as error:
        click.echo(f"Error: {error}", err=True)
        code = 1
    except (click.Abort, KeyboardInterrupt):
        click.echo("Interrupted.", err=True)
        code = _INTERRUPTED
    sys.exit(code or 0)
