"""Round bodies of facets, parts, and the larger groups of what is left without some faces."""

import numpy as np
import pytest
from made_solids import SOLIDS, joined, lathe, prism, surface_of, torus, turned

from symsol_annot.objects.finding.symmetries import find_symmetries
from symsol_annot.rotations.so3 import uniform_rotations


@pytest.mark.parametrize(("facets", "name"), [(64, "can 64"), (360, "can 360")])
def test_a_lathe_is_as_it_is_and_says_how_far_from_round(facets, name):
    found = find_symmetries(surface_of(SOLIDS[name][0]), looks_for_larger=False)
    assert found.shape.group.name == f"D{facets}"
    assert found.roundness.group.name == "circle with half turns"
    sagitta = 0.6 * (1 - np.cos(np.pi / facets)) / found.radius
    assert found.roundness.deviation == pytest.approx(sagitta, rel=0.05)


def test_a_lathe_is_round_where_that_is_allowed():
    surface = surface_of(SOLIDS["cup 64"][0])
    assert find_symmetries(surface, round_within=1e-3, looks_for_larger=False).shape.group.name == "circle"
    assert find_symmetries(surface, round_within=1e-4, looks_for_larger=False).shape.group.name == "C64"


def test_a_ball_of_facets_has_their_group_and_is_near_all_rotations():
    profile = [(0, -1), *((np.cos(a), np.sin(a)) for a in np.linspace(-np.pi / 2, np.pi / 2, 31)[1:-1]), (0, 1)]
    found = find_symmetries(surface_of(lathe(profile, 48)), round_within=0.01, looks_for_larger=False)
    assert (found.shape.group.name, found.shape.group.size) == ("SO(3)", None)
    assert found.roundness.deviation < 0.01


@pytest.mark.parametrize(
    ("name", "group", "faces"),
    [
        ("mug in one shell", "circle with half turns", 40),
        ("screw with a socket", "circle", 12),
        ("screw of 64 facets with a socket", "circle", 12),
        ("mug in two shells", "circle", 1280),
        ("cube with a bump", "O", None),
        ("cube with a dent", "O", None),
        ("cube without a corner", "O", 1),
        ("bar without a corner", "D4", 1),
        ("nut, hole of 45", "D6", 90),
        ("two odd boxes", "D4", 12),
        ("two boxes", "O", 12),
    ],
)
def test_what_is_left_without_a_handle_or_a_socket_has_a_larger_group(name, group, faces):
    found = find_symmetries(surface_of(SOLIDS[name][0]))
    assert [one.group.name for one in found.larger] == [group]
    assert len(found.larger[0].taken_away) == (
        faces or pytest.approx(10, abs=1)
    )  # some are as small as the points are far


@pytest.mark.parametrize(
    ("name", "group"), [("screw with a socket", "C360"), ("screw of 64 facets with a socket", "C64")]
)
def test_what_is_round_by_facets_has_their_group_without_the_patch(name, group):
    (larger,) = find_symmetries(surface_of(SOLIDS[name][0])).larger
    assert (larger.group.name, larger.as_it_is.name) == ("circle", group)


def test_half_turns_of_facets_are_about_their_corners():
    (larger,) = find_symmetries(surface_of(SOLIDS["mug in one shell"][0])).larger
    assert larger.as_it_is.name == "D360"
    corners = SOLIDS["mug in one shell"][0][0]
    kept = corners[np.abs(np.hypot(corners[:, 0], corners[:, 1]) - 0.7) < 1e-9]
    flipped = kept @ larger.as_it_is.rotations[360].T
    nearest = np.linalg.norm(flipped[:, None] - corners, axis=-1).min(axis=1)
    assert np.median(nearest) < 1e-4


@pytest.mark.parametrize("name", ["cube with a bump", "bar without a corner"])
def test_a_larger_group_of_flat_faces_turns_with_the_mesh(name):
    solid = SOLIDS[name][0]
    rng = np.random.default_rng(0)
    R, by, scale = uniform_rotations(1, rng)[0], rng.normal(size=3), 40.0
    as_made = find_symmetries(surface_of(solid)).larger[0]
    found = find_symmetries(surface_of(turned(solid, R, by, scale))).larger[0]
    wanted = R @ as_made.group.rotations @ R.T
    nearest = (found.group.rotations.reshape(-1, 9) @ wanted.reshape(-1, 9).T).max(axis=1)
    assert len(found.group.rotations) == len(wanted)
    assert nearest.min() > 3 - 1e-4
    np.testing.assert_allclose((found.centre - by) / scale, [0, 0, 0], atol=1e-4)  # the whole cube's, the whole bar's


@pytest.mark.parametrize("name", ["nut", "bolt", "cup 64", "prism 6", "box", "cuboctahedron"])
def test_a_body_that_shows_its_edges_wherever_faces_hide_has_no_larger_group(name):
    assert find_symmetries(surface_of(SOLIDS[name][0])).larger == ()


def test_a_handle_that_is_a_part_leaves_the_larger_group_named_with_it():
    points, faces = torus(40, 16)
    cup, handle = (
        lathe([(0, -1), (0.7, -1), (0.7, 1), (0, 0.9)], 90),
        (points[:, [0, 2, 1]] * 0.4 + [0.75, 0, 0], faces),
    )
    solid = joined(cup, handle)
    part_of = np.repeat([0, 1], [len(cup[1]), len(handle[1])])
    found = find_symmetries(surface_of(solid, part_of, ("body", "handle")))
    assert found.shape.group.name == "C1"
    assert [(one.group.name, one.what) for one in found.larger] == [("circle", "the part 'handle'")]


def dotted_prism(*marked):
    """A prism of 12 sides of which some are another part."""
    vertices, triangles = prism(12)
    centres = vertices[triangles].mean(axis=1)
    side = np.round(np.arctan2(centres[:, 1], centres[:, 0]) / (2 * np.pi) * 12 - 0.5) % 12
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    is_side = np.abs(np.cross(b - a, c - a)[:, 2]) < 1e-9
    return (vertices, triangles), (is_side & np.isin(side, marked)).astype(int)


@pytest.mark.parametrize(
    ("marked", "stabiliser"), [((0,), "C2"), ((0, 6), "D2"), ((0, 3), "C2"), ((0, 4, 8), "D3"), ((0, 1, 3), "C1")]
)
def test_stabilisers_follow_from_where_dots_are(marked, stabiliser):
    solid, part_of = dotted_prism(*marked)
    found = find_symmetries(surface_of(solid, part_of, ("body", "dots")), looks_for_larger=False)
    assert found.shape.group.name == "D12"
    assert [part.stabiliser.name for part in found.parts] == [stabiliser, stabiliser]
    assert found.object.name == stabiliser
