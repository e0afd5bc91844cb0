"""Pairs a second of `render` beside the common recipe, in turn in one run: `make perf`.

python tests/perf.py [--object cylO] [--images 200] [--rounds 3] [--json FILE]
"""

import argparse
import json
import statistics
import tempfile
import time
from functools import partial
from pathlib import Path

from perf_recipe import Recipe

from symsol_annot.generate import SetPlan, generate
from symsol_annot.objects import load_object
from symsol_annot.render_process import RenderProcess
from symsol_annot.scene import Camera, RenderSettings

PROCESSES = 2


def main():
    """Measure, print a table, and keep it as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="cylO")
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    rates = measure(arguments.object, arguments.images, arguments.rounds)
    medians = {kind: statistics.median(values) for kind, values in rates.items()}
    recipe = max(medians["recipe, 2 processes"], medians["recipe, 2 threads"])
    for kind, rate in medians.items():
        print(f"{kind:22} {rate:7.2f} pairs/s   {rate / recipe:5.1f} x the recipe   rounds: {rates[kind]}")
    if arguments.json:
        arguments.json.write_text(json.dumps({**vars(arguments), "json": None, "pairs_per_second": rates}, indent=1))


def measure(name, images, rounds):
    """Return pairs a second by kind, one a round; all start-up is left out."""
    rates = {kind: [] for kind in ("no sets", "all sets", "recipe, 2 processes", "recipe, 2 threads")}
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        with Recipe(name, PROCESSES, 1, folder) as processes, Recipe(name, 1, PROCESSES, folder) as threads:
            for number in range(rounds):
                rates["no sets"].append(ours(name, images, "none", folder / f"none-{number}"))
                rates["all sets"].append(ours(name, images, "all", folder / f"all-{number}"))
                for kind, recipe in (("recipe, 2 processes", processes), ("recipe, 2 threads", threads)):
                    drawn = recipe.draw(images // 5)
                    rates[kind].append(round(drawn["frames"] / drawn["wall"], 2))
    return rates


def ours(name, images, annotate, folder):
    """Return pairs a second from when both workers have drawn to the end."""
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings()
    plan = SetPlan(spec, {"test": images}, 0, camera, settings, annotate)
    done = []
    open_renderer = partial(RenderProcess, spec, camera, settings)
    generate(plan, folder, open_renderer, PROCESSES, lambda: done.append(time.perf_counter()))
    first = 2 * PROCESSES
    return round((images - first) / (done[-1] - done[first - 1]), 2)


if __name__ == "__main__":
    main()
