"""`symsol-annot info`: say what a set holds."""

import json
from pathlib import Path
from typing import Any

import click
from symsol_annot_cli.parameters import SET_FOLDER, example
from symsol_annot_cli.terminal import say

from symsol_annot.sets.manifest import Manifest, read_manifest
from symsol_annot.sets.shard.layout import NEWEST
from symsol_annot.sets.stated.settings import ImportedSettings, RenderedSettings, SealedSettings
from symsol_annot.sets.stated.values import seed_to_json
from symsol_annot.sets.statistics import SplitStatistics, sizes_in_words, split_statistics
from symsol_annot.system.text.names import SPLITS

_MOST_LINES = 40  # on sets by which parts show


@click.command(epilog=example("symsol-annot info data/cylO", "symsol-annot info data/cylO --json"))
@SET_FOLDER
@click.option("--json", "is_json", is_flag=True, help="Print it as JSON, for programs.")
def info(folder: Path, *, is_json: bool) -> None:
    """Print what a set holds: counts, sizes of the symmetry sets, and the fingerprints that predictions carry."""
    manifest = read_manifest(folder)
    if is_json:
        say(json.dumps(_document(folder, manifest), indent=1, ensure_ascii=True))
        return
    if manifest.is_imported:
        _print_source(manifest.imported)
    elif manifest.is_sealed:
        _print_seal(manifest.sealed)
    else:
        _print_drawing(manifest.rendered)
    older = "" if manifest.format_version == NEWEST else f", which is read for good; {NEWEST} is what is written today"
    say(f"format       version {manifest.format_version}{older}")
    say(f"fingerprint  {manifest.fingerprint or 'none yet: the set is not finished'}")
    say("             of the whole set, to name it by; predictions carry that of their split, below")
    for split in SPLITS:
        if manifest.images(split):
            finished = sum(entry.is_finished for entry in manifest.of_split(split))
            shards = f"{finished} of {len(manifest.of_split(split))} shards"
            say(f"\n{split}: {manifest.images(split)} images, {shards}")
            _print_statistics(split_statistics(folder, manifest, split), is_sealed=manifest.is_sealed)
            say(f"  fingerprint {manifest.split_fingerprint(split) or 'none yet: shards of the split are missing'}")


def _document(folder: Path, manifest: Manifest) -> dict[str, Any]:
    """Return what is printed, as values: what is not known is null."""
    width, height = manifest.settings.image_size
    kind = "imported" if manifest.is_imported else "sealed" if manifest.is_sealed else "rendered"
    return {
        "object": manifest.settings.object,
        "kind": kind,
        "format_version": manifest.format_version,
        "fingerprint": manifest.fingerprint,
        "image_size": [width, height],
        "parts": list(manifest.settings.parts),
        "has_depth": manifest.settings.has_depth,
        **(_drawing(manifest.rendered) if kind == "rendered" else {}),
        "splits": {split: _split_document(folder, manifest, split) for split in SPLITS if manifest.images(split)},
    }


def _drawing(settings: RenderedSettings) -> dict[str, Any]:
    return {
        "object_sha256": settings.object_sha256,
        "engine": settings.render.engine,
        "seed": seed_to_json(settings.seed),
        "camera": {"distance": settings.camera.distance, "focal_px": settings.camera.focal_px},
    }


def _split_document(folder: Path, manifest: Manifest, split: str) -> dict[str, Any]:
    statistics, shards = split_statistics(folder, manifest, split), manifest.of_split(split)
    sizes = {str(size): count for size, count in sorted(statistics.set_sizes.items())}
    measures = [{"share": share, "images": images} for share, images in sorted(statistics.measures.items())]
    return {
        "images": manifest.images(split),
        "shards": len(shards),
        "finished_shards": sum(entry.is_finished for entry in shards),
        "fingerprint": manifest.split_fingerprint(split),
        "has_symmetry_sets": statistics.is_annotated,
        "marking_shown": statistics.shown if statistics.has_marking else None,
        "parts_shown": dict(statistics.parts_shown) or None,
        "set_sizes_by_parts": _sizes_by_parts(statistics) if statistics.is_annotated else None,
        "set_sizes": sizes if statistics.is_annotated else None,
        **({"images_with_volume": measures} if measures else {}),
    }


def _sizes_by_parts(statistics: SplitStatistics) -> list[dict[str, Any]] | None:
    """Return the sizes of sets by which parts an image shows; None for an object that has no parts by name."""
    found = statistics.sizes_by_parts
    return [
        {"parts": list(names), "set_sizes": {str(size): count for size, count in sorted(sizes.items())}}
        for names, sizes in sorted(found.items())
    ] or None


def _print_drawing(settings: RenderedSettings) -> None:
    """Say how the images of a rendered set were drawn."""
    camera, seed = settings.camera, seed_to_json(settings.seed)
    say(f"object       {settings.object} ({settings.object_sha256[:16]})")
    say(f"images       {camera.width}x{camera.height}, engine {settings.render.engine}, seed {seed}")
    say(f"maps         segmentation into {', '.join(settings.parts)}; {'depth' if settings.has_depth else 'no depth'}")
    say(f"camera       distance {camera.distance:g}, focal length {camera.focal_px:.2f} px")


def _print_seal(settings: SealedSettings) -> None:
    """Say what is known of a sealed set."""
    camera = settings.camera
    say(f"object       {settings.object} ({settings.object_sha256[:16]})")
    say(f"images       {camera.width}x{camera.height}, engine {settings.render.engine}; sealed: no labels")
    say(f"commitment   {settings.commitment}")
    say(f"camera       distance {camera.distance:g}, focal length {camera.focal_px:.2f} px")


def _print_source(settings: ImportedSettings) -> None:
    """Say where an imported set is from, and that the rest is not known."""
    source = settings.source
    say(f"object       {settings.object}")
    say(f"source       {source.name}, SHA-256 {source.sha256[:16]}; convention {source.convention}")
    say(f"images       {settings.width}x{settings.height}; camera, seed, segmentation and marking unknown")


def _print_statistics(statistics: SplitStatistics, *, is_sealed: bool) -> None:
    images = statistics.images
    if not images:
        return
    if statistics.has_marking:
        shows = {name: statistics.parts_shown[name] for name in statistics.telling}
        if len(statistics.breaking) != 1:
            shows["any part that breaks the symmetry" if statistics.breaking else "marking"] = statistics.shown
        for name, count in shows.items():
            say(f"  {name} shows in {count} of {images} ({100 * count / images:.1f}%)")
    if not statistics.is_annotated:
        why = ": they are sealed" if is_sealed else ": none are known" if statistics.is_imported else ""
        say(f"  without symmetry sets{why}")
        return
    say(f"  |S|: {sizes_in_words(statistics.set_sizes, statistics.measures)}")
    by_parts = sorted(statistics.sizes_by_telling_parts.items()) if statistics.telling else []
    for names, sizes in by_parts[:_MOST_LINES]:
        say(f"    with {', '.join(names) or 'none of these parts'} in view: {sizes_in_words(sizes)}")
    if by_parts[_MOST_LINES:]:
        say(f"    and {len(by_parts) - _MOST_LINES} other choices of parts, which --json lists")
    if statistics.breaking:
        say(
            f"  of {statistics.candidates_drawn} candidates, {statistics.candidates_within_tolerance} differ by less "
            "than the tolerance"
        )
    elif statistics.has_marking:
        say(
            f"  of {statistics.candidates_drawn} candidates, {statistics.candidates_within_tolerance} show the marking "
            "by less than the tolerance"
        )
