"""What geometry says of a marking holds for what is drawn: by a ray caster, by Blender, and in whole sets."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from made_sets import make_plan, make_set, pixels_of, threads
from numpy_renderer import NumpyRenderer
from oracle import cast_samples

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.deciding import visibility_of
from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.generation.generate import generate
from symsol_annot.objects.mesh import face_planes, is_convex
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

SIZE = 48


def visibility(name, size=SIZE, engine="opengl"):
    return MarkingVisibility(load_object(name).mesh, Camera.filling(size), RenderSettings(engine))


def grazing(name, count, seed, within_deg):
    """Return rotations under which a marking's middle faces the camera by a right angle but for `within_deg`."""
    rng = np.random.default_rng(seed)
    spec = load_object(name)
    mesh = spec.mesh
    corners = mesh.vertices[mesh.triangles[mesh.is_marking]]
    middle = mesh.marking_vertices.mean(axis=0)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal = normals.sum(axis=0) / np.linalg.norm(normals.sum(axis=0))
    found = []
    for R in uniform_rotations(count, rng):
        eye = -np.array([0, 0, 4.0]) - R @ middle  # towards the camera
        eye /= np.linalg.norm(eye)
        axis = np.cross(R @ normal, eye)
        facing = np.arctan2(np.linalg.norm(axis), R @ normal @ eye)
        wanted = np.pi / 2 + np.radians(rng.uniform(-within_deg, within_deg))
        found.append(rotations_about(axis, facing - wanted) @ R)  # about the centre, so that it is nearly grazing
    return np.stack(found)


def count_with_moved_vertices(mesh, R, moves, size=SIZE):
    """Return the marking's samples as a rasteriser counts them that moves vertex k, once projected, by moves[k]."""
    lattice = Camera.filling(size).lattice(2)
    world = mesh.vertices @ R.T
    points, closeness = lattice.project(world) + moves, 1.0 / (world[:, 2] + lattice.distance)
    marked = points[np.unique(mesh.triangles[mesh.is_marking])]
    low, high = np.floor(marked.min(axis=0)) - 1, np.ceil(marked.max(axis=0)) + 1
    corners = points[mesh.triangles]
    beside = (corners.max(axis=1) >= low).all(axis=1) & (corners.min(axis=1) <= high).all(axis=1)
    (a, b), (c, d) = (corners[:, 1] - corners[:, 0]).T, (corners[:, 2] - corners[:, 0]).T
    beside &= a * d < b * c  # counter-clockwise, v downwards: the others are culled
    triangles, is_marking = mesh.triangles[beside], mesh.is_marking[beside]
    u, v = np.meshgrid(np.arange(low[0], high[0]) + 0.5, np.arange(low[1], high[1]) + 0.5)
    samples = np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    corners = points[triangles]
    after, last = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    # A corner's weight at a sample: twice the area of the triangle that the sample makes with the opposite side.
    constant = after[..., 1] * last[..., 0] - after[..., 0] * last[..., 1]
    weights = np.stack([last[..., 1] - after[..., 1], after[..., 0] - last[..., 0], constant], axis=-1)
    drawn = np.logical_and.reduce([weights[:, corner] @ samples > 0 for corner in range(3)])
    depths = ((weights * closeness[triangles, None]).sum(axis=1) / weights.sum(axis=1)[:, 2:]) @ samples
    depths[~drawn] = -np.inf
    return np.count_nonzero(is_marking[depths.argmax(axis=0)] & drawn.any(axis=0))


def test_all_built_in_bodies_are_convex_and_a_dented_one_is_not():
    for name in ("tet", "cube", "icosa", "cone", "cyl", "tetX", "cylO"):
        assert is_convex(load_object(name).mesh), name
    cube = load_object("cube").mesh
    dented = cube.vertices.copy()
    dented[0] *= 0.3
    assert not is_convex(replace(cube, vertices=dented))


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_a_ray_casters_count_lies_between_the_bounds(name):
    rotations = np.concatenate(
        [uniform_rotations(25, np.random.default_rng(0)), grazing(name, 25, seed=1, within_deg=6)]
    )
    counts = np.array([np.count_nonzero(cast_samples(name, R, SIZE) == 2) for R in rotations])
    assert len({*np.sign(counts)}) == 2  # both kinds of view were among them
    for enough in (1, 20, 10**9):
        lower, upper = visibility(name).bounds(rotations, enough)
        assert ((lower <= counts) & (counts <= upper)).all()


@pytest.mark.parametrize("name", ["tetX", "cylO"])
@pytest.mark.parametrize("shift", [0.02, 0.1])
def test_however_vertices_are_moved_the_count_lies_between_the_bounds(name, shift, monkeypatch):
    monkeypatch.setattr("symsol_annot.annotation.visibility.vertex_shift", lambda camera, settings: shift)
    mesh, rng = load_object(name).mesh, np.random.default_rng(8)
    rotations = grazing(name, 150, seed=9, within_deg=1.5 if name == "tetX" else 14)
    signs = np.sign(rng.uniform(-1, 1, (len(rotations), 4, len(mesh.vertices), 2)))
    signs[:, 0] = 0  # once as they are
    counts = np.array(
        [
            [count_with_moved_vertices(mesh, R, shift * move) for move in moves]
            for R, moves in zip(rotations, signs, strict=True)
        ]
    )
    assert (counts.min(axis=1) < counts.max(axis=1)).any()  # else the moves test nothing
    for enough in (1, 10**9):
        lower, upper = visibility(name).bounds(rotations, enough)
        assert (lower <= counts.min(axis=1)).all()
        assert (counts.max(axis=1) <= upper).all()


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_no_point_of_the_marking_is_nearer_or_farther_than_its_depths(name):
    mesh, rotations = load_object(name).mesh, uniform_rotations(50, np.random.default_rng(11))
    depths = (mesh.marking_vertices @ rotations.transpose(0, 2, 1))[..., 2] + 4.0
    near, far = visibility(name)._depths(rotations)
    assert (near <= depths.min(axis=1)).all()
    assert (depths.max(axis=1) <= far).all()


@pytest.mark.parametrize(("name", "faces"), [("tet", 4), ("cube", 6), ("icosa", 20), ("cyl", 362)])
def test_a_bodys_planes_are_those_of_its_faces_each_once(name, faces):
    normals, offsets = face_planes(load_object(name).mesh)
    assert len(normals) == len(offsets) == faces


@pytest.mark.parametrize("name", ["tetX", "cylO"])
@pytest.mark.parametrize("shift", [0.002, 1.0])
def test_a_marking_that_faces_the_camera_shows_its_area_less_its_rim_and_a_square_amid_it(name, shift, monkeypatch):
    monkeypatch.setattr("symsol_annot.annotation.visibility.vertex_shift", lambda camera, settings: shift)
    size, mesh, camera = 96, load_object(name).mesh, np.array([0, 0, -Camera.filling(96).lattice(2).distance])
    corners = mesh.vertices[mesh.triangles[mesh.is_marking]]
    middle, (a, b, c) = corners.mean(axis=(0, 1)), corners[0]
    normal = np.cross(b - a, c - a)
    facing = []
    for R in uniform_rotations(400, np.random.default_rng(10)):
        towards = camera - R @ middle
        if R @ normal @ towards > 0.6 * np.linalg.norm(normal) * np.linalg.norm(towards):
            facing.append(R)
    rotations, found = np.stack(facing), visibility(name, size)
    counts = []
    for R in rotations:
        points = Camera.filling(size).lattice(2).project(mesh.vertices @ R.T)
        amid = points[np.unique(mesh.triangles[mesh.is_marking])].mean(axis=0)
        counts.append(
            count_with_moved_vertices(mesh, R, shift * np.sign(amid - points), size)
        )  # all towards its middle
    for bound, worth in ((found._by_area, 0.1), (found._around_one_point, 0.03)):
        lower = bound(rotations, found._facing(rotations))
        assert (lower <= counts).all()
        assert (lower > worth * np.array(counts)).any()


def test_bounds_asked_for_in_full_are_close():
    rotations = uniform_rotations(40, np.random.default_rng(2))
    lower, upper = visibility("tetX", 224).bounds(rotations, 10**9)
    assert (upper - lower <= 0.01 * upper + 8).all()


def test_few_candidates_are_left_open_and_none_where_the_marking_is_far_from_the_rim():
    spec, R = load_object("cylO"), uniform_rotations(12, np.random.default_rng(3))
    areas = [visibility("cylO", 224).areas(one @ spec.symmetry_group, 0.125) for one in R]
    assert np.mean([np.isnan(a).sum() for a in areas]) < 2
    assert all(np.isfinite(a).sum() > 710 for a in areas)


def test_most_views_that_show_the_marking_are_decided_without_counting():
    spec, R = load_object("cylO"), uniform_rotations(1, np.random.default_rng(3))[0]
    lower, upper = visibility("cylO", 224).bounds(R @ spec.symmetry_group, 1)
    assert np.mean(upper[lower > 0] == np.iinfo(np.int64).max) > 0.8


def test_what_geometry_decides_is_not_drawn():
    spec, decides = load_object("tetX"), visibility("tetX", 224)
    for R in uniform_rotations(4, np.random.default_rng(6)):
        areas = decides.areas(R @ spec.symmetry_group, spec.marking.tolerance_px)
        assert not np.isnan(areas).any()
        annotation = Annotator(spec, None, decides).annotate(R, 0.0)  # there is no renderer to ask
        assert annotation.mask[spec.cosets[1:]].all(axis=1).tolist() == [
            areas[coset].max() < spec.marking.tolerance_px for coset in spec.cosets[1:]
        ]


def test_sets_annotated_by_geometry_and_by_drawing_every_candidate_have_the_same_bytes(tmp_path):
    plan = make_plan("tetX", test=40)
    by_geometry = make_set(tmp_path / "a", "tetX", test=40)
    generate(plan, tmp_path / "b" / "tetX", threads(partial(NumpyRenderer, "tetX", plan.camera.width), exhaustive=True))
    files = sorted(path.name for path in by_geometry.iterdir())
    assert files == sorted(path.name for path in (tmp_path / "b" / "tetX").iterdir())
    for name in files:
        assert (by_geometry / name).read_bytes() == (tmp_path / "b" / "tetX" / name).read_bytes()


def test_a_body_that_is_not_convex_is_annotated_by_drawing(monkeypatch):
    plan = make_plan("tetX")
    of_plan = partial(visibility_of, plan.spec, plan.camera, plan.settings)
    assert of_plan() is not None
    monkeypatch.setattr("symsol_annot.annotation.deciding.is_convex", lambda mesh: False)
    assert of_plan() is None
    monkeypatch.undo()
    assert visibility_of(load_object("tet"), plan.camera, plan.settings) is None


@pytest.mark.blender
@pytest.mark.parametrize("engine", ["opengl", "workbench", "cycles"])
@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_what_blender_counts_lies_between_the_bounds_near_grazing(name, engine):
    spec, camera, settings = load_object(name), Camera.filling(224), RenderSettings(engine)
    rotations = grazing(name, 30 if engine == "cycles" else 150, seed=4, within_deg=3)
    with RenderProcess(spec, camera, settings) as renderer:
        counts = renderer.marking_pixels(rotations) * settings.points_per_pixel
    lower, upper = MarkingVisibility(spec.mesh, camera, settings).bounds(rotations, 10**9)
    assert ((lower <= counts) & (counts <= upper)).all()
    assert (counts == 0).any()
    assert (counts > 0).any()


@pytest.mark.blender
def test_the_set_of_a_hidden_view_is_the_exhaustive_one():
    spec, camera, settings = load_object("cylO"), Camera.filling(224), RenderSettings()
    with RenderProcess(spec, camera, settings) as renderer:
        rotations = uniform_rotations(40, np.random.default_rng(5))
        hidden = next(R for R in rotations if pixels_of(spec, R, renderer) == 0)
        drawn = Annotator(spec, renderer).annotate(hidden, 0.0)
        decided = Annotator(spec, renderer, MarkingVisibility(spec.mesh, camera, settings)).annotate(hidden, 0.0)
    assert np.array_equal(drawn.mask, decided.mask)
    assert np.array_equal(drawn.candidate_px == 0, decided.candidate_px == 0)
