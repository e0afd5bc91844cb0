"""Small sets for tests of the benchmark: tetX as the ray caster draws it, cylO with the disc's area by a formula."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from made_sets import make_plan, make_set, threads
from numpy_renderer import NumpyRenderer
from oracle import CAMERA_DISTANCE, CYLINDER_RADIUS, DISC_RADIUS, DISC_Z, FILLED

from symsol_annot.generation.generate import generate
from symsol_annot.sets.dataset import load

SIZE = 16
SUPPORT = Path(__file__).parent


class DiscRenderer(NumpyRenderer):
    """Draws cylO; casting rays at 720 candidates per image would take minutes, so the disc's area is summed up.

    The disc is a lattice of small patches on the cylinder; the body is convex, so a patch that faces the camera shows.
    """

    STEPS = 11

    def __init__(self, size):
        super().__init__("cylO", size)
        across = np.linspace(-DISC_RADIUS, DISC_RADIUS, self.STEPS)
        along, up = (values.ravel() for values in np.meshgrid(across, across))
        is_inside = np.hypot(along, up) < DISC_RADIUS
        angle = along[is_inside] / CYLINDER_RADIUS
        self._normals = np.stack([np.cos(angle), np.sin(angle), np.zeros(len(angle))], axis=1)
        self._points = CYLINDER_RADIUS * self._normals + np.outer(DISC_Z + up[is_inside], [0, 0, 1])
        self._patch_area = np.pi * DISC_RADIUS**2 / len(angle)
        self._focal_px = FILLED / 2 * size / np.tan(np.arcsin(1 / CAMERA_DISTANCE))

    def render(self, R_m2c):
        return replace(super().render(R_m2c), part_pixels=np.array([100.0, *self.marking_pixels(R_m2c[None])]))

    def marking_pixels(self, R_m2c):
        rays = self._points @ R_m2c.transpose(0, 2, 1) + [0, 0, CAMERA_DISTANCE]
        facing = -np.einsum("rpi,rpi->rp", self._normals @ R_m2c.transpose(0, 2, 1), rays)
        seen = np.maximum(facing, 0.0) / rays[..., 2] ** 3
        area_px = seen.sum(axis=1) * self._patch_area * self._focal_px**2
        return np.ceil(4.0 * area_px) / 4.0  # of four samples per pixel


def small_set(folder, name, images=24, seed=0):
    """Make a test split of tetX or cylO in a folder of sets, and open it."""
    if name == "cylO":
        plan = make_plan(name, test=images, size=SIZE, seed=seed)
        generate(plan, folder / name, threads(partial(DiscRenderer, SIZE), exhaustive=True))
    else:
        make_set(folder, name, test=images, size=SIZE, seed=seed)
    return load(folder / name)


class SmallDisk:
    """A disk in memory, of a size that can be changed."""

    def __init__(self, folder):
        self.folder = folder

    def resize(self, kibibytes):
        options = f"size={kibibytes}k" + (",remount" if self.folder.is_mount() else "")
        if shutil.which("mount") is None:
            pytest.skip("there is no mount, so no disk that fills up")
        mounted = run("mount", "-t", "tmpfs", "-o", options, "tmpfs", self.folder)
        if mounted.returncode != 0:
            pytest.skip(f"no tmpfs can be mounted, so there is no disk that fills up: {mounted.stderr.strip()}")

    def unmount(self):
        if self.folder.is_mount():
            subprocess.run(["umount", str(self.folder)], check=True)


def run(*command, env=None, cwd=None):
    """Run a program to its end; whatever happened, it was no traceback."""
    done = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        env={**os.environ, **(env or {})},
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        timeout=120,
        check=False,
    )
    assert "Traceback" not in done.stderr + done.stdout, done.stderr
    return done


def python(code, *arguments, env=None):
    """Run Python code that can import what lies beside the tests."""
    path = os.pathsep.join(filter(None, [str(SUPPORT), os.environ.get("PYTHONPATH")]))
    return run(sys.executable, "-W", "error", "-c", code, *arguments, env={**(env or {}), "PYTHONPATH": path})
