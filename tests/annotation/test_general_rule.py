"""The general rule, against all candidates drawn whole and compared by a formula of its own."""

import numpy as np
import pytest
from mesh_renderer import MeshRenderer
from parted_objects import TOML, drawn_set, mug, painted, parted_toml

from symsol_annot.annotation import general_rule
from symsol_annot.annotation.annotator import Annotator
from symsol_annot.objects.spec import read_object
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import rotations_about, uniform_rotations

CAMERA, SETTINGS = Camera.filling(16), RenderSettings()
D8 = 'kind = "dihedral"\norder = 8'
RED, BLUE = (0.9, 0.1, 0.1), (0.1, 0.1, 0.9)
DOTS = [("body", "clay", None), ("dots", "paint", RED)]
OBJECTS = {
    "mug": (TOML, mug()),
    "two dots opposite": (parted_toml(DOTS, D8), painted((0, "paint"), (4, "paint"))),
    "two dots a quarter turn apart": (parted_toml(DOTS, D8), painted((0, "paint"), (2, "paint"))),
    "two colours": (
        parted_toml([DOTS[0], ("left", "red", RED), ("right", "blue", BLUE)], D8),
        painted((0, "red"), (3, "blue")),
    ),
    "five pixels": (parted_toml(DOTS, D8, tolerance_px=5.0), painted((0, "paint"), (2, "paint"))),
}


@pytest.fixture
def spec_of(tmp_path):
    def made(toml, mesh):
        (tmp_path / "object.toml").write_text(toml)
        (tmp_path / "mesh.obj").write_text(mesh)
        return read_object(tmp_path)

    return made


@pytest.mark.parametrize("name", OBJECTS)
def test_sets_are_those_of_all_candidates_drawn_whole(spec_of, name):
    spec = spec_of(*OBJECTS[name])
    renderer = MeshRenderer(spec, CAMERA)
    fast, exhaustive = (
        Annotator.for_object(spec, CAMERA, SETTINGS, renderer, exhaustive=all_) for all_ in (False, True)
    )
    sizes = set()
    for R_gt in uniform_rotations(6, np.random.default_rng(3)):
        annotation = fast.annotate(R_gt, 0.0)
        whole = exhaustive.annotate(R_gt, 0.0)
        expected = drawn_set(spec, renderer, R_gt)
        np.testing.assert_array_equal(annotation.mask, expected)
        np.testing.assert_array_equal(whole.mask, expected)
        np.testing.assert_array_equal(annotation.candidate_px == 0, whole.candidate_px == 0)
        assert annotation.mask[0]
        sizes.add(int(annotation.mask.sum()))
    assert len(sizes) > 1 or name != "mug"


@pytest.mark.parametrize("R_gt", uniform_rotations(3, np.random.default_rng(3)), ids=range(3))
def test_the_exhaustive_rule_draws_every_candidate(spec_of, R_gt):
    spec = spec_of(*OBJECTS["two dots opposite"])
    renderer = MeshRenderer(spec, CAMERA)
    Annotator.for_object(spec, CAMERA, SETTINGS, renderer, exhaustive=True).annotate(R_gt, 0.0)
    assert renderer.drawn == 1 + len(spec.symmetry_group) - len(spec.stabiliser)  # which all draw R_gt's image


def test_a_handle_that_hides_leaves_all_candidates_that_hide_it(spec_of):
    spec = spec_of(TOML, mug())
    renderer = MeshRenderer(spec, CAMERA)
    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, renderer)
    behind = rotations_about([0, 1, 0], np.array([-np.pi / 2]))[0]  # x points away from the camera, z to its side
    hidden = renderer.marking_pixels(behind @ spec.symmetry_group) == 0
    assert 2 <= hidden.sum() < len(hidden)
    assert hidden[0]
    np.testing.assert_array_equal(annotator.annotate(behind, 0.0).mask, hidden)
    assert renderer.drawn == 0  # counting points is enough


def test_few_candidates_are_drawn_where_the_handle_shows(spec_of):
    spec = spec_of(TOML, mug())
    renderer = MeshRenderer(spec, CAMERA)
    front = rotations_about([0, 1, 0], np.array([0.4]))[0]
    assert renderer.marking_pixels(front[None])[0] > 1
    mask = Annotator.for_object(spec, CAMERA, SETTINGS, renderer).annotate(front, 0.0).mask
    assert mask.sum() == len(spec.stabiliser)
    assert renderer.drawn < len(mask) / 2


def test_shade_counts_where_silhouettes_are_the_same(spec_of):
    """A prism of which opposite sides are painted in one part: seen askew they fill the same outline in other light."""
    spec = spec_of(parted_toml(DOTS, 'kind = "cyclic"\norder = 8'), painted(*((k, "paint") for k in range(7))))
    renderer = MeshRenderer(spec, CAMERA)
    R_gt = rotations_about([1, 0, 0], np.array([np.pi / 2]))[0]
    rule = Annotator.for_object(spec, CAMERA, SETTINGS, renderer).general_rule
    np.testing.assert_allclose(rule.between(R_gt, R_gt[None]), 0)
    np.testing.assert_array_equal(rule.differing_px(R_gt) < spec.tolerance_px, drawn_set(spec, renderer, R_gt))


CIRCLE = 'kind = "cyclic"\norder = 36'
STRIPE = range(1, 25)  # of 36 sides: from some views both of its ends are out of sight


@pytest.fixture
def few_steps(monkeypatch):
    """Let the 36 steps of these tests stand for a circle."""
    monkeypatch.setattr(general_rule, "circles_of", lambda group: object())


def test_on_a_circle_neighbours_that_the_lattice_cannot_tell_apart_are_no_members(spec_of, few_steps):
    spec = spec_of(parted_toml(DOTS, CIRCLE), painted((0, "paint"), facets=36))
    renderer = MeshRenderer(spec, CAMERA)
    R_gt = rotations_about([1, 0, 0], np.array([np.pi / 2]))[0] @ rotations_about([0, 0, 1], np.array([0.5]))[0]
    annotator = Annotator.for_object(spec, CAMERA, SETTINGS, renderer)
    for turn in rotations_about([0, 0, 1], np.linspace(0.0, 2.0 * np.pi, 12)):
        if renderer.marking_pixels((R_gt @ turn)[None])[0] > 0:
            mask = annotator.annotate(R_gt @ turn, 0.0).mask
            assert mask.sum() == 1
            break
    else:
        pytest.fail("the dot shows nowhere")


def test_on_a_circle_a_long_stripe_has_an_arc_of_members(spec_of, few_steps):
    spec = spec_of(parted_toml(DOTS, CIRCLE), painted(*((k, "paint") for k in STRIPE), facets=36))
    renderer = MeshRenderer(spec, CAMERA)
    fast, exhaustive = (
        Annotator.for_object(spec, CAMERA, SETTINGS, renderer, exhaustive=all_) for all_ in (False, True)
    )
    upright = rotations_about([1, 0, 0], np.array([np.pi / 2]))[0]
    sizes = []
    for turn in rotations_about([0, 0, 1], 2.0 * np.pi * np.arange(0, 36, 9) / 36):
        mask = fast.annotate(upright @ turn, 0.0).mask
        np.testing.assert_array_equal(mask, exhaustive.annotate(upright @ turn, 0.0).mask)
        sizes.append(int(mask.sum()))
    assert max(sizes) > 5, sizes
    assert min(sizes) == 1, sizes
