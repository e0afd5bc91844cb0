"""A wrong command line ends with exit code 2, wrong input or data with 1; each is named, with what to do."""

import re

import pytest
from command_line import NUMPY_SET, TINY_SET, contents, edit, symsol

# A wrong command line: exit code 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--object", "tetx"], "Did you mean 'tetX'"),
        (["--object", "tetX", "--train", "0", "--test", "0"], "--train and --test are both 0"),
    ],
)
def test_render_refuses_a_wrong_command_line_and_makes_nothing(tmp_path, words, said):
    done = symsol("render", *words, cwd=tmp_path)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["--object", "cylo"], "'cylO'"),
        (["--object", "no/such/folder"], "unknown object 'no/such/folder'"),
        ([], "--object"),
        (["--object", "tetX", "--train", "-1"], "--train"),
        (["--object", "tetX", "--test", "-5000"], "--test"),
        (["--object", "tetX", "--seed", "-1"], "--seed"),
        (["--object", "tetX", "--engine", "povray"], "'opengl', 'workbench', 'cycles', 'eevee'"),
        (["--object", "tetX", "--annotate", "some"], "'all', 'test', 'none'"),
        (["--object", "tetX", "--size", "15"], "16<=x<=2048"),
        (["--object", "tetX", "--size", "2049"], "16<=x<=2048"),
        (["--object", "tetX", "--size", "big"], "--size"),
        (["--object", "tetX", "--workers", "0"], "--workers"),
    ],
)
def test_render_refuses_each_wrong_option_by_its_name(here, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    done = here("render", *words)
    assert done.returncode == 2
    assert said in done.stderr
    assert done.stdout == ""
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["rendr"], "rendr"),
        (["verify"], "DATA"),
        (["verify", "DATA", "--audit", "0"], "--audit"),
        (["verify", "DATA", "--audit", "1", "--object", "tety"], "Did you mean"),
        (["plot", "images", "DATA", "--split", "validation"], "--split"),
        (["plot", "images", "DATA", "--start", "40"], "the split has 40 images"),
    ],
)
def test_a_wrong_command_line_is_exit_code_2(here, tetX_set, words, said):
    done = here(*[tetX_set if word == "DATA" else word for word in words])
    assert done.returncode == 2
    assert said in done.stderr


# Wrong input or data: exit code 1


@pytest.mark.parametrize(
    ("old", "new", "field"),
    [
        ("tolerance_px = 5", "tolerance_px = -5", "marking.tolerance_px"),
        ("axis = [1, 1, 1]", "axis = [1, 1]", "marking.stabiliser.axis"),
        ('kind = "tetrahedral"', 'kind = "tetraedral"', "body.group.kind"),
    ],
)
def test_a_broken_object_toml_is_named_with_its_line_and_its_field(here, mug, tmp_path, old, new, field):
    line = edit(mug / "object.toml", old, new)
    done = here("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert f"{mug / 'object.toml'}, line {line}: {field}: " in done.stderr
    assert not (tmp_path / "data").exists()


def test_an_object_toml_that_is_no_toml_is_named_with_its_line(mug, tmp_path):
    line = edit(mug / "object.toml", "tolerance_px = 5", "tolerance_px = ")
    done = symsol("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert re.search(rf"{mug / 'object.toml'}: is no valid TOML: .*line {line}\b", done.stderr)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("f 1//1 2//1 3//1", "f 1//1 2//1 9//1"),
        ("f 1//1 2//1 3//1", "f 1//1 2//1"),
        ("f 1//1 2//1 3//1", "face 1 2 3"),
        ("usemtl marking", "usemtl handle"),
        ("v 0.577350269 0.577350269 0.577350269", "v 0.577350269 0.577350269 nan"),
    ],
)
def test_a_broken_mesh_is_named_with_its_line(here, mug, tmp_path, old, new):
    line = edit(mug / "mesh.obj", old, new)
    done = here("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert f"{mug / 'mesh.obj'}, line {line}: " in done.stderr
    assert not (tmp_path / "data").exists()


def test_an_object_without_its_declared_symmetry_is_refused_before_blender_starts(here, mug, tmp_path):
    edit(mug / "object.toml", "axis = [1, 1, 1]", "axis = [1, -1, -1]")
    done = here("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert "marking.stabiliser moves the marking of 'flask'" in done.stderr
    assert not (tmp_path / "data").exists()


@pytest.mark.parametrize(
    ("change", "differing"),
    [
        (["--seed", "1"], "seed: there 0, asked for 1"),
        (["--size", "48"], "camera: "),
        (["--engine", "cycles"], "render: "),
        (["--annotate", "all"], "annotate: there 'test', asked for 'all'"),
        (["--train", "0"], "train images: there 5, asked for 0"),
        (["--test", "41"], "test images: there 40, asked for 41"),
    ],
)
def test_another_set_in_the_folder_is_told_apart_and_left_alone(here, tetX_set, tmp_path, change, differing):
    before = contents(tetX_set)
    done = here("render", *NUMPY_SET, *change, "--out", tmp_path)
    assert done.returncode == 1
    assert f"{tetX_set} already holds another set" in done.stderr
    differences = [line for line in done.stderr.splitlines() if line.startswith("  - ")]
    assert len(differences) == 1
    assert differences[0].startswith(f"  - {differing}")
    assert contents(tetX_set) == before


def test_a_set_of_another_object_of_the_same_name_is_told_apart_and_left_alone(tetX_set, mug, tmp_path):
    edit(mug / "object.toml", 'name = "flask"', 'name = "tetX"')
    edit(mug / "object.toml", "title = ", "title = 'mine' # ")
    before = contents(tetX_set)
    done = symsol("render", *NUMPY_SET, "--object", mug, "--out", tmp_path)
    assert done.returncode == 1
    assert "  - object_sha256: " in done.stderr
    assert contents(tetX_set) == before


def test_shards_without_a_manifest_are_left_alone(here, tetX_set, tmp_path):
    (tetX_set / "manifest.json").unlink()
    before = contents(tetX_set)
    done = here("render", *NUMPY_SET, "--out", tmp_path)
    assert done.returncode == 1
    assert "without a manifest.json" in done.stderr
    assert contents(tetX_set) == before


def test_a_damaged_finished_shard_is_named_and_not_drawn_over(here, tetX_set, tmp_path):
    (tetX_set / "test-00002-of-00003.h5").write_bytes(b"damaged")
    before = contents(tetX_set)
    done = here("render", *NUMPY_SET, "--out", tmp_path)
    assert done.returncode == 1
    assert "test-00002-of-00003.h5" in done.stderr
    assert contents(tetX_set) == before


@pytest.mark.parametrize("command", [["info"], ["verify"], ["plot", "images"]])
def test_a_folder_that_holds_no_set_is_an_error_that_names_it(here, tmp_path, command):
    done = here(*command, tmp_path / "not there")
    assert done.returncode == 1
    assert done.stderr.startswith(f"Error: {tmp_path / 'not there'}: holds no manifest.json")


def test_plot_says_which_splits_there_are_and_which_path_cannot_be_written(here, tetX_set, tmp_path, make_bare_set):
    absent = here("plot", "images", make_bare_set(tmp_path / "other"), "--split", "train")
    assert absent.returncode == 1
    assert "has no split 'train'; it has test" in absent.stderr
    unwritable = here("plot", "images", tetX_set, "--count", "1", "--out", tmp_path / "no" / "sheet.png")
    assert unwritable.returncode == 1
    assert f"{tmp_path / 'no' / 'sheet.png'}: cannot be written" in unwritable.stderr
