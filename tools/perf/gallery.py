"""How a gallery of many images behaves in a browser: python tools/perf/gallery.py SET [--steps 40] [--json FILE].

SET is a test split, such as `symsol-annot render --object cylO --train 0 --test 10000` makes. Writes 30 random
hypotheses per image and a gallery with them, opens it in headless Chromium, and goes through it by its keys.
"""

import argparse
import json
import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))

from gallery_browser import Page, chromium

from symsol_annot import load
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.rotations.so3 import uniform_rotations

HYPOTHESES = 30
FILTERS = (("marking", "hidden"), ("marking", ""), ("find", "shown 12"), ("find", ""), ("order", "smallest"))


def measure(folder, steps):
    """Return seconds, MiB and counts."""
    with tempfile.TemporaryDirectory() as temporary, load(folder) as images:
        place = Path(temporary)
        rng = np.random.default_rng(0)
        hypotheses = uniform_rotations(len(images) * HYPOTHESES, rng).reshape(len(images), HYPOTHESES, 3, 3)
        write_hypotheses(place / "preds.h5", images, hypotheses, method="random rotations")
        found = {"images": len(images), **_written(folder, place)}
        with chromium(place / "profile") as driver:
            found |= _used(driver, place / "gallery", steps)
    return found


def _written(folder, place):
    words = ["gallery", folder, "--predictions", place / "preds.h5", "--redrawn", "0", "--out", place / "gallery"]
    start = time.perf_counter()
    subprocess.run([Path(sys.executable).with_name("symsol-annot"), *words], check=True, capture_output=True)
    files = [path for path in (place / "gallery").rglob("*") if path.is_file()]
    size = sum(path.stat().st_size for path in files) / 1e6
    return {"written_s": time.perf_counter() - start, "files": len(files), "size_mb": size}


def _used(driver, gallery, steps):
    page = Page(driver, gallery)
    opened = _seconds(lambda: (page.open(), page.wait_for("document.getElementById('detail').dataset.shown")))
    found = {"first_image_s": opened, "at_first": _memory(driver)}
    page.run("document.getElementById('window').focus()")
    walked = [_seconds(lambda: _step(page)) for _ in range(steps)]
    found |= {"next_image_s": statistics.median(walked), "slowest_image_s": max(walked)}
    found["filter_s"] = {f"{field} {value}": _seconds(lambda: page.set(field, value)) for field, value in FILTERS}  # noqa: B023
    thumbnails, position = 0, -1
    while (now := page.position()) != position:  # page by page to the end
        position, thumbnails = now, max(thumbnails, len(page.options()))
        page.press(*["PageDown"] * 10)
    return found | {"last_position": position, "most_thumbnails": thumbnails, "at_the_end": _memory(driver)}


def _step(page):
    """Go to the next image, until all of it is drawn."""
    before = page.text("detail-title")
    page.press("ArrowRight")
    page.wait_for("document.getElementById('detail-title').textContent !== arguments[0]", before)
    page.wait_for("document.getElementById('detail').dataset.shown")


def _seconds(call):
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def _memory(driver):
    """MiB of JavaScript's heap, of the largest of Chromium's processes, and of all; a shared page counts in parts."""
    heap = driver.execute_script("return performance.memory.usedJSHeapSize") / 2**20
    sizes = [_proportional_mib(pid) for pid in _descendants(driver.service.process.pid)]
    return {"heap_mib": heap, "page_mib": max(sizes), "all_mib": sum(sizes)}


def _descendants(pid):
    children = [int(word) for path in Path(f"/proc/{pid}/task").glob("*/children") for word in path.read_text().split()]
    return [*children, *(one for child in children for one in _descendants(child))]


def _proportional_mib(pid):
    lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith("Pss:")) / 1024


def main():
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--steps", type=int, default=40)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = measure(arguments.folder, arguments.steps)
    text = json.dumps(found, indent=1, default=lambda value: round(value, 3))
    print(text)
    if arguments.json:
        arguments.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
