"""How fast, beside the common recipe, the exhaustive way and a folder of PNG files: `make perf`.

python tools/perf [--quick] [--json FILE]

Everything in one run on one machine, whatever is compared in turn; ratios of medians. Takes about 10 minutes, with
--quick about 2. The recipe is described in recipe.py.
"""

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import annotation
import loading
import sets
from recipe import Recipe

sys.path.insert(0, str(Path(__file__).parents[2] / "tests" / "support"))

import dask_cluster

NAME = "cylO"
PROCESSES = 2


def main():
    """Measure, print a table, and keep everything as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="fewer images and rounds")
    parser.add_argument("--json", type=Path, default=Path("build/perf.json"))
    arguments = parser.parse_args()
    found = {"machine": machine(), **measure(quick=arguments.quick)}
    arguments.json.parent.mkdir(exist_ok=True)
    arguments.json.write_text(json.dumps(found, indent=1) + "\n")
    print("\n".join(table(found)))
    print(f"\nAll figures: {arguments.json}")


def machine():
    """Say what this was measured on."""
    lines = Path("/proc/cpuinfo").read_text().splitlines() if Path("/proc/cpuinfo").exists() else []
    model = next((line.split(":")[1].strip() for line in lines if line.startswith("model name")), platform.processor())
    return {"processor": model, "cores": len(os.sched_getaffinity(0)), "python": platform.python_version()}


def measure(*, quick):
    """Take all measurements; see docs/performance.md for what each means."""
    images, rounds, views, counts = (80, 1, 4, (300, 600)) if quick else (320, 5, 30, (500, 5000))
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        found = {
            "pairs": pairs(folder, images, rounds),
            "stages_ms": {name: stages(name, images // 4) for name in ("cylO", "tetX")},
            "annotation": {name: annotation.measure(name, views) for name in ("cylO", "tetX")},
            "growth": growth(folder, images, rounds, counts),
        }
        found["loading"] = loading.measure(folder / str(counts[0]), rounds=2 * rounds + 1)
        found["loading_growth"] = {
            f"{count} images, {_processes(processes)}": [
                loading.load_together(folder / str(count), processes) for _ in range(rounds)
            ]
            for count in counts
            for processes in (1, PROCESSES)
        }
    return found


def pairs(folder, images, rounds):
    """Return pairs per second by kind, one a round, all start-up left out."""
    rates = {kind: [] for kind in ("all sets", "no sets", "recipe, 2 processes", "recipe, 2 threads")}
    with Recipe(NAME, PROCESSES, 1, folder) as processes, Recipe(NAME, 1, PROCESSES, folder) as threads:
        for _ in range(rounds):
            rates["all sets"].append(sets.make(NAME, images, PROCESSES, "all")["pairs_per_second"])
            rates["no sets"].append(sets.make(NAME, images, PROCESSES, "none")["pairs_per_second"])
            for kind, recipe in (("recipe, 2 processes", processes), ("recipe, 2 threads", threads)):
                drawn = recipe.draw(max(images // 5, 2 * PROCESSES))
                rates[kind].append(round(drawn["frames"] / drawn["wall"], 2))
    return rates


def stages(name, views):
    """Return the median ms of each stage of a view, measured inside Blender's process."""
    script = Path(__file__).parent / "stages.py"
    command = [sys.executable, str(script), name, str(views)]
    return json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)


def growth(folder, images, rounds, counts):
    """Return what 1 and 2 processes make, in turn, and sets of few and of many images, with their memory."""
    ways = {
        f"{kind}, {_processes(processes)}": (processes, annotate)
        for kind, annotate in (("all sets", "all"), ("no sets", "none"))
        for processes in (1, PROCESSES)
    }
    runs = {way: [] for way in ways}
    for _ in range(rounds):
        for way, (processes, annotate) in ways.items():
            runs[way].append(sets.make(NAME, images, processes, annotate))
    with dask_cluster.scheduler(folder) as address, dask_cluster.workers(folder, address, PROCESSES):
        for _ in range(rounds):
            for way, cluster in ((f"{counts[0]} images, local", None), (f"{counts[0]} images, Dask", address)):
                made = sets.make(NAME, counts[0], PROCESSES, "all", cluster=cluster)
                runs.setdefault(way, []).append(made)
    for count in counts:
        runs[f"all sets, {count} images"] = [sets.make(NAME, count, PROCESSES, "all", folder / str(count))]
    return runs


def _processes(number):
    return f"{number} process{'es' * (number > 1)}"


def table(found):
    """Return the lines of a Markdown table."""
    rates = {kind: statistics.median(values) for kind, values in found["pairs"].items()}
    recipe = max(rate for kind, rate in rates.items() if kind.startswith("recipe"))
    lines = ["", "| pairs per second, cylO, 2 cores | | times the recipe |", "|---|---|---|"]
    lines += [f"| {kind} | {rate:.1f} | {rate / recipe:.1f} |" for kind, rate in rates.items()]
    lines += ["", "| hidden view's set | exhaustive | geometry | times faster |", "|---|---|---|---|"]
    for name, row in found["annotation"].items():
        exhaustive, geometry = row["exhaustive_ms"], row["geometry_ms"]
        lines.append(f"| {name} | {exhaustive:.0f} ms | {geometry:.1f} ms | {row['times_faster']:.0f} |")
    lines += ["", "| loading a sample | ms | times faster than PNG |", "|---|---|---|"]
    for way, ms in found["loading"]["ms_a_sample"].items():
        lines.append(f"| {way} | {ms:.3f} | {found['loading']['times_faster_than_png'][way]:.1f} |")
    lines += ["", "| growth | pairs per second | s with start-up | peak MiB: parent, Blender |", "|---|---|---|---|"]
    for kind, runs in found["growth"].items():
        rate = statistics.median(run["pairs_per_second"] for run in runs)
        peaks = (max(run[key] for run in runs) for key in ("parent_mib", "blender_mib"))
        seconds = statistics.median(run["seconds_with_start"] for run in runs)
        lines.append(f"| {kind} | {rate:.1f} | {seconds:.1f} | {', '.join(map(str, peaks))} |")
    lines += ["", "| loading by load() | samples per second | peak MiB per process |", "|---|---|---|"]
    for kind, runs in found["loading_growth"].items():
        rate = statistics.median(run["samples_per_second"] for run in runs)
        lines.append(f"| {kind} | {rate:.0f} | {max(run['peak_mib'] for run in runs)} |")
    for name, stages_ms in found["stages_ms"].items():
        lines += ["", f"| stage of a view, {name} | ms |", "|---|---|"]
        lines += [f"| {stage} | {ms:.2f} |" for stage, ms in stages_ms.items()]
    return lines


if __name__ == "__main__":
    main()
