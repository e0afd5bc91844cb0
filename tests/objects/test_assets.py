"""The built-in objects are those that the script builds, and its check names any that are not."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from asset_geometry import BALLS, GROUPS, PARTED_GROUPS
from symsol_annot_assets import build
from symsol_annot_assets.meshes import triangulate

from symsol_annot.objects.spec import PUBLISHED_NAMES

ASSETS = Path(build.__file__).parent
NAMES = {*GROUPS, *PARTED_GROUPS, *BALLS}
FILES = [f"{name}/{file}" for name in sorted(NAMES) for file in ("object.toml", "mesh.obj")]


@pytest.fixture(scope="module")
def built():
    """What the script builds: path in the folder of the folders to text."""
    return {f"{name}/{file}": text for name in build.OBJECTS for file, text in build.files_of(name).items()}


@pytest.fixture
def run_build(monkeypatch, built):
    """Run the script's command line; what it builds is built once a module, since that takes seconds."""

    def run(*arguments):
        texts = {name: {file: built[f"{name}/{file}"] for file in ("object.toml", "mesh.obj")} for name in NAMES}
        monkeypatch.setattr(build, "files_of", texts.__getitem__)
        monkeypatch.setattr("sys.argv", ["build", *map(str, arguments)])
        return build.main()

    return run


# --- the script ---


def test_the_committed_folders_are_those_of_the_script():
    assert {path.parent.name for path in ASSETS.glob("*/*.*") if path.suffix in (".toml", ".obj")} == NAMES
    assert set(build.OBJECTS) == NAMES
    assert set(build.PUBLISHED) == set(PUBLISHED_NAMES) == set(GROUPS)


@pytest.mark.parametrize("file", FILES)
def test_a_committed_file_is_byte_for_byte_what_the_script_builds(built, file):
    assert (ASSETS / file).read_bytes().decode("utf-8") == built[file]


def test_the_script_writes_what_its_check_then_accepts(run_build, built, tmp_path, capsys):
    assert run_build("--out", tmp_path) == 0
    assert sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*.*")) == sorted(FILES)
    assert all((tmp_path / file).read_bytes() == built[file].encode() for file in FILES)
    assert run_build("--check", "--out", tmp_path) == 0
    assert capsys.readouterr() == ("", "")


def test_the_check_accepts_the_committed_folders_by_default(run_build, capsys):
    assert run_build("--check") == 0
    assert capsys.readouterr() == ("", "")


def change_a_digit(path):
    data = path.read_bytes()
    index = data.rindex(b"1")
    path.write_bytes(data[:index] + b"2" + data[index + 1 :])


def end_lines_as_windows_does(path):
    path.write_bytes(path.read_bytes().replace(b"\n", b"\r\n"))


@pytest.mark.parametrize("file", ["tet/mesh.obj", "screw/mesh.obj", "tetX/object.toml"])
@pytest.mark.parametrize("tamper", [change_a_digit, end_lines_as_windows_does, Path.unlink])
def test_the_check_names_a_tampered_file_and_no_other_and_mends_nothing(run_build, tmp_path, capsys, file, tamper):
    copy = Path(shutil.copytree(ASSETS, tmp_path / "copy", ignore=shutil.ignore_patterns("__pycache__")))
    tamper(copy / file)
    before = {path: path.read_bytes() for path in copy.rglob("*.*")}
    assert run_build("--check", "--out", copy) == 1
    assert capsys.readouterr().err == f"{copy / file} is not what symsol_annot_assets.build builds\n"
    assert {path: path.read_bytes() for path in copy.rglob("*.*")} == before


# --- cutting polygons ---


def shoelace(polygon):
    x, y = np.asarray(polygon).T
    return (x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("count", [3, 4, 7, 20])
def test_the_triangles_of_a_polygon_cover_it_once(seed, count):
    rng = np.random.default_rng(seed)
    turns = (np.arange(count) + rng.uniform(0, 0.8, count)) * 2 * np.pi / count
    star = rng.uniform(0.4, 1, count)[:, None] * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    triangles = triangulate(star)
    assert len(triangles) == count - 2
    assert min(shoelace(triangle) for triangle in triangles) > 0
    assert sum(shoelace(triangle) for triangle in triangles) == pytest.approx(shoelace(star))
    assert {tuple(corner) for triangle in triangles for corner in triangle} == {tuple(corner) for corner in star}
