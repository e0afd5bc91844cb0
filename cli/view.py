"""`symsol-annot view`: a gallery in the browser, made on the way where it is not there yet."""

import threading
import webbrowser
from functools import partial
from pathlib import Path

import click
from symsol_annot_cli.parameters import SHOWN_PREDICTIONS, SHOWN_SPLITS, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.gallery.redrawn import Redrawer
from symsol_annot.gallery.runs import read_runs
from symsol_annot.gallery.serving import served
from symsol_annot.gallery.sources import open_sources
from symsol_annot.gallery.writing import write_gallery
from symsol_annot.system.machine import check_extra
from symsol_annot.system.scratch import Scratch, sweep, temporary_errors


@click.command(epilog=example("symsol-annot view data/cylO", "symsol-annot view gallery --port 8000"))
@click.argument("folder", metavar="DATA", type=click.Path(path_type=Path))
@SHOWN_PREDICTIONS
@SHOWN_SPLITS
@click.option(
    "--limit",
    metavar="N",
    type=click.IntRange(min=1),
    default=200,
    show_default=True,
    help="Only the first N images of a split are shown.",
)
@click.option(
    "--port", type=click.IntRange(0, 65535), default=0, help="The port on this machine.  [default: any that is free]"
)
@click.option("--no-browser", is_flag=True, help="Print the address alone, and open no browser.")
def view(
    folder: Path, paths: tuple[Path, ...], splits: tuple[str, ...], limit: int, port: int, *, no_browser: bool
) -> None:
    """Show a gallery in the browser until Ctrl-C.

    DATA is a folder that `gallery` wrote, or a set like data/cylO, or a folder of sets; of those, a gallery is made for
    the time that it is looked at.
    """
    if (folder / "index.html").is_file():
        if paths:
            raise click.UsageError("--predictions: belong to a set; a gallery that is there shows its own")
        _serve(folder, port, no_browser=no_browser)
        return
    check_extra("gallery", "the gallery")
    sources = open_sources(folder, splits, limit)
    sweep()
    with temporary_errors(), Scratch() as scratch:
        with progress_bar(None, "row") as bar:
            runs = read_runs(paths, folder, sources, bar.update)
        out = scratch.path / "gallery"
        with progress_bar(sum(len(source.dataset) for source in sources), "image") as bar:
            write_gallery(out, sources, runs, partial(Redrawer, count=0, given=None), bar.update)
        _serve(out, port, no_browser=no_browser)


def _serve(folder: Path, port: int, *, no_browser: bool) -> None:
    """Serve until Ctrl-C, which is the good end."""
    try:
        with served(folder, port) as address:
            say(f"{address} shows it; Ctrl-C ends this")
            if not no_browser:
                webbrowser.open(address)
            threading.Event().wait()
    except KeyboardInterrupt:
        say()
