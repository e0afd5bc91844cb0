"""Writing an imported set: whole or not at all, and again where a shard of it was lost."""

import hashlib
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path

from symsol_annot.errors import DifferentSetError, output_errors
from symsol_annot.sets.manifest import (
    MANIFEST_NAME,
    Manifest,
    ShardEntry,
    read_manifest,
    refuse_to_add,
    write_manifest,
)
from symsol_annot.sets.shard.writer import ShardFile
from symsol_annot.system.files import check_inside, new_folder, write_atomically
from symsol_annot.system.progress import OnImages
from symsol_annot.system.reading import file_sha256


def manifest_there(folder: Path, planned: Manifest) -> Manifest | None:
    """Return the manifest of a set that a folder holds already; None where the folder is missing or empty.

    Raises:
        DifferentSetError: it holds another set than the planned one, or anything else.
        DataError: its set is of an older format, to which nothing is added.
    """
    if (folder / MANIFEST_NAME).exists():
        there = read_manifest(folder)
        refuse_to_add(folder, there)
        differences = planned.differences(there)
        if differences:
            raise DifferentSetError(str(folder), differences)
        return there
    with output_errors(folder):
        if folder.exists() and any(folder.iterdir()):
            raise DifferentSetError(str(folder), [f"it holds files, and no {MANIFEST_NAME}"])
    return None


def is_whole(folder: Path, manifest: Manifest) -> bool:
    """Tell whether a folder has all shards of its manifest, with the bytes that it says."""
    try:
        return all(file_sha256(folder / entry.file) == entry.sha256 for entry in manifest.shards)
    except OSError:
        return False


def place_of(folder: Path, manifest: Manifest, *, is_there: bool) -> AbstractContextManager[Path]:
    """Return the folder to write a set to: one that appears once it is whole, or the one that is there.

    In one that is there, shard after shard is replaced.

    Raises:
        OutputError: a file of the set is a link that leads out of the folder.
    """
    if not is_there:
        return new_folder(folder)
    check_inside(folder, [MANIFEST_NAME, *(entry.file for entry in manifest.shards)])
    return nullcontext(folder)


def write_set(
    folder: Path,
    manifest: Manifest,
    shards: Iterable[tuple[ShardEntry, Callable[[], ShardFile]]],
    workers: int,
    on_images: OnImages,
) -> Manifest:
    """Write all shards of a set and its manifest, which is returned.

    Args:
        folder: of the set.
        manifest: of the set, none of its shards finished.
        shards: each shard with what makes it; a thread calls that.
        workers: how many threads make shards.
        on_images: told how many more images are written.
    """
    under_way: deque[tuple[ShardEntry, Future[ShardFile]]] = deque()
    with ThreadPoolExecutor(workers, thread_name_prefix="import") as pool:
        try:
            for entry, make in shards:
                under_way.append((entry, pool.submit(make)))
                if len(under_way) > workers:
                    manifest = _keep(folder, manifest, *under_way.popleft(), on_images)
            while under_way:
                manifest = _keep(folder, manifest, *under_way.popleft(), on_images)
        finally:
            pool.shutdown(cancel_futures=True)
    write_manifest(folder, manifest)
    return manifest


def _keep(
    folder: Path, manifest: Manifest, entry: ShardEntry, made: "Future[ShardFile]", on_images: OnImages
) -> Manifest:
    """Write a shard; return the manifest with it."""
    file = made.result()
    write_atomically(folder / entry.file, file.data)
    on_images(entry.images)
    sha256 = hashlib.sha256(file.data).hexdigest()
    return manifest.with_finished(
        replace(entry, bytes=len(file.data), sha256=sha256, content_sha256=file.content_sha256)
    )
