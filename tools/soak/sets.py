"""Sets of both marked objects, held against the geometry: counted, verified, audited, and searched for broken laws.

python tools/soak/sets.py [--images 500] [--audit 40] [--keep FOLDER]
"""

import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np
from outcomes import Outcome, run_alone

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

from oracle import fray_deg

from symsol_annot import load
from symsol_annot.generation.audit import audit
from symsol_annot.generation.executors import local_processes
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.manifest import read_manifest
from symsol_annot.sets.plan import SetPlan
from symsol_annot.sets.statistics import split_statistics
from symsol_annot.sets.verify import verify

MAX_FRAY_DEG = 10  # how far from an arc's end a sliver of the disc may miss the samples, or one sample lie on the rim


def prove(table, images, audit, keep):
    """Make a set of each object, and hold it against the geometry."""
    with tempfile.TemporaryDirectory() as temporary:
        for name in ("tetX", "cylO"):
            table.add(made(name, Path(keep or temporary) / name, images, audit))
    return {}


def made(name, folder, images, audited):
    """Make one set, count, verify and audit it."""
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    plan = SetPlan(spec, {"test": images}, 0, camera, settings, "test")
    start = time.monotonic()
    generate(plan, folder, partial(local_processes, workers=2))
    seconds, dataset = time.monotonic() - start, load(folder)
    broken, notes = laws_of(name, dataset)
    with RenderProcess(spec, camera, settings) as renderer:
        report = audit(dataset, plan, renderer, audited, np.random.default_rng(0))
    statistics = split_statistics(folder, read_manifest(folder), "test")
    below = f"{statistics.candidates_within_tolerance} of {statistics.candidates_drawn} candidates"
    found = [
        f"shown {statistics.shown} ({statistics.shown / images:.1%})",
        f"|S|: {sizes_in_words(statistics.set_sizes)}",
        f"below the tolerance: {below}",
        *notes,
        f"audit: {report.images} images, {report.members} members, {report.rejected} rejected candidates",
        f"{report.near_neighbours} near neighbours, {report.within_tolerance} below the tolerance",
    ]
    wrong = verify(folder) + broken + report.faults
    return Outcome("none", f"{name}: {images} images, 2 workers", seconds, "; ".join(found), wrong)


def sizes_in_words(sizes):
    """Say how often each size occurs, or its range where there are many."""
    if len(sizes) <= 9:
        return ", ".join(f"{size} in {count}" for size, count in sorted(sizes.items()))
    return f"1 in {sizes[1]}, else {min(set(sizes) - {1})} to {max(sizes)}, {sizes[720]} of them 720"


def laws_of(name, dataset):
    """List the samples that break a law of their object, and what was counted on the way."""
    broken, frayed, barely, at_no_centre = [], Counter(), 0, 0
    for sample in dataset:
        trace = bool((sample.image[..., 0] > sample.image[..., 2]).any())
        if trace and sample.marking_pixels == 0:
            broken.append(f"image {sample.index}: a trace of colour in a view that hides the marking")
        barely += sample.marking_visible and sample.marking_pixels < 20
        at_no_centre += sample.marking_visible and not (sample.segmentation == 2).any()
        size = len(sample.symmetry_set)
        if name == "tetX" and size not in (3, 6, 9):
            broken.append(f"image {sample.index}: |S| = {size}")
        if name == "cylO":
            if sample.marking_visible != (size == 1):
                broken.append(f"image {sample.index}: |S| = {size}, shown: {sample.marking_visible}")
            if not sample.marking_visible:
                for circle in (sample.symmetry_mask[:360], sample.symmetry_mask[360:]):
                    fray = fray_deg(circle)
                    frayed[fray > 0] += 1
                    if fray > MAX_FRAY_DEG:
                        broken.append(f"image {sample.index}: hidden candidates {fray} degrees from the arc")
    notes = [f"shown with less than 20 pixels: {barely}", f"shown, but at no pixel centre: {at_no_centre}"]
    if frayed:
        notes.append(f"circles with a frayed end: {frayed[True]} of {frayed.total()}")
    return broken, notes


if __name__ == "__main__":
    run_alone(__doc__, "sets", prove, images=500, audit=40, keep="")
