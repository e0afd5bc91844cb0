"""Sets of objects with parts against all of their candidates drawn whole; exits 1 on a difference.

python tools/prove_parts.py [--object mug] [--hidden 100] [--grazing 100] [--json docs/results/parts.json]

Hidden views are those of a test split of seed 0 under which something that breaks the symmetry is out of sight: all of
it, or one of several patches (a dot, a pip, a face). Grazing ones are found by bisection, on the way from a view that
shows a patch to one that does not: at the horizon, and up to half a degree on either side. Each candidate is drawn, and
compared with the image by a formula of this file. On a circle a candidate that draws the same may be refused, as no
member of the continuous limit; it is held against drawings that are finer by FINER, and so are the members.
"""

import argparse
import json
import multiprocessing
import statistics
import sys
import time
from collections import Counter
from itertools import count
from pathlib import Path

import numpy as np
from tqdm import tqdm

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.symmetry_set import circles_of
from symsol_annot.objects.mesh import is_convex
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import DEFAULT_SIZE, Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotation_to_quat_wxyz, rotations_about, uniform_rotations
from symsol_annot.sets.plan import label_rotation

OBJECTS = ("mug", "screw", "dots", "die", "box")
SEED, BISECTIONS, AT_ONCE, FINER, LEVELS = 0, 24, 24, 4, 12
BESIDE_DEG = (0.0, 0.001, -0.001, 0.02, -0.02, 0.1, -0.1, 0.5, -0.5)  # of the horizon
_PROVERS = {}  # a process's own


def main():
    """Compare view by view, and print and keep the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", dest="objects", action="append", help=f"by default {', '.join(OBJECTS)}")
    parser.add_argument("--engine", default="opengl")
    parser.add_argument("--size", type=int, default=DEFAULT_SIZE)
    parser.add_argument("--hidden", type=int, default=100)
    parser.add_argument("--grazing", type=int, default=100)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--minutes", type=float, help="stop after so long; the same command goes on")
    parser.add_argument("--rows", type=Path, help="one line of JSON per view: what is there already is not done again")
    parser.add_argument("--json", type=Path, help="the counts; those of other objects that it holds are kept")
    arguments = parser.parse_args()
    end = time.monotonic() + 60 * (arguments.minutes or float("inf"))
    found = {name: prove(name, arguments, end) for name in arguments.objects or OBJECTS}
    for name, kinds in found.items():
        for kind, row in kinds.items():
            print(f"{name}, {kind}:", ", ".join(f"{key} {value}" for key, value in row.items()))
    if arguments.json:
        write(arguments, found)
    sys.exit(1 if any(row["differences"] for kinds in found.values() for row in kinds.values()) else 0)


def write(arguments, found):
    """Write the counts of objects beside those of others that the file holds."""
    before = json.loads(arguments.json.read_text())["found"] if arguments.json.exists() else {}
    merged = {name: (before | found)[name] for name in OBJECTS if name in before | found}
    about = {"engine": arguments.engine, "size": arguments.size, "seed": SEED, "found": merged}
    arguments.json.write_text(json.dumps(about, indent=1) + "\n")


def prove(name, arguments, end):
    """Return the counts of each kind of view of an object."""
    wanted = {"hidden": arguments.hidden, "grazing": arguments.grazing}
    setup = (name, arguments.engine, arguments.size)
    rows = rows_of(arguments.rows, setup)
    done = {(row["kind"], row["number"]) for row in rows}
    numbers = [(kind, n, many) for n in range(max(wanted.values())) for kind, many in wanted.items() if n < many]
    tasks = ((setup, *one) for one in numbers if one[:2] not in done and time.monotonic() < end)
    with multiprocessing.get_context("spawn").Pool(arguments.processes) as pool:
        left = len(numbers) - len(done)
        for row in tqdm(handed_out(pool, tasks, arguments.processes), total=left, unit="view", desc=name):
            rows.append(row)
            if arguments.rows:
                with arguments.rows.open("a") as file:
                    file.write(json.dumps({"setup": setup, **row}) + "\n")
    return {kind: summary([row for row in rows if row["kind"] == kind]) for kind, many in wanted.items() if many}


def handed_out(pool, tasks, processes):
    """Yield what comes of tasks, of which no more are begun than there are processes, so that they can end in time."""
    running = []
    for task in tasks:
        running.append(pool.apply_async(compare, (task,)))
        while len(running) > processes:
            yield running.pop(0).get()
    for one in running:
        yield one.get()


def rows_of(path, setup):
    """Return what is known of views of a set-up already."""
    lines = path.read_text().splitlines() if path and path.exists() else []
    return [row for row in map(json.loads, lines) if tuple(row.pop("setup")) == setup]


def summary(rows):
    """Return the sums over views, the sizes of their sets, and the median times by whether a view shows a part."""
    sums = ("candidates", "members", "differences", "certified_drawn_otherwise", "refused_by_the_limit")
    sums += ("finer_differences",)
    unseen, seen = ([row["ms"] for row in rows if row["shows"] == shows] for shows in (False, True))
    return {
        "views": len(rows),
        "views_that_show_nothing": len(unseen),
        **{key: sum(row[key] for row in rows) for key in sums},
        "sizes": {str(size): many for size, many in sorted(Counter(row["members"] for row in rows).items())},
        "ms_where_nothing_shows": round(statistics.median(unseen), 1) if unseen else None,
        "ms_where_something_shows": round(statistics.median(seen), 1) if seen else None,
        "ms_of_drawing_all": round(statistics.median([row["exhaustive_ms"] for row in rows] or [0.0]), 1),
        "faults": [row["fault"] for row in rows if row["fault"]],
    }


def compare(task):
    """Find one view and compare its two sets."""
    setup, kind, number, many = task
    if setup not in _PROVERS:
        _PROVERS[setup] = Prover(*setup)
    return _PROVERS[setup].compare(kind, number, many)


class Prover:
    """Annotates views of one object both ways."""

    def __init__(self, name, engine, size):
        self._spec, settings = load_object(name), RenderSettings(engine)
        camera, finer = Camera.filling(size), Camera.filling(FINER * size)
        self._distance = camera.distance
        self._renderer = RenderProcess(self._spec, camera, settings)
        self._finer = RenderProcess(self._spec, finer, settings)
        self._annotator = Annotator.for_object(self._spec, camera, settings, self._renderer)
        self._is_round = circles_of(self._spec.symmetry_group) is not None
        mesh = self._spec.mesh
        self._parts = mesh.part_ids[mesh.is_marking].astype(int)
        self._patches = patches_of(mesh.triangles[mesh.is_marking], self._parts)
        self._corners = mesh.vertices[mesh.triangles[mesh.is_marking]]
        self._is_convex = is_convex(mesh)
        self._is_breaking = np.isin(np.arange(mesh.parts + 1), mesh.breaking)

    def compare(self, kind, number, many):
        """Return what a view's sets have in common, and both times in ms."""
        R = self._hidden(number, many) if kind == "hidden" else self._grazing(number)
        view = self._renderer.render(R)
        begun = time.perf_counter()
        shown_px = self._annotator.shown_px(R, view)
        mask = self._annotator.annotate(R, shown_px).mask
        fast, begun = time.perf_counter() - begun, time.perf_counter()
        drawn = self._drawn_alike(R, self._spec.symmetry_group, self._renderer)
        same, certified = self._by_cosets(drawn), self._spec.cosets[0]
        exhaustive, shows = time.perf_counter() - begun, bool(self._annotator.is_shown(shown_px))
        may_be_refused = self._is_round and shows
        refused = same & ~mask if may_be_refused else np.zeros_like(mask)
        differs = (mask != same) & ~refused
        checked = np.flatnonzero(refused | mask) if may_be_refused else np.zeros(0, int)
        finer = self._drawn_alike(R, self._spec.symmetry_group[checked], self._finer)
        wrong = checked[finer != mask[checked]]
        return {
            "kind": kind,
            "number": number,
            "shows": shows,
            "candidates": len(mask),
            "members": int(mask.sum()),
            "differences": int(differs.sum()),
            "certified_drawn_otherwise": int(np.count_nonzero(~drawn[certified])),
            "refused_by_the_limit": int(refused.sum()),
            "finer_differences": len(wrong),
            "fault": self._fault(R, view, differs, wrong) if differs.any() or len(wrong) else None,
            "ms": 1e3 * fast,
            "exhaustive_ms": 1e3 * exhaustive,
        }

    def _by_cosets(self, drawn):
        """Return which candidates are members by the rule: certified ones, and those whose coset draws the same."""
        same = np.zeros_like(drawn)
        for coset in self._spec.cosets:
            same[coset] = drawn[coset].all()
        same[self._spec.cosets[0]] = True
        return same

    def _fault(self, R, view, differs, wrong):
        return {
            "rotation": R.tolist(),
            "part_pixels": view.part_pixels.tolist(),
            "differs": np.flatnonzero(differs).tolist(),
            "finer": wrong.tolist(),
        }

    def _drawn_alike(self, R, group, renderer):
        """Tell for which g (n, 3, 3) R g draws the image at R (3, 3), where either shows a breaking part: (n,).

        Parts are compared in every candidate, and shades in those whose parts are in the same places.
        """
        (image,) = renderer.lit_windows(R[None])
        same, candidates = np.zeros(len(group), bool), R @ group
        for start in range(0, len(group), AT_ONCE):
            for i, drawn in enumerate(renderer.label_windows(candidates[start : start + AT_ONCE]), start=start):
                same[i] = self._differing_points(image, drawn) / 4 < self._spec.tolerance_px
        shows = self._is_breaking[image.ids].any()
        (open_,) = np.nonzero(same & shows)  # what shows nothing has no shades
        for start in range(0, len(open_), AT_ONCE):
            some = open_[start : start + AT_ONCE]
            for i, drawn in zip(some, renderer.lit_windows(candidates[some]), strict=True):
                same[i] = self._differing_points(image, drawn) / 4 < self._spec.tolerance_px
        return same

    def _differing_points(self, image, other):
        """Return at how many points two drawings differ, on a canvas that holds both of their windows."""
        windows = [image.window, other.window]
        top, left = min(w.top for w in windows), min(w.left for w in windows)
        bottom, right = max(w.top + w.height for w in windows), max(w.left + w.width for w in windows)
        places = [np.s_[w.top - top : w.top - top + w.height, w.left - left : w.left - left + w.width] for w in windows]
        ids = np.zeros((2, bottom - top, right - left), np.uint8)
        for canvas, place, drawn in zip(ids, places, (image, other), strict=True):
            canvas[place] = drawn.ids
        either = self._is_breaking[ids].any(axis=0)
        differs = (ids[0] != ids[1])[either]
        if hasattr(other, "rgb"):
            rgb = np.zeros((*ids.shape, 3), np.uint8)
            for canvas, place, drawn in zip(rgb, places, (image, other), strict=True):
                canvas[place] = drawn.rgb
            differs |= np.abs(np.diff(rgb[:, either].astype(np.int16), axis=0)[0]).max(axis=-1) > LEVELS
        return np.count_nonzero(differs)

    def _hidden(self, number, many):
        """Return the first rotation, of those no other view tries, that leaves a patch out of sight."""
        for index in count(number, many):
            R = label_rotation(SEED, self._spec.name, "test", index)
            if not all(self._shows(R, patch) for patch in range(self._patches.max() + 1)):
                return R
        raise AssertionError("rotations do not end")

    def _grazing(self, number):
        """Return a rotation beside the horizon of a patch, or where the picture loses its last point."""
        rng = np.random.default_rng([SEED, number])
        patch = int(rng.integers(self._patches.max() + 1))
        shows = self._shows if number % 2 else self._draws
        found = {}
        for index in count():
            R = uniform_rotations(1, rng)[0]
            found[shows(R, patch)] = R
            if len(found) == 2:
                break
            if index > 200:  # something always shows: as with pips, of which one is drawn by no picture of its own
                shows = self._shows
        shown, hidden = found[True], found[False]
        axis, angle = turn_between(shown, hidden)
        low, high = 0.0, angle
        for _ in range(BISECTIONS):
            middle = (low + high) / 2
            low, high = (middle, high) if shows(rotations_about(axis, middle) @ shown, patch) else (low, middle)
        beside = np.radians(BESIDE_DEG[number % len(BESIDE_DEG)])
        return rotations_about(axis, low + beside) @ shown

    def _shows(self, R, patch):
        """Tell whether a patch is in sight: on a convex body, whether any of its triangles faces the camera."""
        if not self._is_convex:
            return self._draws(R, patch)
        camera = -self._distance * R[2]  # in model coordinates
        a, b, c = np.moveaxis(self._corners[self._patches == patch], 1, 0)
        return bool(((np.cross(b - a, c - a) * (camera - a)).sum(axis=1) > 0).any())

    def _draws(self, R, patch):
        """Tell whether a point of a patch's part is drawn."""
        if len(self._spec.mesh.breaking) == 1:
            return bool(self._renderer.marking_pixels(R[None])[0] > 0)
        part = self._parts[self._patches == patch][0]
        return bool(self._renderer.render(R).part_pixels[part - 1] > 0)


def patches_of(triangles, parts):
    """Return the number of the connected patch of one part that each triangle (T, 3) of parts (T,) belongs to: (T,)."""
    triangles = triangles + (parts * (triangles.max() + 1))[:, None]
    patch = np.arange(triangles.max() + 1)
    while True:
        least = patch[triangles].min(axis=1)
        before = patch.copy()
        np.minimum.at(patch, triangles, least[:, None])
        if np.array_equal(before, patch):
            return np.unique(patch[triangles[:, 0]], return_inverse=True)[1]


def turn_between(start, end):
    """Return the axis and the angle by which a rotation has to be turned to become another."""
    w, *vector = rotation_to_quat_wxyz(end @ start.T)
    length = np.linalg.norm(vector)
    return np.array(vector) / length, 2.0 * np.arctan2(length, w)


if __name__ == "__main__":
    main()
