"""Sets by geometry against sets from drawing every candidate, on real renders; exits 1 on a difference.

python tools/prove_annotation.py [--object cylO] [--hidden 400] [--grazing 200] [--processes 2] [--json FILE]

Hidden views are those of a test split of seed 0. Grazing ones are hidden too, and turned so that the marking's middle,
or the triangle that faces the camera most, is within 0.5 degrees of edge-on: where the answer hangs on a sample.
"""

import argparse
import json
import multiprocessing
import statistics
import sys
import time
from itertools import count
from pathlib import Path
from typing import cast

import numpy as np
from tqdm import tqdm

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import DEFAULT_SIZE, Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations
from symsol_annot.sets.plan import label_rotation

SEED, WITHIN_DEG, TURNS = 0, 0.5, 4
_PROVER = None  # a process's own


def main():
    """Compare view by view, and print and keep the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--object", default="cylO")
    parser.add_argument("--engine", default="opengl")
    parser.add_argument("--hidden", type=int, default=400)
    parser.add_argument("--grazing", type=int, default=200)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    found = prove(arguments)
    for name, row in found.items():
        print(f"{arguments.object}, {name}:", ", ".join(f"{key} {value}" for key, value in row.items()))
    if arguments.json:
        arguments.json.write_text(json.dumps({**vars(arguments), "json": None, "found": found}, indent=1))
    sys.exit(1 if any(row["differences"] for row in found.values()) else 0)


def prove(arguments):
    """Return the counts of each kind of view."""
    wanted = {"hidden": arguments.hidden, "grazing": arguments.grazing}
    tasks = [(kind, number, many) for kind, many in wanted.items() for number in range(many)]
    setup = (arguments.object, arguments.engine)
    with multiprocessing.get_context("spawn").Pool(arguments.processes, start, setup) as pool:
        rows = list(tqdm(pool.imap_unordered(compare, tasks), total=len(tasks), unit="view"))
    return {kind: summary([row for row in rows if row["kind"] == kind]) for kind, many in wanted.items() if many}


def summary(rows):
    """Return the sums over views, and the median times of a view with their ratio."""
    slow, fast = (statistics.median(row[key] for row in rows) for key in ("exhaustive", "geometry"))
    candidates, drawn, differences = (sum(row[key] for row in rows) for key in ("candidates", "drawn", "differences"))
    return {
        "views": len(rows),
        "candidates": candidates,
        "decided by geometry": candidates - drawn,
        "drawn": drawn,
        "drawn per view": round(drawn / len(rows), 3),
        "differences": differences,
        "exhaustive ms": round(1e3 * slow, 1),
        "geometry ms": round(1e3 * fast, 2),
        "times faster": round(slow / fast, 1),
    }


def start(name, engine):
    """Open a process's renderer."""
    global _PROVER  # noqa: PLW0603 - multiprocessing has no other place for it
    _PROVER = Prover(name, engine)


def compare(task):
    """Find one hidden view and compare its two sets."""
    return _PROVER.compare(*task)


class Counted:
    """A renderer that counts the candidates it draws."""

    def __init__(self, renderer):
        self._renderer, self.drawn = renderer, 0

    def marking_pixels(self, R_m2c):
        """Count, and draw."""
        self.drawn += len(R_m2c)
        return self._renderer.marking_pixels(R_m2c)


class Prover:
    """Annotates hidden views of one object both ways."""

    def __init__(self, name, engine):
        camera, settings = Camera.filling(DEFAULT_SIZE), RenderSettings(engine)
        self._spec = load_object(name)
        self._renderer = RenderProcess(self._spec, camera, settings)
        self._visibility = MarkingVisibility(self._spec.mesh, camera, settings)
        self._annotator = Annotator(self._spec, self._renderer)
        mesh, self._distance = self._spec.mesh, camera.distance
        a, b, c = np.moveaxis(mesh.vertices[mesh.triangles[mesh.is_marking]], 1, 0)
        normals, middles = np.cross(b - a, c - a), (a + b + c) / 3
        self._middle = _unit(normals.sum(axis=0)), mesh.marking_vertices.mean(axis=0)
        self._normals, self._middles = _unit(normals), middles

    def compare(self, kind, number, many):
        """Return how many candidates a view has, how many are drawn, how many differ, and both times in s."""
        R, pixels = self._hidden(self._rotations(kind, number, many))
        (drawn, _, slow), (decided, asked, fast) = (self._annotate(R, pixels, way) for way in (None, self._visibility))
        ways = [(set_.mask, set_.candidate_px > 0, self._is_shown(set_)) for set_ in (drawn, decided)]
        differs = np.any([one != other for one, other in zip(*ways, strict=True)], axis=0)
        return {
            "kind": kind,
            "candidates": differs.size - self._spec.cosets.shape[1],
            "drawn": asked,
            "differences": int(np.count_nonzero(differs)),
            "exhaustive": slow,
            "geometry": fast,
        }

    def _annotate(self, R, pixels, visibility):
        """Return a set, the candidates drawn for it, and the time it took."""
        counted, begun = Counted(self._renderer), time.perf_counter()
        found = Annotator(self._spec, cast("Renderer", counted), visibility).annotate(R, pixels)
        return found, counted.drawn, time.perf_counter() - begun

    def _is_shown(self, annotation):
        return self._annotator.is_shown(annotation.candidate_px)

    def _hidden(self, rotations):
        """Return the first rotation that hides the marking, and the area it shows."""
        for R in rotations:
            pixels = self._annotator.coset_px(R, float(self._renderer.marking_pixels(R[None])[0]))
            if not self._annotator.is_shown(pixels):
                return R, pixels
        raise AssertionError("rotations do not end")

    def _rotations(self, kind, number, many):
        """Yield rotations that no other view of this kind tries."""
        rng = np.random.default_rng([SEED, number])
        for index in count(number, many):
            if kind == "hidden":
                yield label_rotation(SEED, self._spec.name, "test", index)
            else:
                yield self._grazing(uniform_rotations(1, rng)[0], rng, of_middle=number % 2 == 0)

    def _grazing(self, R, rng, *, of_middle):
        """Turn a rotation until the marking's middle, or its triangle that faces the camera most, is edge-on."""
        wanted = np.pi / 2 + np.radians(rng.uniform(-WITHIN_DEG, WITHIN_DEG))
        for _ in range(TURNS):  # what faces most changes, and so does where it is
            normal, middle = self._middle if of_middle else self._facing_most(R)
            eye = _unit(np.array([0, 0, -self._distance]) - R @ middle)
            axis = np.cross(R @ normal, eye)
            angle = np.arctan2(np.linalg.norm(axis), R @ normal @ eye)
            R = rotations_about(axis, angle - wanted) @ R
        return R

    def _facing_most(self, R):
        """Return the normal and the middle of the marking's triangle that faces the camera most."""
        eyes = _unit(R.T @ np.array([0, 0, -self._distance]) - self._middles)
        best = (self._normals * eyes).sum(axis=1).argmax()
        return self._normals[best], self._middles[best]


def _unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


if __name__ == "__main__":
    main()
