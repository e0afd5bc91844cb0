"""Many starts of Blender, each drawing a few frames: how often one crashes, or draws other bytes at its end.

python tools/soak/many_starts.py LOG [--starts 4000] [--lanes 2] [--seed 0]

Each start draws an object, chosen at random like its engine, size and requests, between two pictures of the same two
rotations, which have to be equal byte for byte. Every other start runs under glibc's checking malloc with perturbed
blocks. LOG takes a line of JSON per start, and a second run goes on with it. It is no part of `make soak`: 4,000 starts
take an hour and a half on two cores.
"""

import argparse
import hashlib
import json
import os
import random
import sys
import threading
import time
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np

from symsol_annot.errors import RenderError
from symsol_annot.objects.spec import builtin_names, load_object
from symsol_annot.rendering import blender_process
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

SILENCE_S = 7200.0  # beside other work a start may wait for a processor for long
CHECKING = {"LD_PRELOAD": "libc_malloc_debug.so.0", "MALLOC_CHECK_": "3", "MALLOC_PERTURB_": "165"}
SIZES, SIZES_CYCLES = (32, 48, 64, 96, 128, 224), (16, 24, 32, 48, 64)


def main():
    """Start, draw and end Blender until the log has as many lines as are wanted; exit with 1 at a crash."""
    arguments = _parsed()
    done = arguments.log.read_text().splitlines() if arguments.log.exists() else []
    for variable in CHECKING:
        os.environ.pop(variable, None)
    blender_process._SLOWS = ()  # which would keep the checking from Blender's process
    writing = threading.Lock()

    def attempt(number):
        outcome = one_start(number, arguments.seed)
        with writing, arguments.log.open("a") as log:
            log.write(json.dumps(outcome) + "\n")

    with ThreadPoolExecutor(arguments.lanes) as pool:
        list(pool.map(attempt, range(len(done), arguments.starts)))
    outcomes = [json.loads(line) for line in arguments.log.read_text().splitlines()]
    for (engine, checked, ended), count in sorted(Counter(map(_kind, outcomes)).items()):
        print(f"{engine:10} {'checking malloc' if checked else 'plain':16} {ended:40.40} {count}")
    print(len(outcomes), "starts,", sum(outcome["frames"] for outcome in outcomes), "frames")
    sys.exit(any(outcome["ended"] != "right" for outcome in outcomes))


def one_start(number, seed):
    """Start Blender, draw with it, end it, and say what it was and how it ended."""
    chance = random.Random(f"{seed} {number}")
    engine = chance.choice(("opengl", "workbench", "cycles"))
    name = chance.choice(builtin_names())
    size = chance.choice(SIZES_CYCLES if engine == "cycles" else SIZES)
    outcome = {"number": number, "object": name, "engine": engine, "size": size, "checked": number % 2 == 1}
    rng, frames, start = np.random.default_rng([seed, number]), 0, time.monotonic()
    try:
        with _renderer(name, size, engine, checked=outcome["checked"]) as renderer:
            control = uniform_rotations(2, rng)
            before = _digest(renderer, control)
            for request in range(chance.randrange(1, 5)):
                rotations = uniform_rotations(chance.randrange(1, 30), rng)
                if request % 2:
                    renderer.render(rotations[0])
                    frames += 1
                elif load_object(name).marking:
                    renderer.marking_pixels(rotations)
                    frames += len(rotations)
            ended = "right" if _digest(renderer, control) == before else "its bytes changed"
            frames += 2 * len(control)
    except RenderError as error:
        ended = str(error)
    return {**outcome, "frames": frames, "seconds": round(time.monotonic() - start, 2), "ended": ended}


_STARTING = threading.Lock()


def _renderer(name, size, engine, *, checked):
    with _STARTING:
        os.environ.update(CHECKING if checked else {})
        try:
            return RenderProcess(load_object(name), Camera.filling(size), RenderSettings(engine=engine), SILENCE_S)
        finally:
            for variable in CHECKING:
                os.environ.pop(variable, None)


def _digest(renderer, rotations):
    digest = hashlib.sha256()
    for rotation in rotations:
        view = renderer.render(rotation)
        for part in (view.rgb, view.segmentation):
            digest.update(part.tobytes())
    return digest.hexdigest()


def _kind(outcome):
    return outcome["engine"], outcome["checked"], outcome["ended"]


def _parsed():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=Path)
    parser.add_argument("--starts", type=int, default=4000)
    parser.add_argument("--lanes", type=int, default=len(os.sched_getaffinity(0)))
    parser.add_argument("--seed", type=int, default=0)
    return parser.parse_args()


if __name__ == "__main__":
    main()
