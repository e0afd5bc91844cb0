"""Counts of sphereX's four kinds of view against what geometry predicts; exits 1 where one is off by 3 standard errors.

python tools/prove_views.py data/sphereX [--json FILE]

What shows of X and disc depends on the direction to the camera alone, and directions are uniform. A part shows from
those where its triangles that face the camera have an area of T or more in the image, which is not yet sampled; of a
sampled image a part shows that has a sample.
"""

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

from symsol_annot import load
from symsol_annot.annotation.balls.hidden_directions import visible_area_px
from symsol_annot.objects.spec import load_object

DIRECTIONS, MOST = 400_000, 3.0


def main():
    """Compare both splits, and print and keep the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="a set of sphereX")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = {split: compared(load(arguments.folder, split)) for split in ("test", "train")}
    print(json.dumps(found, indent=1))
    if arguments.json:
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")
    sys.exit(1 if any(abs(row["z"]) > MOST for rows in found.values() for row in rows.values()) else 0)


def compared(dataset):
    """Return, by kind of view, how many images are of it, and how many standard errors that is off."""
    counted = kinds(*(dataset.labels().part_pixels[:, 1:] > 0).T)
    found = {}
    for name, share in predicted(dataset.manifest.rendered.camera).items():
        images, expected = int(counted[name].sum()), len(dataset) * share
        z = (images - expected) / np.sqrt(expected * (1.0 - share))
        found[name] = {"images": images, "share": images / len(dataset), "predicted": share, "z": round(z, 2)}
    return found


def predicted(camera):
    """Return the share of directions from which a view is of each kind."""
    spec = load_object("sphereX")
    directions, T = spiral(DIRECTIONS), spec.tolerance_px or 0.0
    x, disc = (
        visible_area_px(replace(spec.mesh, breaking=(part,)), camera, directions) >= T for part in spec.mesh.breaking
    )
    return {name: float(of_kind.mean()) for name, of_kind in kinds(x, disc).items()}


def kinds(x, disc):
    """Return which views are of each kind, from whether X and disc show, (n,) each."""
    return {"neither": ~x & ~disc, "the disc alone": ~x & disc, "the X alone": x & ~disc, "X and disc": x & disc}


def spiral(count):
    """Return directions (n, 3) that are spread evenly over the sphere."""
    i = np.arange(count) + 0.5
    z, azimuth = 1.0 - 2.0 * i / count, np.pi * (1.0 + np.sqrt(5.0)) * i
    radius = np.sqrt(1.0 - z * z)
    return np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=-1)


if __name__ == "__main__":
    main()
