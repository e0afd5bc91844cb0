"""`symsol-annot symmetries`: what it prints, and that what it writes holds."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from made_solids import SOLIDS, joined, lathe, prism, torus
from symsol_annot_cli.main import app

from symsol_annot.errors import ObjectError, OutputError
from symsol_annot.objects.checking.check import check_object
from symsol_annot.objects.mesh_files.reading import read_surface
from symsol_annot.objects.spec import read_object
from symsol_annot.objects.surface import distance_to_triangles


def obj_text(solid, materials=None):
    lines = [f"v {x!r} {y!r} {z!r}" for x, y, z in (solid[0] * 20 + [3, 4, 5]).tolist()]
    for index, (a, b, c) in enumerate((solid[1] + 1).tolist()):
        lines += [f"usemtl {materials[index]}"] if materials else []
        lines.append(f"f {a} {b} {c}")
    return "\n".join(lines) + "\n"


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Write a solid into part.obj, run the command on it, and return what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(solid, *words, materials=None):
        (tmp_path / "part.obj").write_text(obj_text(solid, materials))
        done = CliRunner().invoke(app, ["symmetries", "part.obj", *words], catch_exceptions=False)
        assert done.exit_code == 0, done.output
        return done.stdout

    return run


def test_it_prints_group_axes_certainty_and_what_is_left(call):
    printed = call(SOLIDS["screw of 64 facets with a socket"][0])
    assert "group        C2, 2 rotations" in printed
    assert "  axis       (0, 0, 1), 2-fold" in printed
    assert "fixed point  (3, 4, 5.5" in printed
    assert "larger       circle, but for 12 faces in 1 patch" in printed
    assert "make them a part" in printed


def test_json_holds_all_that_is_printed(call):
    found = json.loads(call(SOLIDS["cup 64"][0], "--json"))
    assert (found["shape"]["group"], found["shape"]["rotations"]) == ("C64", 64)
    assert found["round"]["group"] == "circle"
    assert found["shape"]["bound"] <= found["tolerance"] == 1e-4


def test_a_can_of_facets_is_round_where_the_option_that_it_names_is_given(call):
    option = call(SOLIDS["can 64"][0]).split("--round-within ")[1].split()[0]
    assert "group        circle with half turns" in call(SOLIDS["can 64"][0], "--round-within", option)


@pytest.mark.parametrize("name", ["nut", "pyramid 5", "snub cube", "pyritohedron", "roof", "dodecahedron"])
def test_the_folder_that_it_writes_is_an_object_whose_geometry_has_the_group(call, tmp_path, name):
    call(SOLIDS[name][0], "--write", "made")
    spec = read_object(tmp_path / "made")
    check_object(spec)
    assert len(spec.symmetry_group) == json.loads(call(SOLIDS[name][0], "--json"))["shape"]["rotations"]


def test_an_object_with_a_painted_end_is_written_with_its_parts_and_has_the_body_s_group(call, tmp_path):
    vertices, triangles = prism(6)
    is_end = np.isclose(vertices[triangles][:, :, 2].min(axis=1), vertices[:, 2].max())
    solid = vertices, np.concatenate([triangles[~is_end], triangles[is_end]])
    materials = ["wood"] * int((~is_end).sum()) + ["paint"] * int(is_end.sum())
    printed = call(solid, materials=materials)
    assert "with parts   C6, 6 rotations" in printed
    (tmp_path / "part.obj").write_text(obj_text(solid, materials))
    done = CliRunner().invoke(app, ["symmetries", "part.obj", "--write", "made"])
    assert done.exit_code == 0, done.output
    spec = read_object(tmp_path / "made")
    assert [part.name for part in spec.parts] == ["wood", "paint"]
    assert (len(spec.symmetry_group), len(spec.stabiliser)) == (12, 6)


def test_a_folder_that_is_there_is_not_touched(call, tmp_path):
    (tmp_path / "made").mkdir()
    (tmp_path / "made" / "mine").write_text("mine")
    (tmp_path / "part.obj").write_text(obj_text(SOLIDS["box"][0]))
    done = CliRunner().invoke(app, ["symmetries", "part.obj", "--write", "made"])
    assert isinstance(done.exception, OutputError)
    assert [path.name for path in (tmp_path / "made").iterdir()] == ["mine"]


def test_bop_symmetries_map_the_mesh_onto_itself_in_its_own_unit_and_place(call, tmp_path):
    call(SOLIDS["nut"][0], "--bop", "models_info.json", "--id", "7")
    info = json.loads((tmp_path / "models_info.json").read_text())["7"]
    assert len(info["symmetries_discrete"]) == 11
    surface = read_surface(tmp_path / "part.obj")
    for matrix in np.array(info["symmetries_discrete"]).reshape(-1, 4, 4):
        moved = surface.vertices @ matrix[:3, :3].T + matrix[:3, 3]
        assert distance_to_triangles(moved, surface.corners).max() < 1e-6
    assert info["diameter"] == pytest.approx(20 * np.hypot(1.8, 0.6))
    assert info["size_z"] == pytest.approx(12)


def test_bop_s_continuous_symmetry_has_the_axis_and_its_place(call, tmp_path):
    call(SOLIDS["cup 64"][0], "--round-within", "0.001", "--bop", "models_info.json")
    (entry,) = json.loads((tmp_path / "models_info.json").read_text())["1"]["symmetries_continuous"]
    assert np.allclose(np.abs(entry["axis"]), [0, 0, 1])
    assert np.allclose(entry["offset"][:2], [3, 4])


def test_of_a_ball_an_object_is_written_and_what_bop_cannot_say_is_said(call, tmp_path):
    angles = np.linspace(0, np.pi, 25)
    profile = [(0, -1), *zip(np.sin(angles[1:-1]), -np.cos(angles[1:-1]), strict=True), (0, 1)]
    words = ["--round-within", "0.01", "--bop", "models_info.json", "--write", "made"]
    printed = call(lathe(profile, 32), *words)
    assert "BOP cannot list SO(3)" in printed
    assert len(json.loads((tmp_path / "models_info.json").read_text())["1"]["symmetries_continuous"]) == 3
    assert read_object(tmp_path / "made").has_all_rotations


def test_other_models_in_the_file_stay_and_a_file_of_another_kind_is_not_touched(call, tmp_path):
    path = tmp_path / "models_info.json"
    path.write_text('{"3": {"diameter": 5}}')
    call(SOLIDS["box"][0], "--bop", "models_info.json")
    assert set(json.loads(path.read_text())) == {"1", "3"}
    path.write_text("[]")
    done = CliRunner().invoke(app, ["symmetries", "part.obj", "--bop", "models_info.json"])
    assert isinstance(done.exception, ObjectError)
    assert path.read_text() == "[]"


def test_a_part_is_named_where_what_is_left_without_it_has_a_larger_group(call):
    points, faces = torus(24, 8)
    cup, handle = (
        lathe([(0, -1), (0.7, -1), (0.7, 1), (0, 0.9)], 60),
        (points[:, [0, 2, 1]] * 0.4 + [0.75, 0, 0], faces),
    )
    materials = ["clay"] * len(cup[1]) + ["handle"] * len(handle[1])
    assert "larger       circle, but for the part 'handle'" in call(joined(cup, handle), materials=materials)


@pytest.mark.parametrize(
    ("name", "what"), [("none.stl", "no such file"), ("part.step", "expected a mesh file that ends")]
)
def test_what_cannot_be_read_is_one_clear_error(tmp_path, monkeypatch, name, what):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "part.step").write_text("")
    done = CliRunner().invoke(app, ["symmetries", name])
    assert isinstance(done.exception, ObjectError)
    assert what in str(done.exception)
