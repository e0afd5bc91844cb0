"""What the machine refuses or lacks: permissions, a full disk, a closed pipe, OpenGL, bpy, extras."""

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import (
    AS_WHO_OBEYS_MODES,
    COMMAND,
    PROJECT,
    TINY_SET,
    WITHOUT_BPY,
    WITHOUT_EGL,
    obeying_modes,
    run,
    symsol,
)
from PIL import Image

import symsol_annot


@pytest.mark.blender
@obeying_modes
def test_a_folder_without_write_permission_is_named_with_what_to_do(tmp_path):
    out = tmp_path / "read-only"
    out.mkdir(mode=0o555)
    done = run(*AS_WHO_OBEYS_MODES, *COMMAND, "render", *TINY_SET, "--out", out)
    assert done.returncode == 1
    assert re.search(rf"{out}.*: cannot be written: no write permission: choose another folder with --out", done.stderr)
    assert list(out.iterdir()) == []


@pytest.mark.blender
def test_an_out_folder_that_is_a_file_is_named_with_what_to_do(tmp_path):
    (tmp_path / "data").write_text("mine")
    done = symsol("render", *TINY_SET, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert re.search(r"cannot be written: .*is a file, not a folder: choose another folder with --out", done.stderr)
    assert (tmp_path / "data").read_text() == "mine"


@obeying_modes
@pytest.mark.parametrize(
    "words", [["render", *TINY_SET, "--out"], ["info"], ["verify"], ["plot", "images"], ["doctor", "--out"]]
)
def test_a_folder_that_may_not_be_looked_into_is_an_error_that_names_it(tmp_path, words):
    (tmp_path / "closed").mkdir()
    (tmp_path / "closed").chmod(0)
    start = WITHOUT_BPY if words[0] == "doctor" else COMMAND  # what is checked comes before Blender
    done = run(*AS_WHO_OBEYS_MODES, *start, *words, tmp_path / "closed" / "data")
    (tmp_path / "closed").chmod(0o700)
    assert done.returncode == 1
    assert str(tmp_path / "closed") in done.stdout + done.stderr


@pytest.mark.parametrize("buffering", ["", "1"])
@pytest.mark.parametrize(
    "words",
    [
        ["--help"],
        ["--version"],
        ["completion", "fish"],
        ["objects"],
        ["info", "SET"],
        ["verify", "SET"],
        ["plot", "-h"],
    ],
    ids=" ".join,
)
def test_a_full_standard_output_is_one_line_and_no_success(tetX_set, words, buffering):
    line = shlex.join([*COMMAND, *[str(tetX_set) if word == "SET" else word for word in words]])
    done = run("sh", "-c", f"{line} > /dev/full", env={"PYTHONUNBUFFERED": buffering})
    assert (done.returncode, done.stderr) == (1, "Error: standard output: No space left on device\n")


def test_a_picture_is_there_although_its_name_cannot_be_printed(tetX_set, tmp_path):
    line = shlex.join([*COMMAND, "plot", "images", str(tetX_set), "--count", "1", "--out", str(tmp_path / "a.png")])
    done = run("sh", "-c", f"{line} > /dev/full")
    assert (done.returncode, done.stderr) == (1, "Error: standard output: No space left on device\n")
    with Image.open(tmp_path / "a.png") as picture:
        picture.load()


def test_a_reader_that_goes_away_ends_a_command_without_a_word():
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run([*COMMAND, "objects"], stdout=writing, stderr=subprocess.PIPE, check=False)
    os.close(writing)
    assert (done.returncode, done.stderr) == (1, b"")


LONG = "x" * 300  # no file system takes it
READERS = [
    ["info"],
    ["verify"],
    ["plot", "images"],
    ["publish", "--out", "out"],
    ["fetch", "--out", "out"],
    ["gallery", "--out", "out"],
    ["import-symsol"],
    ["import-bop", "--id", "1", "--out", "out"],
    ["leaderboard", "--out", "out.md"],
    ["validate"],
    ["score"],
    ["plot", "coverage", "--object", "tetX", "--out", "out.png"],
]


@pytest.mark.parametrize("words", READERS, ids=" ".join)
def test_a_name_that_is_too_long_is_an_error_that_names_it(here, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    done = here(*words, LONG)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("Error: ")
    assert LONG in done.stderr
    assert "File name too long" in done.stderr
    assert list(tmp_path.iterdir()) == []


@obeying_modes
@pytest.mark.parametrize("words", READERS, ids=" ".join)
def test_a_path_through_a_closed_folder_is_an_error_that_names_it(tmp_path, words):
    (tmp_path / "closed").mkdir(mode=0)
    done = symsol(*words, tmp_path / "closed" / "inner" / "data", cwd=tmp_path, obeys_modes=True)
    (tmp_path / "closed").chmod(0o700)
    assert (done.returncode, done.stdout) == (1, "")
    assert str(tmp_path / "closed") in done.stderr
    assert "Permission denied" in done.stderr


@pytest.mark.parametrize(
    ("package", "contents", "reason"),
    [
        ("matplotlib", "import a_part_of_it", "No module named 'a_part_of_it'"),
        ("matplotlib", "raise ImportError('libx.so: no such file\\nand more')", "libx.so: no such file"),
        ("pyarrow", "", "No module named 'pyarrow.parquet'"),
    ],
)
def test_a_broken_package_is_one_line_that_names_it_and_says_to_reinstall(
    tetX_set, tmp_path, package, contents, reason
):
    (tmp_path / "broken" / package).mkdir(parents=True)
    (tmp_path / "broken" / package / "__init__.py").write_text(contents)
    command = ["plot", "images"] if package == "matplotlib" else ["publish"]
    environment = {"PYTHONPATH": str(tmp_path / "broken")}
    done = symsol(*command, tetX_set, "--out", tmp_path / "out.png", env=environment)
    advice = f"reinstall it: `pip install --force-reinstall {package}`"
    assert (done.returncode, done.stderr) == (1, f"Error: {package} is broken: {reason}; {advice}\n")
    assert not (tmp_path / "out.png").exists()


@pytest.mark.blender
def test_without_opengl_render_says_what_to_do_and_leaves_no_folder(tmp_path):
    done = symsol("render", *TINY_SET, "--out", tmp_path / "data", env=WITHOUT_EGL)
    assert done.returncode == 1
    for word in ("OpenGL", "EGL", "symsol-annot doctor", "--engine cycles"):
        assert word in done.stderr
    assert not (tmp_path / "data").exists()


@pytest.mark.blender
def test_without_opengl_cycles_draws_all_the_same(tmp_path):
    done = symsol("render", *TINY_SET, "--engine", "cycles", "--out", tmp_path / "data", env=WITHOUT_EGL)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(symsol_annot.load(tmp_path / "data" / "tetX")) == 2


@pytest.mark.blender
def test_without_opengl_the_doctor_fails_what_draws_with_it_and_passes_cycles(tmp_path):
    done = symsol("doctor", "--out", tmp_path, env=WITHOUT_EGL)
    assert done.returncode == 1
    assert "FAIL  engine opengl: cannot draw" in done.stdout
    assert "FAIL  engine workbench: cannot draw" in done.stdout
    assert "ok    engine cycles" in done.stdout
    assert done.stdout.count("FAIL") == 2


def test_without_bpy_render_says_what_to_install(tmp_path):
    done = run(*WITHOUT_BPY, "render", *TINY_SET, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert "pip install 'symsol-annot[render]'" in done.stderr
    assert not (tmp_path / "data").exists()


@pytest.fixture(scope="session")
def plain_install(tmp_path_factory):
    """The bin folder of an environment of a Python that Blender is not built for, with the package and no extras."""
    python = another_python()
    if python is None:
        pytest.skip("no Python 3.12 or 3.13 on this machine")
    folder = tmp_path_factory.mktemp("plain")
    source = folder / "source"
    for package in ("symsol_annot", "cli", "blender_assets"):
        shutil.copytree(PROJECT / package, source / package, ignore=shutil.ignore_patterns("__pycache__"))
    for path in PROJECT.iterdir():
        if path.is_file() and path.suffix in {".toml", ".md", ""}:
            shutil.copy(path, source)
    subprocess.run([python, "-m", "venv", "--without-pip", folder / "env"], check=True)
    install = [
        sys.executable,
        "-m",
        "pip",
        "--python",
        folder / "env" / "bin" / "python",
        "install",
        "--no-compile",
        "-q",
    ]
    subprocess.run([*install, source], check=True, capture_output=True)
    return folder / "env" / "bin"


def another_python():
    """A Python 3.12 or 3.13 that starts, or None."""
    found = [Path(path) for name in ("python3.12", "python3.13") if (path := shutil.which(name))]
    found += sorted(Path.home().glob(".pyenv/versions/3.1[23]*/bin/python3"))
    starts = (
        path
        for path in found
        if subprocess.run([path, "-c", "import venv"], capture_output=True, check=False).returncode == 0
    )
    return next(starts, None)


ALONE = {"PYTHONPATH": "", "PYTHONDONTWRITEBYTECODE": ""}


def test_another_python_cannot_render_and_is_told_why_and_what_to_do(plain_install, tmp_path):
    done = run(plain_install / "symsol-annot", "render", *TINY_SET, "--out", tmp_path / "data", env=ALONE)
    assert done.returncode == 1
    for said in ("needs Python 3.11", "this is Python 3.1", "python3.11 -m venv", "pip install '.[render]'"):
        assert said in done.stderr
    assert not (tmp_path / "data").exists()


@pytest.mark.blender
def test_another_python_verifies_and_loads_a_set(plain_install, rendered):
    folder = rendered[1]
    done = run(plain_install / "symsol-annot", "verify", folder, env=ALONE)
    assert (done.returncode, done.stderr) == (0, "")
    code = f"import symsol_annot; print(symsol_annot.load({str(folder)!r})[5].rotation.tobytes().hex())"
    done = run(plain_install / "python", "-W", "error", "-c", code, env=ALONE)
    assert done.stdout.strip() == symsol_annot.load(folder)[5].rotation.tobytes().hex()


def test_an_install_without_extras_has_objects_and_types_and_says_what_plots_need(plain_install, tetX_set):
    done = run(plain_install / "symsol-annot", "objects", env=ALONE)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == symsol("objects").stdout
    code = (
        "from importlib import resources\n"
        "packages = 'symsol_annot', 'symsol_annot_cli', 'symsol_annot_assets'\n"
        "print([resources.files(package).joinpath('py.typed').is_file() for package in packages])"
    )
    assert run(plain_install / "python", "-c", code, env=ALONE).stdout.strip() == "[True, True, True]"
    done = run(plain_install / "symsol-annot", "plot", "images", tetX_set, env=ALONE)
    assert done.returncode == 1
    assert "pip install 'symsol-annot[plot]'" in done.stderr
