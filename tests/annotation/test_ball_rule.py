"""Sets of balls, against candidates drawn whole, random rotations drawn, and areas counted on fine lattices."""

import numpy as np
import pytest
from balls import CAP, CAP_FACES, FLAG, MARKED, MERIDIANS, BallRenderer, ball, ball_toml
from parted_objects import drawn_set

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.balls.hidden_directions import rotations_seen_from, visible_area_px, volume_by_geometry
from symsol_annot.annotation.symmetry_set import SymmetrySet, circles_of
from symsol_annot.annotation.volume import viewing_directions
from symsol_annot.objects.spec import load_object, read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import angle_between, uniform_rotations

CAMERA, SETTINGS = Camera.filling(16), RenderSettings()


def made(folder, toml, mesh):
    (folder / "object.toml").write_text(toml)
    (folder / "mesh.obj").write_text(mesh)
    return read_object(folder)


@pytest.fixture(scope="module")
def spec(tmp_path_factory):
    return made(tmp_path_factory.mktemp("ball"), *MARKED)


@pytest.fixture(scope="module")
def seen(spec):
    """Views of the ball with their sets: rotation, view, annotation, what drawing all candidates gives."""
    renderer = BallRenderer(spec, CAMERA)
    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, renderer)
    exhaustive = Annotator.for_object(spec, CAMERA, SETTINGS, renderer, exhaustive=True)
    found = []
    for R in uniform_rotations(9, np.random.default_rng(4)):
        view = renderer.render(R)
        shown_px = annotator.shown_px(R, view)
        annotations = (annotator.annotate(R, shown_px, view), exhaustive.annotate(R, shown_px))
        found.append((R, view, *annotations))
    return found


def test_sets_of_views_that_show_a_part_are_those_of_all_candidates_drawn_whole(spec, seen):
    renderer, sizes = BallRenderer(spec, CAMERA), set()
    for R, view, annotation, exhaustive in seen:
        np.testing.assert_array_equal(annotation.mask, exhaustive.mask)
        parts_px = view.part_pixels[1:]
        if parts_px.max() > 0:
            assert annotation.volume is None
            drawn = drawn_set(spec, renderer, R)
            assert not (annotation.mask & ~drawn).any()
            assert ((parts_px > 0) & (parts_px < 4)).any() or np.array_equal(annotation.mask, drawn)
            sizes.add(int(annotation.mask.sum()))
    assert len(sizes) >= 2


def test_parts_that_no_turn_keeps_in_place_leave_the_view_itself_where_one_of_them_shows(tmp_path):
    corner = np.array([0, 1, MERIDIANS])  # three faces around a corner
    paint = {"red": corner + 3 * MERIDIANS, "blue": corner + 6 * MERIDIANS + MERIDIANS // 2}
    spec = made(tmp_path, ball_toml(CAP, FLAG), ball(paint))
    assert len(spec.symmetry_group) == 1
    renderer = BallRenderer(spec, CAMERA)
    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, renderer)
    shown = set()
    for R in rotations_seen_from(np.array([[0.9, 0.3, 0.3], [-0.9, -0.3, -0.3]])):
        view = renderer.render(R)
        shown.add(tuple(view.part_pixels[1:] > 0))
        annotation = annotator.annotate(R, annotator.shown_px(R, view), view)
        assert annotation.mask.tolist() == [True]
        assert annotation.volume is None
    assert shown == {(True, False), (False, True)}


def test_views_that_show_nothing_have_one_and_the_same_volume_and_themselves_as_members(seen):
    hidden = [annotation for _, view, annotation, _ in seen if view.part_pixels[1:].max() == 0]
    assert len(hidden) >= 2
    assert all(annotation.volume is hidden[0].volume for annotation in hidden)
    assert all(annotation.mask.sum() == 1 for annotation in hidden)
    assert all(annotation.mask[0] for annotation in hidden)


def test_the_measure_is_the_share_of_directions_that_hide_everything(spec):
    volume = volume_by_geometry(spec.mesh, CAMERA, 0.125)
    directions = np.random.default_rng(0).normal(size=(20_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    share = float((visible_area_px(spec.mesh, CAMERA, directions) < 0.125).mean())
    assert abs(share - volume.measure) < 3 * np.sqrt(volume.measure * (1 - volume.measure) / len(directions))


def test_the_area_that_shows_is_what_a_fine_lattice_counts_whatever_the_turn_about_the_line_of_sight(spec):
    camera = Camera.filling(48)
    renderer, R = BallRenderer(spec, camera), uniform_rotations(3, np.random.default_rng(2))
    area_px = visible_area_px(spec.mesh, camera, -R[:, 2])
    counted_px = renderer.marking_pixels(R)
    assert counted_px.max() > 40
    np.testing.assert_allclose(area_px, counted_px, rtol=0.03, atol=2.0)
    turned = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]]) @ R
    np.testing.assert_allclose(visible_area_px(spec.mesh, camera, -turned[:, 2]), area_px, atol=1e-9)


def test_rotations_seen_from_directions_see_the_object_from_there():
    directions = viewing_directions().reshape(-1, 3)[::500]
    R = rotations_seen_from(directions)
    np.testing.assert_allclose(-R[:, 2], directions, atol=1e-12)
    np.testing.assert_allclose(R @ np.swapaxes(R, 1, 2), np.tile(np.eye(3), (len(R), 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(R), 1.0)


def test_a_plain_ball_has_all_rotations_and_is_not_drawn_again(tmp_path):
    spec = made(tmp_path, ball_toml(), ball())
    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, None)
    annotation = annotator.annotate(np.eye(3), 0.0)
    assert annotation.volume.measure == 1.0
    assert annotation.mask.tolist() == [True]


def test_a_ball_with_one_part_has_that_parts_turns_where_it_shows_and_beside_the_volume_where_it_hides(tmp_path):
    spec = made(tmp_path, ball_toml(CAP), ball({"red": CAP_FACES}))
    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, BallRenderer(spec, CAMERA))
    shown = annotator.annotate(np.diag([1.0, -1.0, -1.0]), 9.0)
    assert shown.mask.all()
    assert shown.volume is None
    hidden = annotator.annotate(np.eye(3), 0.0)
    assert hidden.mask.all()
    assert 0.2 < hidden.volume.measure < 0.6
    assert hidden.volume.contains(np.eye(3)[None] @ spec.symmetry_group).all()


def test_parts_that_stand_out_of_a_ball_have_the_volume_that_drawing_gives(tmp_path, monkeypatch):
    """No geometry is asked: of each direction the renderer counts what shows."""
    spec = made(tmp_path, *MARKED)
    monkeypatch.setattr("symsol_annot.annotation.balls.hidden_directions.is_convex", lambda mesh: False)

    class Counting:
        def marking_pixels(self, R):
            return np.where(R[:, 2, 2] > 0.5, 0.0, 3.0)

    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, Counting())
    assert annotator.annotate(np.eye(3), 0.0).volume.measure == pytest.approx(0.25, abs=0.01)


def test_distances_to_sets_over_a_list_of_candidates_are_those_to_the_nearest_member():
    """The list is no group: a circle about one axis, and turns about another that lie on none."""
    group, rng = load_object("sphereX").symmetry_group, np.random.default_rng(6)
    circles = circles_of(group)
    assert circles.index.shape == (1, 360)
    assert circles.isolated_index.tolist() == [1, 2, 3]
    mask = rng.random(len(group)) < 0.3
    mask[[0, 2]] = True
    found, R = SymmetrySet(uniform_rotations(1, rng)[0], group, mask), uniform_rotations(40, rng)
    expected = angle_between(R[:, None], found.members).min(axis=1)
    np.testing.assert_allclose(found.distance(R), expected, atol=1e-9)
    assert len(found.along_arcs) == mask.sum()
