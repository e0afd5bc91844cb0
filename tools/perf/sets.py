"""One set made from start to end, for its rate and its memory: python tools/perf/sets.py '{"images": 200, ...}'.

A process of its own for each set, so that its peak memory is its own. Prints JSON.
"""

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
import time
from functools import partial
from pathlib import Path

from symsol_annot.generation.dask.executor import DaskCluster
from symsol_annot.generation.events import ImagesMade
from symsol_annot.generation.executors import local_processes
from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import SetPlan


def make(name, images, processes, annotate, folder=None, cluster=None):
    """Make a test split in a new process; return rate, seconds with start-up, and peaks (parent_mib, blender_mib).

    With the address of a Dask cluster its workers make it; then blender_mib is 0, for Blender is no child of ours, and
    the rate is a coarse one, for workers tell of their images once a second.
    """
    wanted = {"name": name, "images": images, "processes": processes, "annotate": annotate, "cluster": cluster}
    request = json.dumps({**wanted, "folder": folder and str(folder)})
    done = subprocess.run([sys.executable, __file__, request], capture_output=True, text=True, check=True)
    return json.loads(done.stdout)


def peak_mib():
    """Return this process's peak memory; what getrusage says begins with that of the process it was forked from."""
    status = Path("/proc/self/status").read_text()
    (peak_kib,) = re.findall(r"VmHWM:\s+(\d+) kB", status)
    return round(int(peak_kib) / 1024)


def _make_here(name, images, processes, annotate, folder, cluster):
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    plan = SetPlan(spec, {"test": images}, 0, camera, settings, annotate)
    open_executor = partial(DaskCluster, address=cluster) if cluster else partial(local_processes, workers=processes)
    done = []

    def on_event(event):
        if isinstance(event, ImagesMade):
            done.extend([time.perf_counter()] * event.images)

    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as temporary:
        generate(plan, Path(folder or temporary), open_executor, on_event)
    first = 2 * processes  # until then a process may still be starting
    last = images - processes * plan.manifest().shards[0].images  # from then on one may have run out of shards
    return {
        "pairs_per_second": round((last - first) / (done[last - 1] - done[first - 1]), 2),
        "seconds_with_start": round(time.perf_counter() - start, 1),
        "parent_mib": peak_mib(),
        "blender_mib": 0 if cluster else round(resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("request", type=json.loads, help="the arguments of `make`, as JSON")
    print(json.dumps(_make_here(**parser.parse_args().request)))
