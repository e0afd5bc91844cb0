"""Memory damaged in Blender's process at a random moment: no frame that it spoiled gets into a shard.

python tools/soak/heap_damage.py [--trials 60] [--seed 0]

Each trial starts a worker process, damages its memory while it makes a shard, and looks at what arrives: the shard's
own bytes, an error, or other bytes, which is a contradiction. The damage is of four kinds in turn: random bits of
resident memory flipped, writing behind a block of malloc, writing into freed blocks, the object's mesh moved. It is
done by a module that Python imports at the worker's start (`sitecustomize`), so that the worker's own code is the real
one.
"""

import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

import numpy as np
from outcomes import Outcome, run_alone

from symsol_annot.errors import RendererCrashedError, RenderError
from symsol_annot.generation.process import Limits, ShardProcess
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import SetPlan

IMAGES = 16
PLAN = SetPlan(load_object("tetX"), {"train": 0, "test": IMAGES}, 0, Camera.filling(48), RenderSettings(), "test")
SILENCE_S = 300.0
KINDS = ("bits", "overflow", "freed", "mesh")
BITS = (500, 2000, 8000)
SIGNS = ("its memory is damaged", "SIGSEGV", "SIGABRT", "SIGBUS", "SIGILL", "SIGFPE", "no sign of life")
SHOWN = 60  # characters of any other message

DAMAGE = """
import ctypes
import random
from pathlib import Path

import symsol_annot.rendering.frames.supersampling as frames

PAGE, WORD = 4096, 8
chance = random.Random({seed})
libc = ctypes.CDLL(None)
libc.malloc.restype, libc.malloc.argtypes, libc.free.argtypes = ctypes.c_void_p, [ctypes.c_size_t], [ctypes.c_void_p]


def pages():
    for line in Path("/proc/self/maps").read_text().splitlines():
        span, rights, _, _, inode, *name = line.split()
        if rights == "rw-p" and inode == "0" and name in ([], ["[heap]"]):
            low, high = (int(end, 16) for end in span.split("-"))
            yield from range(low, high, PAGE)


def bits():
    possible = list(pages())
    with open("/proc/self/pagemap", "rb") as pagemap:
        for _ in range({bits}):
            is_resident = False
            while not is_resident:
                page = chance.choice(possible)
                pagemap.seek(page // PAGE * WORD)
                is_resident = int.from_bytes(pagemap.read(WORD), "little") >> 63
            word = ctypes.c_uint64.from_address(page + WORD * chance.randrange(PAGE // WORD))
            word.value ^= 1 << chance.randrange(64)


def overflow():
    size = chance.randrange(24, 4000)
    ctypes.memset(libc.malloc(size) + size, 0x41, 24)


def freed():
    blocks = [libc.malloc(1500) for _ in range(40)]
    for block in blocks[::2]:
        libc.free(block)
    ctypes.memset(blocks[0], 0x41, 16)


def mesh():
    import gc

    (renderer,) = [found for found in gc.get_objects() if type(found).__name__ == "OpenGLRenderer"]
    renderer._mesh.vertices[:, 0] += 0.02


drawn, pixel_averages = 0, frames.pixel_averages


def averages_of_a_damaged_process(*arguments):
    global drawn
    drawn += 1
    if drawn == {at}:
        {kind}()
    return pixel_averages(*arguments)


frames.pixel_averages = averages_of_a_damaged_process
"""


def prove(table, trials, seed):
    """Damage as many worker processes, one after the other."""
    rng, counted = np.random.default_rng(seed), Counter()
    undisturbed = made_with("")
    for trial in range(trials):
        kind, bits = KINDS[trial % len(KINDS)], int(rng.choice(BITS))
        at, start = int(rng.integers(3, IMAGES + 3)), time.monotonic()
        ended = made_with(DAMAGE.format(seed=int(rng.integers(2**31)), kind=kind, at=at, bits=bits))
        said = ended if isinstance(ended, str) else "its own bytes" if ended == undisturbed else "OTHER BYTES"
        wrong = ["bytes arrived that an undamaged worker does not make"] if said == "OTHER BYTES" else []
        counted[f"{kind}: {said}"] += 1
        what = f"{bits} bits" if kind == "bits" else kind
        table.add(Outcome(what, f"view {at} of {IMAGES + 2}", time.monotonic() - start, said, wrong))
    return {"counted": dict(sorted(counted.items()))}


def made_with(customization):
    """Return the bytes of the shard that a worker hands out, or in words how it failed."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "sitecustomize.py").write_text(customization)
        sys.path.insert(0, folder)  # of which a worker's path is made
        process = ShardProcess(PLAN, Limits(silence_s=SILENCE_S))
        try:
            return process.make(PLAN.manifest().shards[0], lambda _: None).data
        except RenderError as error:
            is_survived = isinstance(error, RendererCrashedError)  # by beginning the shard again
            return ("" if is_survived else "the command ends: ") + _in_short(str(error))
        finally:
            process.close()
            sys.path.remove(folder)


def _in_short(message):
    return next((sign for sign in SIGNS if sign in message), message.splitlines()[0][:SHOWN])


if __name__ == "__main__":
    run_alone(__doc__, "heap_damage", prove, trials=60, seed=0)
