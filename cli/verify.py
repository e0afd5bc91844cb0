"""`symsol-annot verify`: check a set, and draw images of it again."""

import sys
from functools import partial
from pathlib import Path

import click
import numpy as np
from symsol_annot_cli.parameters import SET_FOLDER, ObjectType, example, progress_bar
from symsol_annot_cli.reporting import failures_in_words, reporter
from symsol_annot_cli.terminal import say

from symsol_annot.errors import DataError
from symsol_annot.generation.audit import AuditReport, audit
from symsol_annot.generation.executors import local_processes
from symsol_annot.generation.generate import damaged_shards, generate
from symsol_annot.generation.origin import plan_behind
from symsol_annot.generation.outside import found_outside
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.blender_process import check_blender_installed
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.sets import dataset
from symsol_annot.sets.folders import set_folders
from symsol_annot.sets.manifest import read_manifest, refuse_to_add
from symsol_annot.sets.verify import verify as find_faults
from symsol_annot.system.machine import cores


@click.command(epilog=example("symsol-annot verify data", "symsol-annot verify data/cylO --audit 20"))
@SET_FOLDER
@click.option("--audit", "audited", metavar="N", type=click.IntRange(min=1), help="Draw N images of each set again.")
@click.option("--repair", is_flag=True, help="First make damaged, missing and unfinished shards again.")
@click.option(
    "--object", "spec", type=ObjectType(), help="The object to draw, where the set's object is a folder of your own."
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Seed of the audit's choice of images."
)
def verify(folder: Path, audited: int | None, spec: ObjectSpec | None, seed: int, *, repair: bool) -> None:
    """Check that a set is whole and consistent.

    DATA is a set like data/cylO, or a folder of sets like data. With --audit, images and candidate rotations
    are drawn again: members of a symmetry set must draw the image, rejected candidates must not. With --repair,
    shards that differ from the manifest are made again, and must then have its checksums.
    """
    faults = []
    sets = set_folders(folder) or [folder]
    for set_folder in sets:
        try:
            if repair:
                _repair_set(set_folder, spec)
            found = _verify_set(set_folder)
            if audited and not found:
                found = _audit_set(set_folder, audited, spec, np.random.default_rng(seed))
        except DataError as error:
            if len(sets) == 1:
                raise
            say(f"FAULT {error}")
            found = [str(error)]
        faults += found
    sys.exit(1 if faults else 0)


def _verify_set(folder: Path) -> list[str]:
    manifest = read_manifest(folder)
    with progress_bar(len(manifest.shards), "shard") as bar:
        faults = find_faults(folder, bar.update)
    for fault in faults:
        say(f"FAULT {folder}: {fault}")
    images = sum(entry.images for entry in manifest.shards)
    summary = f"{len(faults)} faults" if faults else "whole and consistent"
    say(f"{folder}: {len(manifest.shards)} shards, {images} images: {summary}")
    return faults


def _volumes_in_words(report: AuditReport) -> str:
    """Say what was drawn of volumes; nothing of a set without."""
    if not report.inside + report.beyond + report.at_edge:
        return ""
    return (
        f"\n  random rotations inside volumes: {report.inside}, outside of them: {report.beyond}; within a few degrees "
        f"of their edge: {report.at_edge}, of which the pixel grid decides {report.at_edge_otherwise} otherwise"
    )


def _repair_set(folder: Path, given: ObjectSpec | None) -> None:
    manifest = read_manifest(folder)
    refuse_to_add(folder, manifest)
    damaged = {entry.file for entry in damaged_shards(folder, manifest)}
    todo = [entry.file for entry in manifest.shards if not entry.is_finished or entry.file in damaged]
    if not todo:
        say(f"{folder}: nothing to repair")
        return
    check_blender_installed()
    plan, open_executor = plan_behind(folder, manifest, given), partial(local_processes, workers=cores())
    with reporter("text", plan.spec.name) as report:
        generate(plan, folder, open_executor, report, repair=True)
    say("\n".join([f"{folder}: made again: {', '.join(todo)}", *failures_in_words(report.tally)]))


def _audit_set(folder: Path, count: int, given: ObjectSpec | None, rng: np.random.Generator) -> list[str]:
    manifest = read_manifest(folder)
    split = next(
        (split for split in ("test", "train") if manifest.images(split) and manifest.is_annotated(split)), None
    )
    if split is None:
        raise DataError(f"{folder}: has no split with symmetry sets, so there is nothing to audit")
    plan = plan_behind(folder, manifest, given)
    outside, not_looked_for = found_outside(plan.spec)
    renderer = RenderProcess(plan.spec, plan.camera, plan.settings)
    with renderer, progress_bar(count, "image") as bar:
        report = audit(dataset.load(folder, split), plan, renderer, count, rng, bar.update, outside)
    _print_report(folder, report)
    for what in not_looked_for:
        say(f"  not looked for: {what}")
    return report.faults


def _print_report(folder: Path, report: AuditReport) -> None:
    for fault in report.faults:
        say(f"FAULT {folder}: {fault}")
    say(
        f"{folder}: drew {report.images} images again, with {report.members} members of their sets and "
        f"{report.rejected} rejected candidates: {len(report.faults)} faults\n"
        f"  rejected candidates that draw the same pixels, for the marking shows too little: {report.near_neighbours}\n"
        f"  rotations outside of the declared group: {report.outside} of groups found from the mesh, and "
        f"{report.near_members} random ones near members, {report.near_members_alike} of which draw the same pixels\n"
        f"  candidates that show the marking by less than the tolerance: {report.within_tolerance}"
        + _volumes_in_words(report)
    )
