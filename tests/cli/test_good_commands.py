"""What good commands say and leave: real processes and real Blender."""

import contextlib
import fcntl
import json
import os
import pty
import re
import shlex
import shutil
import struct
import subprocess
import sys
import termios
from pathlib import Path

import h5py
import numpy as np
import pytest
from command_line import COMMAND, NUMPY_SET, REAL_SET, SHARDS, TINY_SET, contents, edit, run, symsol
from PIL import Image
from symsol_annot_cli.main import app

import symsol_annot


@pytest.mark.blender
def test_render_says_what_it_made_and_where_and_nothing_else(rendered):
    done, folder = rendered
    assert (done.returncode, done.stderr) == (0, "")  # where there is no terminal, neither a bar nor Blender's chatter
    manifest = json.loads((folder / "manifest.json").read_text())
    made, split, what_next, *suggestions = done.stdout.splitlines()
    assert made == f"{folder}: tetX, fingerprint {manifest['fingerprint']}"
    mebibytes = sum(path.stat().st_size for path in folder.glob("*.h5")) / 2**20
    assert split == f"  test: {16 * SHARDS} images with symmetry sets, {SHARDS} shards, {mebibytes:.1f} MiB"
    assert what_next == "Next:"
    assert [words.split()[:2] for words in suggestions] == [
        ["symsol-annot", "verify"],
        ["symsol-annot", "plot"],
        ["python", "-c"],
    ]


@pytest.mark.blender
@pytest.mark.parametrize("name", ["data", "o'neil's data"])
def test_each_suggested_command_works_as_it_is_printed(rendered, tmp_path, name):
    shutil.copytree(rendered[1], tmp_path / name / "tetX")
    done = symsol("render", *REAL_SET, "--out", name, cwd=tmp_path)  # all is there: it prints the same again
    shell = {"PATH": f"{programs(tmp_path / 'bin')}{os.pathsep}{os.environ['PATH']}"}
    suggestions = done.stdout.partition("Next:\n")[2].splitlines()
    verified, plotted, loaded = [run("sh", "-c", line, env=shell, cwd=tmp_path) for line in suggestions]
    for ran in (verified, plotted, loaded):
        assert (ran.returncode, ran.stderr) == (0, "")
    assert "whole and consistent" in verified.stdout
    with Image.open(tmp_path / plotted.stdout.strip()) as picture:
        picture.load()
        assert picture.format == "PNG"
    assert loaded.stdout.startswith("<Sample 0: ")


def programs(folder):
    """A folder with the programs `symsol-annot` and `python`, as an environment's bin has them."""
    folder.mkdir()
    for name, words in (("symsol-annot", COMMAND), ("python", (sys.executable,))):
        (folder / name).write_text(f'#!/bin/sh\nexec {shlex.join(words)} "$@"\n')
        (folder / name).chmod(0o755)
    return folder


def test_every_split_gets_its_symmetry_sets_unless_told_otherwise(tmp_path):
    done = symsol("render", *TINY_SET, "--train", "2", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    for split in ("train", "test"):
        assert all(len(sample.symmetry_set) >= 3 for sample in symsol_annot.load(tmp_path / "tetX", split))


def test_the_same_command_on_a_finished_set_writes_nothing(tetX_set, tmp_path):
    before = contents(tetX_set)
    done = symsol("render", *NUMPY_SET, "--out", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert contents(tetX_set) == before


@pytest.mark.blender
def test_a_terminal_sees_a_bar_with_rate_and_time_left(tmp_path):
    ours, theirs = pty.openpty()
    fcntl.ioctl(theirs, termios.TIOCSWINSZ, struct.pack("HHHH", 24, 100, 0, 0))
    command = [*COMMAND, "render", *REAL_SET, "--test", "20", "--annotate", "none", "--out", str(tmp_path)]
    with subprocess.Popen(command, stdin=theirs, stdout=subprocess.PIPE, stderr=theirs) as process:
        os.close(theirs)
        shown = read_to_the_end(ours).decode()
    assert process.returncode == 0
    assert re.search(r"tetX:\s+\d+%\|.*\| \d+/20 \[\d\d:\d\d<\d\d:\d\d, +[\d.]+(image/s|s/image), \d/2 shards\]", shown)
    assert "20/20" in shown
    assert not re.search(r"Saved|Fra:|Time:|EGL", shown)


def read_to_the_end(terminal):
    data = b""
    with contextlib.suppress(OSError):  # Linux's end of a terminal that nobody holds any more
        while chunk := os.read(terminal, 4096):
            data += chunk
    os.close(terminal)
    return data


@pytest.mark.blender
def test_an_object_of_ones_own_is_rendered_and_audited_by_its_path(mug, tmp_path):
    counts = ("--train", "3", "--test", "0", "--annotate", "all", "--size", "24", "--workers", "1")
    made = symsol("render", "--object", mug, *counts, "--out", tmp_path / "data")
    assert made.returncode == 0
    assert re.fullmatch(r"the mesh has T, within \S+ of its radius\nnot looked for: .*\n", made.stderr)
    sample = symsol_annot.load(tmp_path / "data" / "flask", "train")[2]
    assert len(sample.symmetry_set) in {3, 6, 9}
    audited = symsol("verify", tmp_path / "data", "--audit", "2", "--object", mug)
    assert (audited.returncode, audited.stderr) == (0, "")
    assert "0 faults" in audited.stdout
    without_object = symsol("verify", tmp_path / "data", "--audit", "1")
    assert without_object.returncode == 1
    assert "give its folder with --object" in without_object.stderr
    edit(mug / "object.toml", "tolerance_px = 5", "tolerance_px = 6")
    another = symsol("verify", tmp_path / "data", "--audit", "1", "--object", mug)
    assert another.returncode == 1
    assert "digests differ" in another.stderr


@pytest.mark.parametrize(
    ("name", "candidates", "stabiliser", "tolerance"),
    [
        ("tet", 12, 12, "-"),
        ("cube", 24, 24, "-"),
        ("icosa", 60, 60, "-"),
        ("cone", 360, 360, "-"),
        ("cyl", 720, 720, "-"),
        ("tetX", 12, 3, "5"),
        ("cylO", 720, 1, "0.125"),
        ("mug", 360, 1, "0.125"),
        ("nut", 12, 12, "-"),
        ("screw", 360, 6, "0.125"),
        ("dots", 720, 1, "0.125"),
        ("die", 24, 1, "0.125"),
        ("box", 8, 1, "0.125"),
    ],
)
def test_objects_lists_each_object_with_its_groups(listed_objects, name, candidates, stabiliser, tolerance):
    assert listed_objects[name][:3] == [str(candidates), str(stabiliser), tolerance]


@pytest.fixture(scope="module")
def listed_objects():
    done = symsol("objects")
    assert (done.returncode, done.stderr) == (0, "")
    rows = [line.split() for line in done.stdout.splitlines()[1:]]
    return {row[0]: row[1:] for row in rows}


def test_info_gives_the_numbers_that_h5py_counts(tetX_set):
    done = symsol("info", tetX_set)
    assert (done.returncode, done.stderr) == (0, "")
    files = [h5py.File(path) for path in sorted(tetX_set.glob("test-*.h5"))]
    pixels = np.concatenate([file["marking_pixels"][...] for file in files])
    sizes = np.concatenate([file["symmetry_mask"][...].sum(axis=1) for file in files])
    drawn, below = (
        sum(int(file.attrs[name]) for file in files) for name in ("candidates_drawn", "candidates_within_tolerance")
    )
    shown = int((pixels >= 5).sum())
    assert 0 < shown < 40
    for line in (
        "images       32x32, engine opengl, seed 0",
        f"fingerprint  {json.loads((tetX_set / 'manifest.json').read_text())['fingerprint']}",
        "train: 5 images, 1 of 1 shards",
        "  without symmetry sets",
        "test: 40 images, 3 of 3 shards",
        f"  marking shows in {shown} of 40 ({100 * shown / 40:.1f}%)",
        "  |S|: " + ", ".join(f"{size} in {(sizes == size).sum()}" for size in np.unique(sizes)),
        f"  of {drawn} candidates, {below} show the marking by less than the tolerance",
    ):
        assert line in done.stdout.splitlines()
    for file in files:
        file.close()


@pytest.mark.blender
def test_doctor_finds_this_machine_ready(tmp_path):
    done = symsol("doctor", "--out", tmp_path)
    assert done.returncode == 0, done.stdout
    assert "FAIL" not in done.stdout
    assert done.stdout.endswith("Ready to render.\n")
    assert done.stderr == ""


def test_verify_finds_a_good_set_and_a_folder_of_sets_whole(here, tetX_set):
    for folder in (tetX_set, tetX_set.parent):
        done = here("verify", folder)
        assert (done.returncode, done.stderr) == (0, "")
        assert done.stdout == f"{tetX_set}: 4 shards, 45 images: whole and consistent\n"


def test_verify_names_the_damaged_shards(tetX_set):
    for name in ("test-00001-of-00003.h5", "train-00000-of-00001.h5"):
        data = bytearray((tetX_set / name).read_bytes())
        data[len(data) // 2] ^= 1
        (tetX_set / name).write_bytes(data)
    done = symsol("verify", tetX_set)
    assert done.returncode == 1
    faults = [line for line in done.stdout.splitlines() if line.startswith("FAULT")]
    assert len(faults) == 2
    assert "train-00000-of-00001.h5: is damaged" in faults[0]
    assert "test-00001-of-00003.h5: is damaged" in faults[1]
    assert "2 faults" in done.stdout


@pytest.mark.blender
def test_verify_repairs_a_damaged_and_a_missing_shard_to_the_same_bytes(rendered, tmp_path):
    folder = Path(shutil.copytree(rendered[1], tmp_path / "tetX"))
    first, second, *_ = sorted(folder.glob("*.h5"))
    first.write_bytes(b"damaged")
    second.unlink()
    done = symsol("verify", folder, "--repair")
    assert done.returncode == 0, done.stdout + done.stderr
    assert f"made again: {first.name}, {second.name}" in done.stdout
    assert "whole and consistent" in done.stdout
    bytes_of = [{path.name: path.read_bytes() for path in where.iterdir()} for where in (folder, rendered[1])]
    assert bytes_of[0] == bytes_of[1]


def test_a_whole_set_needs_no_repair_and_no_blender(here, tetX_set):
    done = here("verify", tetX_set, "--repair")
    assert (done.returncode, "nothing to repair" in done.stdout) == (0, True)


@pytest.mark.blender
def test_an_audit_finds_a_set_that_blender_drew_sound(rendered):
    done = symsol("verify", rendered[1], "--audit", "3")
    assert (done.returncode, done.stderr) == (0, "")
    assert re.search(r"drew 3 images again, with \d+ members .* and \d+ rejected candidates: 0 faults", done.stdout)


@pytest.mark.blender
def test_an_audit_finds_the_faults_of_a_set_that_another_renderer_drew(tetX_set):
    done = symsol("verify", tetX_set, "--audit", "3")
    assert done.returncode == 1
    assert re.search(r"FAULT .* image \d+, drawn again at its own rotation: \d+ pixels of the RGB differ", done.stdout)


def test_an_audit_of_a_set_without_symmetry_sets_has_nothing_to_do(here, tmp_path, make_bare_set):
    done = here("verify", make_bare_set(tmp_path), "--audit", "1")
    assert done.returncode == 1
    assert "no split with symmetry sets" in done.stderr


def test_plot_writes_a_picture_of_the_images_asked_for(here, tetX_set, tmp_path):
    done = here(
        "plot", "images", tetX_set, "--split", "test", "--start", "38", "--count", "9", "--out", tmp_path / "two.png"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{tmp_path / 'two.png'}\n"
    with Image.open(tmp_path / "two.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 0


@pytest.mark.parametrize("command", ["", *app.list_commands(None)])
def test_every_command_explains_itself(here, command, monkeypatch):
    words = [command] if command else []
    explained = app.get_command(None, command) if command else app
    monkeypatch.setattr(explained, "_help_option", None)  # click keeps what a test made of the command by itself
    done = here(*words, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    short = here(*words, "-h")
    assert (short.returncode, short.stderr, short.stdout) == (0, "", done.stdout)
    assert explained.help.split()[:4] == done.stdout.partition("\n\n")[2].split()[:4]
    assert all(option in done.stdout for parameter in explained.params for option in parameter.opts if option[0] == "-")
