"""`symsol-annot import-object`, and `render --object FILE`: from a mesh file to an object and a set."""

import json

import numpy as np
import pytest
from click.testing import CliRunner
from command_line import symsol
from exported_meshes import cuboid, mesh_bytes, moved, mug
from PIL import Image
from symsol_annot_cli.main import app

import symsol_annot
from symsol_annot.errors import ObjectError, OutputError, RendererMissingError
from symsol_annot.objects.spec import read_object
from symsol_annot.plotting import object_sheet

pytest.importorskip("trimesh")


@pytest.fixture
def call(tmp_path, monkeypatch):
    """Run import-object in an empty folder with a mesh file, on a machine that cannot draw."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(object_sheet, "RenderProcess", _cannot_draw)
    (tmp_path / "mug.stl").write_bytes(mesh_bytes(moved(mug()), "stl"))
    (tmp_path / "box.stl").write_bytes(mesh_bytes(cuboid(), "stl"))
    return lambda *words: CliRunner().invoke(app, ["import-object", *words])


def _cannot_draw(*_):
    raise RendererMissingError("no Blender here")


def test_it_says_what_it_found_and_did_and_what_comes_next(call, tmp_path):
    done = call("mug.stl", "--out", "my mug")
    assert done.exit_code == 0, done.output
    for line in (
        "group        C24, 24 rotations",
        "round        circle within 0.0",
        "part 2       component-2: 144 triangles, breaks the symmetry",
        "symmetries   1 of 24 rotations leave all parts in place",
        "mended       components were made parts",
        "wrote my mug: object.toml, mesh.obj of 'my-mug'",
        "no picture of it, which cannot be drawn here: no Blender here",
        "symsol-annot render --object 'my mug' --train 0 --test 100",
    ):
        assert line in done.stdout
    assert {path.name for path in (tmp_path / "my mug").iterdir()} == {"object.toml", "mesh.obj", "files.sha256"}
    assert read_object(tmp_path / "my mug").name == "my-mug"


def test_a_built_in_object_s_name_is_not_taken(call, tmp_path):
    assert call("box.stl", "--out", "cube").exit_code == 0
    assert read_object(tmp_path / "cube").name == "cube-mesh"


def test_the_options_are_obeyed(call, tmp_path):
    done = call("mug.stl", "--out", "a", "--parts", "component", "--body", "component-2", "--name", "grip")
    assert done.exit_code == 0, done.output
    spec = read_object(tmp_path / "a")
    assert (spec.name, spec.parts[0].name) == ("grip", "component-2")


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["mug.stl", "--out", "a", "--name", "a b"], "--name: expected 1 to 64 letters"),
        (["mug.stl", "--out", "a", "--id", "3"], "--id is for a folder of BOP's models"),
        (["mug.stl", "--out", "a", "--parts", "materials"], "did you mean 'material'?"),
        (["mug.stl"], "Missing option '--out'"),
    ],
)
def test_a_fault_of_the_command_line_is_one(call, tmp_path, words, what):
    done = call(*words)
    assert done.exit_code == 2
    assert what in done.output
    assert {path.name for path in tmp_path.iterdir()} == {"box.stl", "mug.stl"}


def test_a_folder_of_bop_s_models_is_imported_and_compared(call, tmp_path):
    models = tmp_path / "models"
    models.mkdir()
    (models / "obj_000002.ply").write_bytes(mesh_bytes(cuboid(), "ply"))
    (models / "models_info.json").write_text(json.dumps({"2": {"diameter": 2.0}}))
    done = call("models", "--id", "2", "--out", "a")
    assert isinstance(done.exception, ObjectError)
    assert "states no symmetry, and the mesh has D2" in str(done.exception)
    assert not (tmp_path / "a").exists()
    assert call("models", "--id", "2", "--out", "a", "--ignore-bop").exit_code == 0


def test_a_folder_with_other_things_is_not_touched(call, tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "a" / "mine").write_text("mine")
    assert isinstance(call("box.stl", "--out", "a").exception, OutputError)
    assert [path.name for path in (tmp_path / "a").iterdir()] == ["mine"]


def test_other_commands_say_that_a_mesh_file_has_to_be_imported(tmp_path):
    done = CliRunner().invoke(app, ["verify", str(tmp_path), "--object", "part.stl"])
    assert done.exit_code == 2
    assert "part.stl is a mesh file: `symsol-annot import-object` makes an object of it" in done.output


def test_render_of_a_mesh_file_that_is_not_there_names_it(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = CliRunner().invoke(app, ["render", "--object", "none.stl", "--test", "2", "--train", "0"])
    assert isinstance(done.exception, ObjectError)
    assert "none.stl: no such file; expected a mesh" in str(done.exception)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.blender
def test_a_mesh_file_is_drawn_in_one_command_and_its_set_can_be_audited_and_resumed(tmp_path):
    (tmp_path / "cup.stl").write_bytes(mesh_bytes(moved(mug()), "stl"))
    words = ("render", "--object", "cup.stl", "--train", "0", "--size", "32", "--workers", "1", "--test", "2")
    done = symsol(*words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "is kept in data/cup/object" in done.stdout
    audited = symsol("verify", "data/cup", "--audit", "1", cwd=tmp_path)
    assert audited.returncode == 0, audited.stdout + audited.stderr
    assert len(symsol_annot.load(tmp_path / "data" / "cup", "test")) == 2
    assert symsol(*words, cwd=tmp_path).returncode == 0
    (tmp_path / "data" / "cup" / "object" / "mesh.obj").write_text("mine")
    refused = symsol(*words, cwd=tmp_path)
    assert refused.returncode == 1
    assert "is not the object of this set" in refused.stderr


@pytest.mark.blender
def test_the_picture_shows_every_part_of_the_object(tmp_path):
    (tmp_path / "cup.stl").write_bytes(mesh_bytes(moved(mug()), "stl"))
    assert symsol("import-object", "cup.stl", "--out", "mug", cwd=tmp_path).returncode == 0
    with Image.open(tmp_path / "mug" / "views.png") as image:
        pixels = np.asarray(image)
    assert pixels.shape == (4 * 192 + 6, 4 * 192 + 18, 3)
    for number in range(8):
        row, column = divmod(number, 4)
        tile = pixels[390 * row + 192 : 390 * row + 384, 198 * column : 198 * column + 192].reshape(-1, 3)
        shares = [np.mean((tile == colour).all(axis=1)) for colour in object_sheet.ID_COLOURS[:3]]
        assert sum(shares) == pytest.approx(1)
        assert min(shares[:2]) > 0.1
    segmentations = np.concatenate([pixels[192:384], pixels[582:774]]).reshape(-1, 3)
    assert np.mean((segmentations == object_sheet.ID_COLOURS[2]).all(axis=1)) > 0.01
