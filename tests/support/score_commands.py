"""The commands that score, in processes of their own."""

import sys

from bench_sets import run

CALL_MAIN = "from symsol_annot_cli.main import main; main()"
COMMAND = (sys.executable, "-c", CALL_MAIN)
IMAGES = {"tetX": 24, "cylO": 4}


def symsol(*arguments, **options):
    return run(*COMMAND, *arguments, **options)
