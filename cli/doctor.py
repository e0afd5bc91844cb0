"""`symsol-annot doctor`: say what this machine lacks for rendering."""

import sys
from pathlib import Path

import click
from symsol_annot_cli.parameters import example
from symsol_annot_cli.terminal import say

from symsol_annot.rendering import doctor as examination


@click.command(epilog=example("symsol-annot doctor --install"))
@click.option(
    "--install", is_flag=True, help="First install missing system libraries (on Debian and its derivatives, as root)."
)
@click.option(
    "--out",
    type=click.Path(path_type=Path),
    default=Path("data"),
    show_default=True,
    help="Folder whose disk space is checked.",
)
def doctor(*, install: bool, out: Path) -> None:
    """Check what rendering needs, and print the one line that installs what this machine lacks."""
    if install:
        examination.install_missing_packages()
    is_well = True
    for finding in examination.examine(out):
        verdict = "FAIL" if not finding.is_good else "warn" if finding.remedy else "ok  "
        say(f"{verdict}  {finding.what}: {finding.found}")
        if finding.remedy:
            say("      " + finding.remedy.replace("\n", "\n      "))
        is_well = is_well and finding.is_good
    say("Ready to render." if is_well else "Loading and verifying work regardless; rendering does not.")
    sys.exit(0 if is_well else 1)
