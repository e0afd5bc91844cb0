"""The objects that ship with parts: stabilisers and sets that reasoning gives, and sets against all candidates drawn.

The box, of few triangles, is cast by numpy; the others are drawn by Blender.
"""

import numpy as np
import pytest
from mesh_renderer import MeshRenderer
from parted_objects import drawn_set

from symsol_annot.annotation.annotator import Annotator
from symsol_annot.annotation.deciding import visibility_of
from symsol_annot.annotation.standing_out import StandingOut
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

SETTINGS, COARSE, FINE = RenderSettings(), Camera.filling(16), Camera.filling(64)
GROUPS = {"mug": (360, 1), "nut": (12, 12), "screw": (360, 6), "dots": (720, 1), "die": (24, 1), "box": (8, 1)}


@pytest.mark.parametrize("name", GROUPS)
def test_group_and_stabiliser_have_the_orders_that_the_shape_gives(name):
    spec = load_object(name)
    assert spec.has_general_rule
    assert (len(spec.symmetry_group), len(spec.stabiliser)) == GROUPS[name]
    assert spec.tolerance_px == (None if name == "nut" else 0.125)


def facing(direction):
    """A rotation that turns a direction of the model towards the camera."""
    z = -np.array(direction, float) / np.linalg.norm(direction)
    x = np.cross(z, [0.3, -0.5, 0.8])
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z])


def cast(name):
    spec = load_object(name)
    renderer = MeshRenderer(spec, COARSE)
    return spec, renderer, Annotator.for_object(spec, COARSE, SETTINGS, renderer)


def size_of(annotator, R):
    return int(annotator.annotate(R, 0.0).mask.sum())


def test_a_nut_has_all_twelve_rotations_from_everywhere():
    _, renderer, annotator = cast("nut")
    assert [size_of(annotator, R) for R in uniform_rotations(5, np.random.default_rng(0))] == [12] * 5
    assert renderer.drawn == renderer.counted == 0


@pytest.mark.parametrize(
    ("direction", "size"), [([0, 0, 1], 4), ([0, 0, -1], 4), ([1, 0, 0], 2), ([0, -1, 0], 2), ([2, 0, 1], 1)]
)
def test_a_box_that_shows_one_face_can_be_turned_as_that_face_can(direction, size):
    _, _, annotator = cast("box")
    assert size_of(annotator, facing(direction)) == size


def test_sets_of_the_box_are_those_of_all_candidates_cast():
    spec, renderer, annotator = cast("box")
    for R in [*uniform_rotations(2, np.random.default_rng(5)), facing([0.1, 0.15, 1])]:
        np.testing.assert_array_equal(annotator.annotate(R, 0.0).mask, drawn_set(spec, renderer, R))


@pytest.fixture(scope="module")
def drawn():
    """Objects with a process that draws each, opened when first asked for."""
    open_ = {}

    def get(name):
        if name not in open_:
            spec = load_object(name)
            open_[name] = spec, RenderProcess(spec, FINE, SETTINGS)
        spec, renderer = open_[name]
        return spec, renderer, Annotator.for_object(spec, FINE, SETTINGS, renderer)

    yield get
    for _, renderer in open_.values():
        renderer.close()


def upright(azimuth_deg, tilt_deg=0.0):
    """The z axis up, the model's direction of an azimuth towards the camera, then tilted."""
    tilt = rotations_about([1, 0, 0], np.radians([90.0 + tilt_deg]))[0]
    return tilt @ rotations_about([0, 0, 1], np.radians([-90.0 - azimuth_deg]))[0]


def same_drawings(spec, renderer, R_gt):
    """Which candidates draw the image: ids and shades on canvases of the whole lattice; and whether it shows a part."""
    side, candidates, same, first = 2 * FINE.width + 1, R_gt @ spec.symmetry_group, [], None
    for lit in (lit for k in range(0, len(candidates), 60) for lit in renderer.lit_windows(candidates[k : k + 60])):
        ids, rgb = np.zeros((side, side), int), np.zeros((side, side, 3), int)
        ids[lit.window.slices], rgb[lit.window.slices] = lit.ids, lit.rgb
        first = first or (ids, rgb)
        either = (ids == 2) | (first[0] == 2)
        differs = either & ((ids != first[0]) | (np.abs(rgb - first[1]).max(axis=-1) > 12))
        same.append(np.count_nonzero(differs) == 0)
    return np.array(same), bool((first[0] == 2).any())


VIEWS = [
    ("mug", upright(180, 10), None),
    ("mug", upright(70, -15), 1),
    ("screw", facing([1, 0, -2]), 360),
    ("screw", facing([1, 0.3, 2]), 6),
    ("dots", upright(0), 2),
    ("dots", upright(45), 1),
    ("dots", upright(225, 20), None),
    ("die", facing([0.1, 0.13, 1]), 2),
    ("die", facing([1, -2, 3]), 1),
]


@pytest.mark.blender
@pytest.mark.parametrize(("name", "R_gt", "size"), VIEWS, ids=lambda value: value if isinstance(value, str) else "")
def test_sets_of_round_objects_are_those_of_all_candidates_drawn(drawn, name, R_gt, size):
    """On a circle, neighbours a few degrees from a member may draw the same points, and are none."""
    spec, renderer, annotator = drawn(name)
    mask = annotator.annotate(R_gt, 0.0).mask
    same, shows = same_drawings(spec, renderer, R_gt)
    if size is None:
        np.testing.assert_array_equal(mask, same)
        assert 1 < mask.sum() < len(mask)
    else:
        assert mask.sum() == size
        assert same[mask].all()
    beside = [np.roll(mask[:360], turn) for turn in range(-4, 5)]
    assert not shows or not (same[:360] & ~np.any(beside, axis=0)).any()


@pytest.mark.blender
def test_a_die_that_shows_one_face_can_be_turned_as_its_pips_can(drawn):
    """One, four and five pips by a quarter turn, two, three and six by half a turn."""
    _, _, annotator = drawn("die")
    faces = [sign * axis for axis in np.eye(3) for sign in (1, -1)]
    assert [size_of(annotator, facing(face)) for face in faces] == [2, 4, 4, 2, 2, 4]


@pytest.mark.blender
def test_a_handle_behind_the_cup_hides_to_either_side_alike(drawn):
    spec, _, annotator = drawn("mug")
    mask = annotator.annotate(upright(180), 0.0).mask
    np.testing.assert_array_equal(mask[1:], mask[:0:-1])
    assert 40 < mask.sum() < 120
    assert len(spec.parts) == 2


@pytest.mark.blender
def test_geometry_says_of_no_handle_that_it_shows_where_none_is_drawn(drawn):
    spec, _, _ = drawn("mug")
    camera = Camera.filling(224)
    assert isinstance(visibility_of(spec, camera, SETTINGS), StandingOut)
    assert visibility_of(load_object("screw"), camera, SETTINGS) is None
    R = uniform_rotations(300, np.random.default_rng(2))
    with RenderProcess(spec, camera, SETTINGS) as fine:
        shows, said = fine.marking_pixels(R) > 0, visibility_of(spec, camera, SETTINGS).areas(R, 0.125)
    assert shows[said > 0].all()
    assert np.isnan(said[~shows]).all()
    assert 0.5 < np.count_nonzero(said > 0) / np.count_nonzero(shows) < 1
    assert np.isnan(visibility_of(spec, camera, SETTINGS).areas(R, 5.0)).all()
