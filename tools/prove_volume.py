"""Membership of sphereX's volume by geometry against drawing, at random rotations; exits 1 where they differ.

python tools/prove_volume.py [--rotations 1000000] [--minutes 20] [--json docs/results/volume.json]

Each rotation is asked for its side of the volume's edge, and for whether a sample shows a part. A part hides for sure
where all of its corners lie well behind the horizon, and shows where a cap that lies in it spans a sample. Elsewhere
the bounds of `annotation.visibility` decide, between which the renderer's count lies, and what they leave open is
drawn. Of the rotations that all these decide, one in --drawn is drawn as well. The band is the edge's within which
points of the lattice may decide otherwise; the rotations in it are counted by how far they are from the edge.
"""

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np
from symsol_annot_assets.ball import DISC_RADIUS_RAD, X_HALF_WIDTH, X_REACH, disc_axis
from tqdm import tqdm

from symsol_annot.annotation.balls.hidden_directions import volume_by_geometry
from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.generation.volume_audit import EDGE_BAND_RAD, VolumeAudit
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

AT_ONCE, SIZE, STEP_DEG = 2000, 224, 0.25
BEHIND = 0.04  # radii behind the horizon's plane, beyond which no facet of the ball faces the camera
SPANNED = 2.0  # spacings of the lattice that a cap's projection must reach to each side to hold a sample for sure


def main():
    """Compare block by block, and print and keep the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rotations", type=int, default=1_000_000)
    parser.add_argument("--drawn", type=int, default=200, help="one in so many is drawn, whatever geometry says")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, help="stop after so long, with what was compared by then")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = compare(arguments, time.monotonic() + 60 * (arguments.minutes or float("inf")))
    print(json.dumps(found, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")
    sys.exit(1 if found["differences_beyond_the_band"] or found["drawn_otherwise_than_bounded"] else 0)


def compare(arguments, end):
    """Return the counts."""
    spec, camera, settings = load_object("sphereX"), Camera.filling(SIZE), RenderSettings()
    T = spec.tolerance_px or 0.0
    volume = volume_by_geometry(spec.mesh, camera, T)
    assert volume is not None
    audited = VolumeAudit(volume, T, SIZE)
    visibility, rng = MarkingVisibility(spec.mesh, camera, settings), np.random.default_rng(arguments.seed)
    edges_deg = np.arange(0.0, np.degrees(EDGE_BAND_RAD) + STEP_DEG, STEP_DEG)
    by_distance = np.zeros((2, len(edges_deg) - 1), dtype=int)  # all, and those that differ
    sums = dict.fromkeys(("rotations", "hidden", "inside", "drawn", "beyond", "otherwise", "misbounded"), 0)
    farthest_deg = 0.0
    with RenderProcess(spec, camera, settings) as renderer, tqdm(total=arguments.rotations, unit="rotation") as bar:
        while sums["rotations"] < arguments.rotations and time.monotonic() < end:
            R = uniform_rotations(min(AT_ONCE, arguments.rotations - sums["rotations"]), rng)
            area_px = coarse_px(R, spec, camera.lattice(settings.samples_per_axis))
            unsure = np.isnan(area_px)
            area_px[unsure] = visibility.areas(R[unsure], T)
            is_open = np.isnan(area_px)
            again = is_open | (rng.random(len(R)) < 1.0 / arguments.drawn)
            drawn_px = renderer.marking_pixels(R[again])
            sums["misbounded"] += int(np.count_nonzero(((drawn_px < T) != (area_px[again] < T)) & ~is_open[again]))
            area_px[again] = drawn_px
            hidden, to_edge = area_px < T, audited.to_edge(R)
            differs, off_deg = hidden != (to_edge < 0), np.degrees(np.abs(to_edge))
            by_distance += [np.histogram(off_deg[some], edges_deg)[0] for some in (off_deg >= 0, differs)]
            farthest_deg = max(farthest_deg, float(off_deg[differs].max(initial=0.0)))
            counts = (len(R), hidden.sum(), (to_edge < 0).sum(), again.sum(), (off_deg > edges_deg[-1]).sum())
            counts = (*counts, (differs & (off_deg > edges_deg[-1])).sum(), 0)
            sums = {name: value + int(more) for (name, value), more in zip(sums.items(), counts, strict=True)}
            bar.update(len(R))
    return {
        "rotations": sums["rotations"],
        "seed": arguments.seed,
        "measure_of_the_volume": audited.volume.measure,
        "share_inside": sums["inside"] / sums["rotations"],
        "share_that_shows_nothing": sums["hidden"] / sums["rotations"],
        "drawn": sums["drawn"],
        "drawn_otherwise_than_bounded": sums["misbounded"],
        "band_deg": float(edges_deg[-1]),
        "beyond_the_band": sums["beyond"],
        "differences_beyond_the_band": sums["otherwise"],
        "differences_in_the_band": int(by_distance[1].sum()),
        "farthest_difference_deg": round(farthest_deg, 3),
        "by_distance_to_the_edge": [
            {"from_deg": float(low), "rotations": int(many), "differences": int(some)}
            for low, many, some in zip(edges_deg[:-1], *by_distance, strict=True)
        ],
    }


def coarse_px(R, spec, lattice):
    """Return 0 (n,) where all parts hide for sure under rotations (n, 3, 3), infinity where one shows, else NaN."""
    seen_from, horizon = -R[:, 2], 1.0 / lattice.distance
    found = np.where((seen_from @ spec.mesh.marking_vertices.T).max(axis=1) < horizon - BEHIND, 0.0, np.nan)
    for middles, radius in caps():
        farthest = np.arccos(np.clip(seen_from @ middles.T, -1.0, 1.0)) + radius  # from the line of sight, of the cap
        cosine = np.cos(np.minimum(farthest, np.pi))
        slope = lattice.focal_px * (lattice.distance * cosine - 1.0) / (lattice.distance - cosine) ** 2
        found[(radius * slope > SPANNED).any(axis=1)] = np.inf
    return found


def caps():
    """Return the middles (n, 3) and the angular radius of caps of the sphere that lie in the X, and in the disc."""
    radius = 0.9 * np.arcsin(X_HALF_WIDTH)
    along = np.sin(np.linspace(-1.0, 1.0, 15) * (np.arcsin(X_REACH) - np.arcsin(X_HALF_WIDTH) / np.cos(np.pi / 6)))
    bar = np.column_stack([along, np.zeros_like(along), np.sqrt(1.0 - along**2)])
    return (np.concatenate([bar, bar[:, [1, 0, 2]]]), radius), (disc_axis()[None], 0.95 * DISC_RADIUS_RAD)


if __name__ == "__main__":
    main()
