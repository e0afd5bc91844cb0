"""One set made from start to end, for its rate and its memory: python tests/perf_sets.py '{"images": 200, ...}'.

A process of its own for each set, so that its peak memory is its own. Prints JSON.
"""

import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from symsol_annot.generate import SetPlan, generate
from symsol_annot.objects import load_object
from symsol_annot.render_process import RenderProcess
from symsol_annot.scene import Camera, RenderSettings


def make(name, images, processes, annotate, folder=None):
    """Make a test split in a new process; return pairs_per_second and peak memory in MiB (parent_mib, blender_mib)."""
    request = json.dumps(
        {"name": name, "images": images, "processes": processes, "annotate": annotate, "folder": folder and str(folder)}
    )
    done = subprocess.run([sys.executable, __file__, request], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def peak_mib():
    """Return this process's peak memory; what getrusage says begins with that of the process it was forked from."""
    status = Path("/proc/self/status").read_text()
    return round(int(re.search(r"VmHWM:\s+(\d+) kB", status)[1]) / 1024)


def _make_here(name, images, processes, annotate, folder):
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    plan = SetPlan(spec, {"test": images}, 0, camera, settings, annotate)
    done = []
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        generate(
            plan,
            Path(folder or temporary),
            partial(RenderProcess, spec, camera, settings),
            processes,
            lambda: done.append(time.perf_counter()),
        )
    first = 2 * processes  # until then a process may still be starting
    return {
        "pairs_per_second": round((images - first) / (done[-1] - done[first - 1]), 2),
        "seconds_with_start": round(time.perf_counter() - start, 1),
        "parent_mib": peak_mib(),
        "blender_mib": round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024),
    }


if __name__ == "__main__":
    print(json.dumps(_make_here(**json.loads(sys.argv[1]))))
