"""Sets put into a bundle, in order: verified, linked, mirrored as Parquet, packed, described."""

from collections.abc import Callable
from pathlib import Path

from symsol_annot.annotation.volume import Volume
from symsol_annot.archives.archive import archive_blocks
from symsol_annot.archives.digest_files import to_digest_line
from symsol_annot.errors import DataError, bulleted
from symsol_annot.publish.about import About
from symsol_annot.publish.bundle import Bundle, open_bundle
from symsol_annot.publish.card import CARD_NAMES, card
from symsol_annot.publish.citation import CITATION_NAME, bibtex, citation_cff
from symsol_annot.publish.croissant import CROISSANT_NAME, GROUPS_NAME, croissant_json
from symsol_annot.publish.figures import measure
from symsol_annot.publish.parquet import groups_to_parquet, is_made_from, samples_to_parquet
from symsol_annot.publish.sets import PublishedSet
from symsol_annot.publish.webdataset import GROUP_FILE, VOLUMES_FILE, group_to_npy, samples_to_tar, volumes_to_npy
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import MANIFEST_NAME
from symsol_annot.sets.verify import verify
from symsol_annot.system.locks import held_folder
from symsol_annot.system.reading import file_sha256

_DESCRIPTION = (
    "Images of symmetric objects, rendered in Blender, each with the set of all rotations that could have produced it, "
    "the object's own occlusion of what breaks its symmetry counted in."
)


def publish(
    sets: tuple[PublishedSet, ...],
    out: Path,
    about: About,
    on_shard: Callable[[], object] = lambda: None,
    *,
    as_webdataset: bool = False,
) -> None:
    """Make a bundle of sets in a folder; the same call again resumes it, and keeps what is good.

    The same sets and the same `about` give the same bytes, on the same pyarrow and zlib-ng.

    Args:
        sets: as `sets_in` returned them.
        out: an empty or missing folder, or one that holds this bundle.
        about: what the publisher says.
        on_shard: called twice per shard: when it is verified, and when it is in the bundle.
        as_webdataset: whether the bundle has the sets as WebDataset as well.

    Raises:
        DataError: a set has faults; the message lists all of them.
        OutputError: the folder holds something else, or cannot be written to.
    """
    with held_folder(out):
        bundle = open_bundle(out, _expected(sets, as_webdataset=as_webdataset))
        _refuse_faults(sets, on_shard)
        for published in sets:
            _put_set(bundle, published, on_shard)
            _put_archive(bundle, published)
            if as_webdataset:
                _put_webdataset(bundle, published)
        groups = {published.name: _group_of(published) for published in sets}
        parts = {published.name: published.manifest.settings.parts for published in sets}
        volumes = {published.name: _volumes_of(published) for published in sets}
        bundle.put(GROUPS_NAME, groups_to_parquet(groups, parts, volumes))
        bundle.put(CITATION_NAME, citation_cff(about).encode())
        bundle.put(CROISSANT_NAME, croissant_json(about, _DESCRIPTION, bibtex(about), sets, bundle))
        figures = {(one.name, split): measure(one, split, bundle) for one in sets for split in one.splits}
        for name in CARD_NAMES:
            bundle.put(name, card(about, sets, figures).encode())
        bundle.finish()


def _expected(sets: tuple[PublishedSet, ...], *, as_webdataset: bool) -> dict[str, str | None]:
    """Return name to SHA-256 of each file of the bundle; None where it is still to be seen."""
    expected: dict[str, str | None] = dict.fromkeys((*CARD_NAMES, CITATION_NAME, CROISSANT_NAME, GROUPS_NAME))
    for published in sets:
        expected |= dict.fromkeys((published.archive_name, published.digest_name))
        expected[published.manifest_name] = file_sha256(published.folder / MANIFEST_NAME)
        for entry in published.manifest.shards:
            expected[published.shard_name(entry)] = entry.sha256
            expected[published.parquet_name(entry)] = None
        if as_webdataset:
            beside = (GROUP_FILE, VOLUMES_FILE) if published.fills_volumes else (GROUP_FILE,)
            files = (*beside, *(entry.file for entry in published.manifest.shards))
            expected |= dict.fromkeys(map(published.webdataset_name, files))
    return expected


def _refuse_faults(sets: tuple[PublishedSet, ...], on_shard: Callable[[], object]) -> None:
    faults = [f"{one.folder}: {fault}" for one in sets for fault in verify(one.folder, on_shard)]
    if faults:
        raise DataError(
            "nothing was published, for the data have faults (`symsol-annot verify --repair` makes shards again):\n"
            + bulleted(faults)
        )


def _put_set(bundle: Bundle, published: PublishedSet, on_shard: Callable[[], object]) -> None:
    manifest, volumes = published.manifest, _volumes_of(published)
    bundle.put(published.manifest_name, (published.folder / MANIFEST_NAME).read_bytes())
    for split in published.splits:
        with load(published.folder, split) as dataset:
            for entry in manifest.of_split(split):
                bundle.link(published.shard_name(entry), published.folder / entry.file, str(entry.sha256))
                name, source = published.parquet_name(entry), {"shard": entry.file, "shard_sha256": str(entry.sha256)}
                if bundle.sha256(name) is None or not is_made_from(bundle.folder / name, source):
                    samples = dataset[entry.first_index : entry.first_index + entry.images]
                    bundle.put(name, samples_to_parquet(samples, source, volumes))
                on_shard()


def _put_archive(bundle: Bundle, published: PublishedSet) -> None:
    sha256 = bundle.stream(published.archive_name, lambda: archive_blocks(published.folder, published.name))
    bundle.put(published.digest_name, to_digest_line(sha256, Path(published.archive_name).name))


def _put_webdataset(bundle: Bundle, published: PublishedSet) -> None:
    bundle.put(published.webdataset_name(GROUP_FILE), group_to_npy(_group_of(published)))
    volumes = _volumes_of(published)
    if volumes is not None:
        bundle.put(published.webdataset_name(VOLUMES_FILE), volumes_to_npy(volumes))
    for split in published.splits:
        with load(published.folder, split) as dataset:
            for entry in published.manifest.of_split(split):
                samples = dataset[entry.first_index : entry.first_index + entry.images]
                bundle.put(published.webdataset_name(entry.file), samples_to_tar(samples, volumes))


def _volumes_of(published: PublishedSet) -> tuple[Volume, ...] | None:
    """Return the volumes that sets of a set's images fill, each once; None of an object whose sets never do."""
    found: list[Volume] = []
    has_any = False
    for split in published.splits:
        with load(published.folder, split) as dataset:
            if dataset.has_volumes:
                has_any = True
                found += [volume for volume in dataset.labels().volumes if volume not in found]
    return tuple(found) if has_any else None


def _group_of(published: PublishedSet) -> Rotations:
    with load(published.folder, published.splits[0]) as dataset:
        return dataset.symmetry_group
