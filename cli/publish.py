"""`symsol-annot publish`: make what a host of data sets needs."""

from pathlib import Path
from typing import Any

import click
from symsol_annot_cli.parameters import SET_FOLDER, example, progress_bar
from symsol_annot_cli.terminal import say

from symsol_annot.system.machine import check_extra


@click.command(epilog=example("symsol-annot publish data --out bundle"))
@SET_FOLDER
@click.option("--out", type=click.Path(path_type=Path, file_okay=False), required=True, help="The bundle's folder.")
@click.option("--title", help="Title of the data.")
@click.option("--author", "authors", multiple=True, help="A person or a group; may be given several times.")
@click.option("--version", help="Version of the data, like 1.0.0.")
@click.option("--date", help="Date of publication, like 2026-01-31.")
@click.option("--url", help="Address where the data will be.")
@click.option(
    "--webdataset", "as_webdataset", is_flag=True, help="Write each shard as a WebDataset's tar file as well."
)
def publish(folder: Path, out: Path, authors: tuple[str, ...], *, as_webdataset: bool, **texts: str | None) -> None:
    """Make what a host needs: shards, archives, a Parquet mirror, a dataset card, Croissant metadata, a citation.

    DATA is a set like data/cylO, or a folder of sets like data. The sets are verified first. Shards are hard links
    where the file system allows. Each set is also packed into one archive, OUT/archives/NAME.tar, which `fetch`
    puts in place elsewhere. Re-running the command resumes it, even after a crash.
    """
    check_extra("publish", "publishing")
    from symsol_annot.publish import publication  # noqa: PLC0415 - needs pyarrow
    from symsol_annot.publish.about import About  # noqa: PLC0415
    from symsol_annot.publish.sets import sets_in  # noqa: PLC0415

    given: dict[str, Any] = {name: text for name, text in texts.items() if text is not None}
    if authors:
        given["authors"] = authors
    about = About(**given)
    sets = sets_in(folder)
    shards = sum(len(published.manifest.shards) for published in sets)
    with progress_bar(2 * shards, "shard") as bar:  # verified, then published
        publication.publish(sets, out, about, bar.update, as_webdataset=as_webdataset)
    images = sum(entry.images for published in sets for entry in published.manifest.shards)
    say(f"{out}: {', '.join(published.name for published in sets)}: {shards} shards, {images} images")
    say(f"Next:\n  (cd {out} && sha256sum -c SHA256SUMS)\n  and read {out}/README.md, the dataset card")
    archive = out / sets[0].archive_name
    say(f"Where {archive} is to be had, this puts the set in place:\n  symsol-annot fetch {archive}")
