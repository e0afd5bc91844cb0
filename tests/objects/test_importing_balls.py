"""Mesh files of balls: SO(3) is found within a stated distance, written down, and accepted by whoever reads it."""

import numpy as np
import pytest
from exported_meshes import mesh_bytes
from made_solids import joined, lathe

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.record import bop_model_info
from symsol_annot.objects.finding.report import report_lines
from symsol_annot.objects.finding.surface import make_surface
from symsol_annot.objects.finding.symmetries import find_symmetries
from symsol_annot.objects.importing.importing import ImportOptions, import_mesh
from symsol_annot.objects.importing.object_writing import object_files, written_object

trimesh = pytest.importorskip("trimesh")

PLACE = np.array([105.0, -36.0, 27.0])
CLAY, BLUE, RED = [200, 200, 190, 255], [20, 60, 220, 255], [230, 40, 10, 255]


def ball(fineness=3):
    made = trimesh.creation.icosphere(fineness, radius=20.0)
    return made.vertices + PLACE, made.faces


def with_bump(solid, height):
    """A ball of which the vertices near one end of its x axis are pulled out."""
    vertices = solid[0] - PLACE
    is_near = vertices[:, 0] > 19.0
    return np.where(is_near[:, None], vertices * (1.0 + height), vertices) + PLACE, solid[1]


def colours_of(solid):
    directions = (solid[0][solid[1]].mean(axis=1) - PLACE) / 20.0
    painted = np.tile(CLAY, (len(directions), 1))
    painted[directions[:, 2] > 0.9] = BLUE
    painted[directions @ [0.8, 0.1, 0.59] > 0.97] = RED
    return painted.astype(np.uint8)


def surface_of(solid, part_of=None):
    part_of = np.zeros(len(solid[1]), dtype=int) if part_of is None else part_of
    return make_surface(*solid, part_of, ("body", "cap")[: part_of.max() + 1])


@pytest.fixture
def imported(tmp_path):
    def run(data, name, **options):
        (tmp_path / name).write_bytes(data)
        made = import_mesh(tmp_path / name, "marble", ImportOptions(**options))
        with written_object(tmp_path / "made", object_files(made.draft)) as (_, spec):
            return spec, made

    return run


def test_a_painted_ball_off_centre_has_all_rotations_and_its_parts(imported):
    solid = ball()
    data = mesh_bytes(solid, "ply", face_colors=colours_of(solid))
    spec, made = imported(data, "marble.ply", round_within=0.005)
    assert spec.has_all_rotations
    assert len(spec.parts) == 3
    assert spec.mesh.breaking == (2, 3)
    np.testing.assert_allclose(made.centre, PLACE, atol=1e-4)
    assert made.scale == pytest.approx(20.0, abs=1e-4)
    distances = np.linalg.norm(spec.mesh.vertices, axis=1)
    assert 1.0 - distances.min() < 1e-5  # all corners are on the sphere, so that its centre is the origin
    middles = np.linalg.norm(spec.mesh.vertices[spec.mesh.triangles].mean(axis=1), axis=1)
    assert 1.0 - middles.min() < made.found.shape.residual + 1e-6
    assert made.found.shape.residual < spec.max_offset < 0.006


def test_a_plain_ball_has_all_rotations_as_its_set(imported):
    spec, _ = imported(mesh_bytes(ball(), "stl"), "marble.stl", round_within=0.005)
    assert spec.has_all_rotations
    assert spec.marking is None


def test_facets_that_nobody_sees_need_no_option():
    assert find_symmetries(surface_of(ball(5))).shape.group.name == "SO(3)"


def test_a_ball_with_a_knob_of_its_own_has_it_as_a_part(imported):
    knob = lathe([(0, -1), (3, 0), (0, 1)], 8)
    knob = knob[0] + PLACE + [0.0, 0.0, 20.0], knob[1]
    spec, made = imported(mesh_bytes(joined(ball(), knob), "stl"), "marble.stl", round_within=0.005)
    assert spec.has_all_rotations
    assert len(spec.parts) == 2
    np.testing.assert_allclose(made.centre, PLACE, atol=1e-4)


def test_a_ball_with_a_bump_of_its_own_surface_is_told_to_make_it_a_part(imported):
    solid = with_bump(ball(), 0.1)
    found = find_symmetries(surface_of(solid), round_within=0.005)
    bumps = np.flatnonzero((np.abs(np.linalg.norm(solid[0] - PLACE, axis=1) - 20) > 0.1)[solid[1]].any(axis=1))
    assert [one.group.name for one in found.larger] == ["SO(3)"]
    np.testing.assert_array_equal(found.larger[0].taken_away, bumps)
    with pytest.raises(ObjectError, match=rf"SO\(3\), but for {len(bumps)} faces in 1 patch: make them a part"):
        imported(mesh_bytes(solid, "stl"), "marble.stl", round_within=0.005)


def test_an_ellipsoid_is_no_ball():
    vertices, triangles = ball()
    found = find_symmetries(surface_of(((vertices - PLACE) * [1, 1, 0.9], triangles)), round_within=0.005)
    assert found.shape.group.name in {"D2", "circle with half turns"}
    assert not [one for one in found.larger if one.group.name == "SO(3)"]


def test_what_is_said_of_a_ball_and_what_bop_can_say_of_it():
    surface = surface_of(ball())
    found = find_symmetries(surface, round_within=0.005)
    printed = "\n".join(report_lines(found))
    assert "group        SO(3)" in printed
    assert "no rotation carries points more than 0.0045 off it; allowed 0.005" in printed
    assert "next         no candidate is left" in printed
    circles = bop_model_info(surface, found)["symmetries_continuous"]
    np.testing.assert_allclose([one["axis"] for one in circles], np.eye(3))
    np.testing.assert_allclose([one["offset"] for one in circles], [PLACE] * 3, atol=1e-9)


def test_parts_of_a_ball_are_kept_by_turns_about_their_middles():
    vertices, triangles = lathe([(0, -1), *((np.cos(a), np.sin(a)) for a in np.linspace(-1.4, 1.4, 21)), (0, 1)], 24)
    is_cap = vertices[triangles][:, :, 2].min(axis=1) > 0.5
    found = find_symmetries(surface_of((vertices, triangles), is_cap.astype(int)), round_within=0.018)
    assert (found.shape.group.name, found.object.name) == ("SO(3)", "C24")
    assert abs(found.object.axes[0].direction[2]) == pytest.approx(1.0)
