"""Real Blender against the ray caster, and the looks of what it draws."""

import resource
from pathlib import Path

import numpy as np
import pytest
from oracle import DISC_Z, boundary, cast, cast_samples

from symsol_annot.objects.spec import PUBLISHED_NAMES, load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations
from symsol_annot.sets.plan import label_rotation

pytestmark = pytest.mark.blender


def open_renderer(name, size=224, engine="opengl"):
    return RenderProcess(load_object(name), Camera.filling(size), RenderSettings(engine))


def rotations(count, seed):
    return uniform_rotations(count, np.random.default_rng(seed))


def reddish(rgb):
    return rgb[..., 0] > rgb[..., 2]


def redder(rgb, than):
    """How much redder, less blue, each pixel is than another drawing's."""
    return rgb[..., 0].astype(int) - rgb[..., 2] - (than[..., 0].astype(int) - than[..., 2])


def anywhere_in_pixels(samples):
    """Whether any of a pixel's nine samples, or of their neighbours, is set: (2 H + 1, 2 W + 1) to (H, W)."""
    wide = np.pad(samples, 1)
    shifted = [wide[i:, j:][: samples.shape[0] - 1 : 2, : samples.shape[1] - 1 : 2] for i in range(5) for j in range(5)]
    return np.any(shifted, axis=0)


@pytest.mark.parametrize("name", PUBLISHED_NAMES)
def test_segmentation_is_the_ray_casters_but_for_boundary_pixels(name):
    with open_renderer(name) as renderer:
        for R in rotations(4, seed=11):
            drawn, expected = renderer.render(R).segmentation, cast(name, R)
            differs = drawn != expected
            assert not (differs & ~boundary(expected)).any()
            assert differs.sum() <= 6


@pytest.mark.parametrize("name", ["tetX", "cylO"])
def test_marking_pixels_are_the_ray_casters_within_a_sample_or_two(name):
    with open_renderer(name) as renderer:
        R = rotations(40, seed=3)
        R = R[np.argsort(-renderer.marking_pixels(R))[[0, 4, 8, -1]]]
        expected = np.array([np.count_nonzero(cast_samples(name, one) == 2) for one in R])
        assert expected.any()
        assert np.abs(4 * renderer.marking_pixels(R) - expected).max() <= 3


def test_counted_samples_are_the_ones_that_colour_the_rgb():
    """A view whose count is 0 is no redder anywhere than the body without its disc; one of a single sample is.

    A sample on a pixel's corner is worth a sixteenth of it: 5 levels or more. One more sample of white at an edge: 3.
    """
    with open_renderer("cylO", size=112) as renderer, open_renderer("cyl", size=112) as unmarked:
        R = rotations(700, seed=8)
        pixels = renderer.marking_pixels(R)
        order = np.argsort(pixels)
        first = np.searchsorted(pixels[order], 0.1)
        assert pixels[order[first]] <= 0.5  # a sample or two
        for i in order[first - 40 : first + 40]:
            trace = redder(renderer.render(R[i]).rgb, unmarked.render(R[i]).rgb).max()
            assert (trace > 4) == (pixels[i] > 0)


@pytest.mark.parametrize(("engine", "size"), [("opengl", 224), ("workbench", 224), ("cycles", 64)])
def test_rgb_edges_have_sixteenth_steps_and_the_faces_one_shade(engine, size):
    """A face towards the camera on white: pure face, pure white, and mixtures of nine samples whose weights are 16."""
    towards_camera = np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]]) @ np.eye(3)
    turn = np.radians(10)
    in_plane = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    with open_renderer("cube", size=size, engine=engine) as renderer:
        red = renderer.render(in_plane @ towards_camera).rgb[..., 0]
    face = int(red[size // 2, size // 2])
    mixtures = np.array([(k * face + (16 - k) * 255 + 8) // 16 for k in range(17)])
    step = np.abs(red[..., None].astype(int) - mixtures)
    assert step.min(axis=-1).max() <= 1  # an interpolated colour may round the other way
    assert len(set(step.argmin(axis=-1).ravel().tolist())) >= 10
    inside = np.abs(red.astype(int) - face) <= 1
    assert inside.mean() > 0.2
    assert (red == 255).mean() > 0.2


def test_a_view_holds_the_same_samples_as_a_count_and_its_ids_are_every_second_one():
    """The picture is averaged from the samples that the ray caster meets, and the segmentation is at their centres."""
    R = rotations(1, seed=31)[0]
    ids = cast_samples("tetX", R, 224)
    with open_renderer("tetX") as renderer:
        view = renderer.render(R)
        assert view.marking_pixels == renderer.marking_pixels(R[None])[0]
    inside = ~anywhere_in_pixels(boundary(ids))
    assert np.array_equal(view.segmentation[inside], ids[1::2, 1::2][inside])
    assert ((view.rgb[inside] == 255).all(axis=-1) == (view.segmentation[inside] == 0)).all()


@pytest.mark.parametrize("engine", ["opengl", "workbench", "cycles"])
def test_faces_are_lit_by_the_cosine_to_the_camera_axis(engine):
    settings = RenderSettings()
    R = rotations(3, seed=21)
    with open_renderer("cube", engine=engine, size=96) as renderer:
        for one in R:
            view = renderer.render(one)
            for normal in np.concatenate([np.eye(3), -np.eye(3)]):
                turned = one @ normal
                centre = Camera.filling(96).project(turned / 3**0.5)
                if turned @ (turned / 3**0.5 + [0, 0, 4]) < -0.3:  # well in view
                    light = settings.ambient + settings.diffuse * -turned[2]
                    linear = np.array(settings.body_colour) * light
                    srgb = 255 * np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
                    found = view.rgb[int(centre[1]), int(centre[0])]
                    assert np.abs(found - srgb).max() <= 1


def test_engines_draw_the_same_segmentation_but_for_boundary_pixels():
    """Blender's render pipeline, which tells ids from greys in a frame of their own, is a check on the shader."""
    R = rotations(12, seed=41)
    with open_renderer("cylO") as ours, open_renderer("cylO", engine="workbench") as blenders:
        for one in R:
            a, b = ours.render(one), blenders.render(one)
            differs = a.segmentation != b.segmentation
            assert not (differs & ~boundary(b.segmentation)).any()
            assert differs.sum() <= 4
            assert (np.abs(a.rgb.astype(int) - b.rgb).max(axis=-1) > 8).sum() <= 8
            assert np.abs(a.part_pixels - b.part_pixels).max() <= 1.0


def test_background_is_white_and_body_never_reddish():
    with open_renderer("cyl") as renderer:
        view = renderer.render(rotations(1, seed=4)[0])
    outside = (view.segmentation == 0) & ~boundary(view.segmentation)
    assert (view.rgb[outside] == 255).all()
    assert not reddish(view.rgb).any()


@pytest.mark.parametrize(("marked", "unmarked"), [("cylO", "cyl"), ("tetX", "tet")])
def test_a_marked_body_has_the_unmarked_ones_silhouette_and_shading(marked, unmarked):
    R = rotations(5, seed=17)
    with open_renderer(marked) as a, open_renderer(unmarked) as b:
        for one in R:
            with_marking, without = a.render(one), b.render(one)
            assert np.array_equal(with_marking.segmentation > 0, without.segmentation > 0)
            far_from_marking = ~anywhere_in_pixels(cast_samples(marked, one) == 2)
            steps = np.abs(with_marking.rgb.astype(int) - without.rgb)[far_from_marking].max(axis=-1)
            assert (steps > 2).sum() <= 4


def test_a_cylinder_looks_the_same_under_its_group():
    group = load_object("cyl").symmetry_group
    R = rotations(1, seed=2)[0]
    with open_renderer("cyl") as renderer:
        first = renderer.render(R)
        for g in group[[1, 90, 359, 360, 437]]:
            other = renderer.render(R @ g)
            assert (other.segmentation != first.segmentation).sum() <= 2
            assert (np.abs(other.rgb.astype(int) - first.rgb).max(axis=-1) > 2).sum() <= 4


def test_hidden_faces_draw_no_pixel():
    """Without back-face culling, depth ties at silhouettes let pixels of a hidden face through."""
    marked_normal = -np.ones(3) / 3**0.5
    R = rotations(300, seed=6)
    turned = R @ marked_normal
    away = (turned * (turned / 3 + [0, 0, 4])).sum(axis=1) > 0.02  # the face looks away from the camera
    with open_renderer("tetX") as renderer:
        assert renderer.marking_pixels(R[away]).max() == 0
        assert renderer.marking_pixels(R[~away]).max() > 0


def test_the_discs_visible_share_is_what_its_geometry_predicts():
    """A point of the side faces the camera where its normal does; the disc shows where any of it does."""
    angle = 2 * np.pi * np.arange(720) / 720
    radius = 1 / np.hypot(1, 1.15)
    azimuth, height = 0.2 * np.cos(angle), DISC_Z + 0.2 * radius * np.sin(angle)
    normals = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros(720)], axis=1)
    points = radius * normals + height[:, None] * [0, 0, 1]
    z = 2 * np.arange(4000) / 4000 - 1 + 1 / 4000
    golden = np.pi * (3 - 5**0.5) * np.arange(4000)
    cameras = 4 * np.stack([np.sqrt(1 - z**2) * np.cos(golden), np.sqrt(1 - z**2) * np.sin(golden), z], axis=1)
    facing = (cameras @ normals.T - (points * normals).sum(axis=1) > 0).any(axis=1)
    predicted = facing.mean()
    count = 2000
    R = np.stack([label_rotation(0, "cylO", "test", i) for i in range(count)])
    with open_renderer("cylO") as renderer:
        shown = (renderer.marking_pixels(R) > 0).mean()
    assert 0.40 < predicted < 0.50
    assert abs(shown - predicted) < 3 * np.sqrt(predicted * (1 - predicted) / count)


def resident_mib(pid):
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20


def test_memory_stays_flat_over_5000_renders():
    """Ten rounds of 40 views (three frames each) and 400 counts; the first round fills caches."""
    with open_renderer("cylO", size=64) as renderer:
        R = rotations(400, seed=9)
        resident = []
        for _ in range(10):
            renderer.marking_pixels(R)
            for one in R[:40]:
                renderer.render(one)
            resident.append((resident_mib(renderer.pid), resident_mib("self")))
    growth = np.subtract(resident[-1], resident[0])
    assert growth.max() < 8, f"MiB of Blender and of this process: {resident}"
