"""`symsol-annot fetch`: put a published set in place."""

from pathlib import Path

import click
from symsol_annot_cli.parameters import example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.archives.fetching import FetchedSet
from symsol_annot.archives.fetching import fetch as fetch_set
from symsol_annot.system.text.names import SPLITS


@click.command(
    epilog=example(
        "symsol-annot fetch bundle/archives/cylO.tar",
        "symsol-annot fetch https://example.org/bundle/archives/cylO.tar --out data",
    )
)
@click.argument("source", metavar="URL_OR_PATH")
@click.option(
    "--out",
    type=click.Path(path_type=Path, file_okay=False),
    default="data",
    show_default=True,
    help="The folder of sets; the set becomes a folder in it.",
)
@click.option(
    "--sha256",
    metavar="DIGEST",
    help="SHA-256 of the archive.  [default: what URL_OR_PATH.sha256 says, if it is there]",
)
def fetch(source: str, out: Path, sha256: str | None) -> None:
    """Put a set in place: download its archive, compare digests, and unpack it.

    URL_OR_PATH is an archive like cylO.tar that `publish` made: a path, or an address that begins with https://,
    http:// or file://. The set appears once it is whole; nothing that is there is written over. Re-running the command
    resumes a download that broke off.
    """
    with progress_bar(None, "B", scaled=True) as bar:

        def begin(total: int | None, done: int) -> None:
            bar.reset(total=total)
            bar.initial = bar.n = done

        fetched = fetch_set(source, out, sha256, begin, bar.update)
    say(_line(fetched))
    if fetched.sha256 is None:
        say(
            "No digest was given, and none lies beside the archive: the shards are those of its manifest, but whether "
            "it is the archive that was published is not known (--sha256)"
        )
    say(f"Next:\n  symsol-annot info {fetched.folder}\n  symsol-annot verify {fetched.folder}")


def _line(fetched: FetchedSet) -> str:
    counts = {split: fetched.manifest.images(split) for split in SPLITS}
    images = ", ".join(f"{count} {split}" for split, count in counts.items() if count)
    verdict = "was there already, whole" if fetched.was_there else "every shard has its SHA-256"
    return f"{fetched.folder}: {images} images; {verdict}"
