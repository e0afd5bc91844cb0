"""Millions of frames in one process of Blender: does its memory grow, does it crash, does a frame come out otherwise?

python tools/soak/many_frames.py LOG [--frames 2000000] [--object cylO] [--size 64]

Frames are windows around the marking, and one whole view in twenty, at random rotations. The first thousand rotations
come again at the end, and their frames have to be the same, byte for byte. Each thousand frames is followed by the
control that makers of shards draw, which raises at the first byte that is not as it was. LOG takes a line of JSON per
50,000 frames: how many there were, how long they took and the memory that the process held. It is no part of `make
soak`: two million take twenty minutes.
"""

import argparse
import hashlib
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

from symsol_annot.generation.process import _held_bytes
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.blender_process import open_blender
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.control import ControlledRenderer
from symsol_annot.rendering.renderer import Scene
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

BATCH, BATCHES_PER_LINE = 1000, 50
GROWTH_MIB = 16  # allowed after the first line


def main():
    """Draw, and exit with 1 where memory grew or a frame changed."""
    arguments = _parsed()
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # Blender talks
    scene = Scene(load_object(arguments.object).mesh, Camera.filling(arguments.size), RenderSettings())
    renderer = ControlledRenderer(open_blender(scene))
    first, lines, begun = _digest(renderer, 0), [], time.monotonic()
    for batch in range(1, arguments.frames // BATCH):
        _digest(renderer, batch)
        if batch % BATCHES_PER_LINE == 0:
            held, seconds = _held_bytes() / 2**20, time.monotonic() - begun
            lines.append({"frames": renderer.frames, "seconds": round(seconds, 1), "held_mib": round(held, 1)})
            with arguments.log.open("a") as log:
                log.write(json.dumps(lines[-1]) + "\n")
    is_same = _digest(renderer, 0) == first
    growth = lines[-1]["held_mib"] - lines[0]["held_mib"] if lines else 0.0
    print(f"{renderer.frames} frames, memory grew by {growth:.1f} MiB, the first come again: {is_same}", file=answers)
    answers.flush()
    sys.stdout.flush()
    os._exit(not is_same or growth > GROWTH_MIB)


def _digest(renderer, batch):
    """Draw a batch of frames, and return a digest of them."""
    R = uniform_rotations(BATCH, np.random.default_rng(batch))
    digest = hashlib.sha256()
    for labels in renderer.label_windows(R[BATCH // 20 :]):
        digest.update(labels.ids.tobytes())
    for one in R[: BATCH // 20]:
        view = renderer.render(one)
        digest.update(view.rgb.tobytes() + view.segmentation.tobytes())
    return digest.digest()


def _parsed():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--frames", type=int, default=2_000_000)
    parser.add_argument("--object", default="cylO")
    parser.add_argument("--size", type=int, default=64)
    return parser.parse_args()


if __name__ == "__main__":
    os.environ.update(LP_NUM_THREADS="0", OPENBLAS_NUM_THREADS="1")
    main()
