"""The engine opengl: each point's part by integer arithmetic, its light and depth by geometry, however it is drawn."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from oracle import CYLINDER_RADIUS, boundary

from symsol_annot.errors import RenderError, SettingsError
from symsol_annot.objects.spec import PUBLISHED_NAMES, load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.engines import ENGINES
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

pytestmark = pytest.mark.blender

MARKED = ["tetX", "cylO"]


def open_renderer(name, size=224, **settings):
    return RenderProcess(load_object(name), Camera.filling(size), RenderSettings("opengl", **settings))


def near_boundary(segmentation):
    return boundary(boundary(segmentation))


def rotations(count, seed):
    return uniform_rotations(count, np.random.default_rng(seed))


def integer_ids(name, R, size):
    """The part at each lattice point of a convex body, in integers: vertices at 1/256, and OpenGL's rule for edges.

    A point on an edge belongs to the triangle whose left or upper edge it is. Where projected triangles overlap, at
    the silhouette, the point may be either part; these are returned as well.
    """
    mesh, side = load_object(name).mesh, 2 * size + 1
    world = mesh.vertices @ R.T + [0.0, 0.0, 4.0]
    focal = 2 * 0.45 * size * np.sqrt(15.0)
    units = np.floor(256 * (focal * world[:, :2] / world[:, 2:] + side / 2) + 0.5).astype(np.int64)
    ids, hits = np.zeros((side, side), np.uint8), np.zeros((side, side), int)
    parts = np.zeros((side, side, 3), bool)
    for triangle, is_marking in zip(mesh.triangles, mesh.is_marking, strict=True):
        a, b, c = units[triangle]
        area = int((b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]))
        if area >= 0:  # seen from behind, or from the edge
            continue
        low = np.maximum(np.min([a, b, c], axis=0) // 256 - 1, 0)
        high = np.minimum(np.max([a, b, c], axis=0) // 256 + 2, side)
        u = 256 * np.arange(low[0], high[0]) + 128
        v = 256 * np.arange(low[1], high[1])[:, None] + 128
        inside = np.ones((len(v), len(u)), bool)
        for p, q in ((a, c), (c, b), (b, a)):  # clockwise on the screen, with v downwards
            du, dv = q - p
            edge = du * (v - p[1]) - dv * (u - p[0])
            is_top_left = dv < 0 or (dv == 0 and du > 0)
            inside &= (edge > 0) | ((edge == 0) & is_top_left)
        place = (slice(low[1], high[1]), slice(low[0], high[0]))
        ids[place][inside] = 1 + is_marking
        hits[place] += inside
        parts[place][inside, 1 + int(is_marking)] = True
    return ids, (hits > 1) & (parts.sum(axis=-1) > 1)


@pytest.mark.parametrize("name", PUBLISHED_NAMES)
def test_the_points_of_each_part_are_those_of_integer_arithmetic(name):
    size = 224
    with open_renderer(name, size) as renderer:
        for R in rotations(4, seed=13):
            ids, is_torn = integer_ids(name, R, size)
            view = renderer.render(R)
            assert np.array_equal(view.segmentation[~is_torn[1::2, 1::2]], ids[1::2, 1::2][~is_torn[1::2, 1::2]])
            counts = [(ids == part).sum() / 4 for part in range(1, len(view.part_pixels) + 1)]
            assert np.abs(view.part_pixels - counts).max() <= is_torn.sum() / 4
            assert is_torn.sum() <= 2


@pytest.mark.parametrize("size", [1030, 2048])
def test_a_lattice_wider_than_a_tile_is_drawn_without_a_seam(size):
    """2061 and 4097 points a side, in four and nine tiles."""
    R = rotations(1, seed=5)[0]
    ids, is_torn = integer_ids("tetX", R, size)
    with open_renderer("tetX", size) as renderer:
        view = renderer.render(R)
        assert not is_torn.any()
        assert np.array_equal(view.segmentation, ids[1::2, 1::2])
        assert view.marking_pixels == (ids == 2).sum() / 4 == renderer.marking_pixels(R[None])[0]


@pytest.mark.parametrize("name", MARKED)
def test_a_label_window_holds_every_point_of_the_marking_as_the_view_has_it(name):
    with open_renderer(name) as renderer:
        R = rotations(12, seed=23)
        windows, counts = renderer.label_windows(R), renderer.marking_pixels(R)
        for one, found, count in zip(R, windows, counts, strict=True):
            ids, is_torn = integer_ids(name, one, 224)
            view = renderer.render(one)
            assert view.marking_pixels == count == np.count_nonzero(found.ids == 2) / 4
            assert found.ids.shape == (found.window.height, found.window.width)
            same = ids[found.window.slices] == found.ids
            assert same[~is_torn[found.window.slices]].all()
        assert counts.max() > 0 == counts.min()


def test_no_rotations_give_no_windows_and_an_unmarked_body_has_none():
    with open_renderer("tetX", 32) as renderer:
        assert renderer.label_windows(np.zeros((0, 3, 3))) == []
    with open_renderer("cube", 32) as renderer, pytest.raises(RenderError, match="nothing to compare"):
        renderer.label_windows(np.eye(3)[None])


def test_a_round_side_is_lit_as_its_surface_is_turned():
    """Light is computed for each point from its normal, so that the shade between two corners is no straight line."""
    settings, camera = RenderSettings(), Camera.filling(224)
    with open_renderer("cyl") as renderer:
        for R in rotations(4, seed=3):
            view = renderer.render(R)
            rows, columns = np.nonzero(~near_boundary(view.segmentation) & (view.segmentation == 1))
            x, y = (columns + 0.5 - 112) / camera.focal_px, (rows + 0.5 - 112) / camera.focal_px
            rays = np.stack([x, y, np.ones_like(x)], axis=1) @ R
            start = np.array([0.0, 0.0, -4.0]) @ R
            a = (rays[:, :2] ** 2).sum(axis=1)
            half_b = rays[:, :2] @ start[:2]
            root = np.sqrt(np.maximum(half_b**2 - a * ((start[:2] ** 2).sum() - CYLINDER_RADIUS**2), 0.0))
            points = start + ((-half_b - root) / a)[:, None] * rays
            is_side = (np.abs(points[:, 2]) < 0.97 * 1.15 * CYLINDER_RADIUS) & (root > 0.1 * np.sqrt(a))
            normals = points * [1.0, 1.0, 0.0] / CYLINDER_RADIUS
            light = settings.ambient + settings.diffuse * np.maximum(0.0, -(normals @ R[2]))
            linear = light[:, None] * settings.body_colour
            srgb = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
            off = np.abs(view.rgb[rows, columns] - srgb)[is_side]
            assert is_side.sum() > 1000
            assert off.max() <= 1.5  # half a level of rounding, and what the average over a pixel bends


def test_normals_are_interpolated_on_the_surface_and_not_in_the_picture():
    """On a tetrahedron whose corners have the normals of a ball, the two differ by many levels."""
    tetrahedron, camera, settings = load_object("tet"), Camera.filling(224), RenderSettings()
    mesh = tetrahedron.mesh
    normals = mesh.vertices / np.linalg.norm(mesh.vertices, axis=1, keepdims=True)
    smooth = replace(tetrahedron, mesh=replace(mesh, corner_normals=normals[mesh.triangles]))
    corners = mesh.vertices[mesh.triangles]
    with RenderProcess(smooth, camera, settings) as renderer:
        for R in rotations(4, seed=19):
            view = renderer.render(R)
            rows, columns = np.nonzero(~near_boundary(view.segmentation) & (view.segmentation == 1))
            rays = np.stack([columns + 0.5 - 112, rows + 0.5 - 112, np.full(len(rows), camera.focal_px)], axis=1)
            rays = (rays / camera.focal_px) @ R
            start = np.array([0.0, 0.0, -4.0]) @ R
            outward = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            speed = rays @ outward.T
            steps = np.where(speed < 0, ((corners[:, 0] - start) * outward).sum(axis=1) / speed, -np.inf)
            face = steps.argmax(axis=1)
            points = start + steps.max(axis=1)[:, None] * rays
            weights = np.linalg.solve(np.swapaxes(corners[face], 1, 2), points[:, :, None])[..., 0]
            is_inside = weights.min(axis=1) > 0.1  # off the edges between faces
            turned = np.einsum("pc,pci->pi", weights, normals[mesh.triangles][face])
            cosine = -(turned @ R[2]) / np.linalg.norm(turned, axis=1)
            linear = (settings.ambient + settings.diffuse * np.maximum(0.0, cosine))[:, None] * settings.body_colour
            srgb = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
            assert is_inside.sum() > 1000
            assert np.abs(view.rgb[rows, columns] - srgb)[is_inside & (cosine > 0.3)].max() <= 4.0


@pytest.mark.parametrize("name", ["cube", "tetX", "icosa"])
def test_depth_is_the_z_of_what_is_seen_and_zero_at_the_background(name):
    mesh, camera = load_object(name).mesh, Camera.filling(96)
    with open_renderer(name, 96, depth=True) as renderer, open_renderer(name, 96) as without:
        for R in rotations(3, seed=7):
            view, plain = renderer.render(R), without.render(R)
            assert plain.depth is None
            assert np.array_equal(view.rgb, plain.rgb)
            assert (view.depth.shape, view.depth.dtype) == ((96, 96), np.float32)
            assert np.array_equal(view.depth == 0, view.segmentation == 0)
            rows, columns = np.nonzero(~boundary(view.segmentation) & (view.segmentation > 0))
            rays = np.stack([columns + 0.5 - 48, rows + 0.5 - 48, np.full(len(rows), camera.focal_px)], axis=1)
            rays /= camera.focal_px
            a, b, c = np.moveaxis(mesh.vertices[mesh.triangles] @ R.T + [0.0, 0.0, 4.0], 1, 0)
            normals = np.cross(b - a, c - a)
            facing = rays @ normals.T
            steps = np.where(facing < 0, (normals * a).sum(axis=1) / np.where(facing == 0, 1.0, facing), -np.inf)
            z = steps.max(axis=1)  # a convex body is entered through the last of the planes that face the camera
            assert np.abs(view.depth[rows, columns] - z).max() < 2e-3  # vertices stand at 1/256 of a point


def test_depth_is_refused_for_an_engine_that_has_none():
    for name in [name for name, engine in ENGINES.items() if not engine.has_depth]:
        with pytest.raises(SettingsError, match=f"depth: the engine {name} does not tell it; opengl does"):
            RenderSettings(name, depth=True)
    with pytest.raises(SettingsError, match="expected true or false"):
        RenderSettings("opengl", depth=1)


STRAY = """
import numpy as np
from symsol_annot.errors import RenderError
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.blender.opengl import OpenGLRenderer
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import Scene
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

renderer = OpenGLRenderer(Scene(load_object("tetX").mesh, Camera.filling(32), RenderSettings()))
rotations = uniform_rotations(20, np.random.default_rng(0))
whole = len(renderer.label_windows(rotations)), renderer.marking_pixels(rotations).max() > 0
renderer._parts = 1  # so that the marking's id is that of no part
for ask in (renderer.label_windows, renderer.marking_pixels):
    try:
        print(whole, ask(rotations))
    except RenderError as error:
        print(whole, error)
"""


def test_an_id_of_no_part_in_a_window_of_labels_is_an_error():
    done = subprocess.run([sys.executable, "-c", STRAY], capture_output=True, text=True, check=True)
    said = [line for line in done.stdout.splitlines() if line.startswith("(20, ")]
    assert len(said) == 2
    assert all("(20, True) Blender drew ids of no part, 2 the highest of 0 to 1" in line for line in said)
