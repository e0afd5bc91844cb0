"""Long proofs on real renders, run by hand with `make soak`; prints what it measured, and exits 1 on a contradiction.

python tests/soak.py [--images 500] [--audit 40] [--keep FOLDER]
"""

import argparse
import sys
import tempfile
import time
from collections import Counter
from functools import partial
from pathlib import Path

import numpy as np

from symsol_annot import load
from symsol_annot.audit import audit
from symsol_annot.generate import SetPlan, generate
from symsol_annot.manifest import read_manifest
from symsol_annot.objects import load_object
from symsol_annot.render_process import RenderProcess
from symsol_annot.scene import Camera, RenderSettings
from symsol_annot.statistics import split_statistics
from symsol_annot.verify import verify

MAX_FRAY_DEG = 10  # how far from an arc's end a sliver of the disc may miss the samples, or one sample lie on the rim


def main():
    """Make sets of both marked objects and hold them against the geometry."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, default=500)
    parser.add_argument("--audit", type=int, default=40)
    parser.add_argument("--keep", type=Path, help="make the sets here and keep them")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.keep or Path(temporary)
        found = [soak(name, folder, arguments.images, arguments.audit) for name in ("tetX", "cylO")]
    sys.exit(0 if all(found) else 1)


def soak(name, folder, images, audited):
    """Make one set, count, verify and audit it; return whether nothing contradicts it."""
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    plan = SetPlan(spec, {"test": images}, 0, camera, settings, "test")
    open_renderer = partial(RenderProcess, spec, camera, settings)
    start = time.perf_counter()
    generate(plan, folder / name, open_renderer, workers=2)
    print(f"\n{name}: {images} annotated images in {time.perf_counter() - start:.0f} s with 2 workers")
    statistics = split_statistics(folder / name, read_manifest(folder / name), "test")
    print(f"  shown {statistics.shown} ({statistics.shown / images:.1%}), |S|: {sizes_in_words(statistics.set_sizes)}")
    print(
        f"  below the tolerance: {statistics.candidates_within_tolerance} of {statistics.candidates_drawn} candidates"
    )
    dataset = load(folder / name)
    faults = verify(folder / name) + laws_of(name, dataset)
    with open_renderer() as renderer:
        report = audit(dataset, spec, renderer, audited, np.random.default_rng(0))
    print(
        f"  audit: {report.images} images, {report.members} members, {report.rejected} rejected candidates, "
        f"{report.near_neighbours} near neighbours, {report.within_tolerance} below the tolerance"
    )
    for fault in faults + report.faults:
        print(f"  FAULT {fault}")
    return not faults + report.faults


def sizes_in_words(sizes):
    """Say how often each size occurs, or its range where there are many."""
    if len(sizes) <= 9:
        return ", ".join(f"{size} in {count}" for size, count in sorted(sizes.items()))
    return f"1 in {sizes[1]}, else {min(set(sizes) - {1})} to {max(sizes)}, {sizes[720]} of them 720"


def laws_of(name, dataset):
    """List the samples that break a law of their object."""
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
    print(f"  shown with less than 20 pixels: {barely}; shown, but at no pixel centre: {at_no_centre}")
    if frayed:
        print(f"  circles with a frayed end: {frayed[True]} of {frayed.total()}")
    return broken


def fray_deg(circle):
    """Return how many steps beyond its longest run of members a circle (360,) still has members; 0 for an arc."""
    if circle.all() or not circle.any():
        return 0
    starts = np.flatnonzero(circle & ~np.roll(circle, 1))
    lengths = [int(np.argmin(np.roll(circle, -start))) for start in starts]
    length = max(lengths)
    turned = np.roll(circle, -starts[np.argmax(lengths)])  # begins with the longest run
    beyond = np.flatnonzero(turned)[length:]
    return int(np.minimum(beyond - (length - 1), 360 - beyond).max(initial=0))


if __name__ == "__main__":
    main()
