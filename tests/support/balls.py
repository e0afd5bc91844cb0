"""Balls of few triangles, as text and drawn: meridians and parallels, some faces painted."""

import math
from functools import partial

import numpy as np
from made_sets import threads
from mesh_renderer import MeshRenderer, N
from parted_objects import ObjText, parted_toml

from symsol_annot.generation.generate import generate
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.plan import SetPlan

MERIDIANS, PARALLELS = 24, 12
OFF = 0.02  # radii that its faces lie inside of the sphere, at most
SO3 = f'of = ["body"]\nkind = "so3"\nmax_offset = {OFF}'
RED, BLUE = [0.9, 0.1, 0.05], [0.05, 0.1, 0.9]
CAP, FLAG = ("cap", "red", RED), ("flag", "blue", BLUE)
CAP_FACES = range(MERIDIANS)  # around the z axis


def flag_faces(ring=5):
    """Four faces around the x axis, or around a point of its meridian: the first ring's is around the cap."""
    first = MERIDIANS * ring
    return [first, first + MERIDIANS - 1, first + MERIDIANS, first + 2 * MERIDIANS - 1]


def ball(paint=None, stretch=(1.0, 1.0, 1.0)):
    """A ball about the origin; face k of ring r has number r MERIDIANS + k, and ring 0 is around the z axis.

    The x axis is in the middle of the last and the first face of a ring. `paint` maps materials to faces.
    """
    corners = [(0.0, 0.0, 1.0)]
    for row in range(1, PARALLELS):
        polar = math.pi * row / PARALLELS
        for k in range(MERIDIANS):
            azimuth = 2.0 * math.pi * k / MERIDIANS
            corners.append((math.sin(polar) * math.cos(azimuth), math.sin(polar) * math.sin(azimuth), math.cos(polar)))
    corners.append((0.0, 0.0, -1.0))

    def place(row, k):
        return 0 if row == 0 else len(corners) - 1 if row == PARALLELS else 1 + (row - 1) * MERIDIANS + k % MERIDIANS

    faces = []
    for row in range(PARALLELS):
        for k in range(MERIDIANS):
            around = [place(row, k), place(row + 1, k), place(row + 1, k + 1), place(row, k + 1)]
            faces.append([corner for at, corner in enumerate(around) if corner != around[at - 1]])
    text = ObjText().add([[x * f for x, f in zip(c, stretch, strict=True)] for c in corners], faces, "clay")
    for material, numbers in (paint or {}).items():
        for number in numbers:
            text.paint(number, material)
    return str(text)


def ball_toml(*parts, group=SO3):
    """The object.toml of a ball with parts beside its body."""
    return parted_toml([("body", "clay", None), *parts], group)


MARKED = ball_toml(CAP, FLAG), ball({"red": CAP_FACES, "blue": flag_faces()})


def ball_set(folder, toml, mesh, images):
    """Make a test split of a ball's images in a folder of sets; return its folder."""
    (folder / "object.toml").write_text(toml)
    (folder / "mesh.obj").write_text(mesh)
    plan = SetPlan(read_object(folder), {"test": images}, 0, Camera.filling(16), RenderSettings(), "test")
    generate(plan, folder / "data" / plan.spec.name, threads(partial(BallRenderer, plan.spec, plan.camera)))
    return folder / "data" / plan.spec.name


def capped_set(folder):
    """Make a set of a ball with a red cap, which some of its images hide."""
    return ball_set(folder, ball_toml(CAP), ball({"red": CAP_FACES}), 6)


class BallRenderer(MeshRenderer):
    """Draws a ball, whose mesh is convex: a ray enters it at the last of the planes that it meets from outside."""

    def ids_and_rgb(self, R):
        camera, width, height = self.camera, N * self.camera.width + 1, N * self.camera.height + 1
        x, y = np.meshgrid(np.arange(width) / N, np.arange(height) / N)
        slopes = np.stack([x - camera.width / 2, y - camera.height / 2], -1).reshape(-1, 2) / camera.focal_px
        rays = np.column_stack([slopes, np.ones(len(slopes))])
        a, b, c = np.moveaxis(self._triangles @ R.T + [0, 0, camera.distance], 1, 0)
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        is_near = np.linalg.norm(slopes, axis=1) < 1.01 / np.sqrt(camera.distance**2 - 1)  # the unit sphere's disc
        speed = rays[is_near] @ normals.T
        with np.errstate(divide="ignore"):
            steps = (normals * a).sum(axis=1) / speed
        enter, leave = np.where(speed < 0, steps, -np.inf), np.where(speed > 0, steps, np.inf).min(axis=1)
        last, hit = enter.argmax(axis=1), np.full(len(rays), -1)
        hit[is_near] = np.where(enter[np.arange(len(last)), last] < leave, last, -1)
        part = self.spec.mesh.part_ids.astype(int)
        light = 0.04 + 0.96 * np.maximum(0, -normals[:, 2])
        linear = np.clip(light[:, None] * self._colours[part - 1], 0, 1)
        rgb = np.concatenate([np.round(255 * linear ** (1 / 2.2)), [[255, 255, 255]]]).astype(np.uint8)
        return np.append(part, 0)[hit].astype(np.uint8).reshape(height, width), rgb[hit].reshape(height, width, 3)
