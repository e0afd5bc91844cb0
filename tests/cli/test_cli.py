"""The command line from outside: real processes and real Blender, what they print, how they end, what they leave."""

import contextlib
import fcntl
import hashlib
import json
import os
import pty
import re
import shlex
import shutil
import signal
import struct
import subprocess
import sys
import termios
import time
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from uuid import uuid4

import h5py
import numpy as np
import pytest
from PIL import Image
from symsol_annot_cli.main import app, main

import symsol_annot

CALL_MAIN = "from symsol_annot_cli.main import main; main()"
COMMAND = (sys.executable, "-c", CALL_MAIN)
INTERRUPTIBLE = (  # also from a background job, which is born deaf to it
    sys.executable,
    "-c",
    f"import signal; signal.signal(signal.SIGINT, signal.default_int_handler); {CALL_MAIN}",
)
WITHOUT_BPY = (sys.executable, "-c", f"import sys; sys.modules['bpy'] = None; {CALL_MAIN}")
WITHOUT_EGL = {"__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}
PROJECT = Path(__file__).parents[2]
SHARDS = 4
REAL_SET = ("--object", "tetX", "--train", "0", "--test", str(16 * SHARDS), "--size", "24", "--workers", "2")
LONGER_SET = (*REAL_SET, "--test", "480", "--size", "96")  # takes long enough to be interrupted; the last option counts
TINY_SET = ("--object", "tetX", "--train", "0", "--test", "2", "--size", "16", "--workers", "1")
NUMPY_SET = (
    "--object",
    "tetX",
    "--annotate",
    "test",
    "--train",
    "5",
    "--test",
    "40",
    "--size",
    "32",
)  # what the fixture tetX_set was made as

AS_WHO_OBEYS_MODES = ("setpriv", "--bounding-set=-dac_override,-dac_read_search") if os.geteuid() == 0 else ()
obeying_modes = pytest.mark.skipif(
    bool(AS_WHO_OBEYS_MODES) and not shutil.which("setpriv"), reason="root ignores modes, and setpriv is not here"
)


def run(*command, env=None, cwd=None):
    """Run a program to its end; whatever happened, it was no traceback."""
    done = subprocess.run(
        [str(word) for word in command],
        capture_output=True,
        text=True,
        env={**os.environ, **(env or {})},
        cwd=cwd,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    assert "Traceback" not in done.stderr + done.stdout, done.stderr
    return done


def symsol(*arguments, **options):
    return run(*COMMAND, *arguments, **options)


def contents(folder):
    """The files of a folder, with their bytes and when they were written."""
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.iterdir()}


@pytest.fixture
def symsol_here(monkeypatch, capfd):
    """The same entry point in this process, which is sooner: for the many things that are refused at once."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["symsol-annot", *(str(word) for word in arguments)])
        with pytest.raises(SystemExit) as ended:
            main()
        return subprocess.CompletedProcess(arguments, ended.value.code, *capfd.readouterr())

    return call


@pytest.fixture(scope="session")
def rendered(tmp_path_factory):
    """A real set, made by the command, and what the command said."""
    out = tmp_path_factory.mktemp("rendered") / "data"
    return symsol("render", *REAL_SET, "--out", out), out / "tetX"


@pytest.fixture
def mug(tmp_path):
    """An object of one's own: the marked tetrahedron under another name."""
    folder = Path(shutil.copytree(str(resources.files("symsol_annot_assets") / "tetX"), tmp_path / "mug"))
    edit(folder / "object.toml", 'name = "tetX"', 'name = "mug"')
    return folder


def edit(path, old, new):
    """Replace what occurs once in a file; return the number of the line where it stands."""
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))
    return text[: text.index(old)].count("\n") + 1


# What a good command says and leaves


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
    assert loaded.stdout.startswith("Sample(index=0")


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
    assert (made.returncode, made.stderr) == (0, "")
    sample = symsol_annot.load(tmp_path / "data" / "mug", "train")[2]
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
        "images       32x32, engine workbench, seed 0",
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


def test_verify_finds_a_good_set_and_a_folder_of_sets_whole(symsol_here, tetX_set):
    for folder in (tetX_set, tetX_set.parent):
        done = symsol_here("verify", folder)
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


def test_a_whole_set_needs_no_repair_and_no_blender(symsol_here, tetX_set):
    done = symsol_here("verify", tetX_set, "--repair")
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


def test_an_audit_of_a_set_without_symmetry_sets_has_nothing_to_do(symsol_here, tmp_path, make_bare_set):
    done = symsol_here("verify", make_bare_set(tmp_path), "--audit", "1")
    assert done.returncode == 1
    assert "no split with symmetry sets" in done.stderr


@pytest.fixture
def make_bare_set():
    from made_sets import make_set

    return lambda folder: make_set(folder, test=2, annotate="none")


def test_plot_writes_a_picture_of_the_images_asked_for(symsol_here, tetX_set, tmp_path):
    done = symsol_here(
        "plot", "images", tetX_set, "--split", "test", "--start", "38", "--count", "9", "--out", tmp_path / "two.png"
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == f"{tmp_path / 'two.png'}\n"
    with Image.open(tmp_path / "two.png") as picture:
        assert np.asarray(picture.convert("L")).std() > 0


@pytest.mark.parametrize("command", ["", *sorted(app.commands)])
def test_every_command_explains_itself(symsol_here, command):
    words = [command] if command else []
    done = symsol_here(*words, "--help")
    assert (done.returncode, done.stderr) == (0, "")
    assert symsol_here(*words, "-h").stdout == done.stdout
    explained = app.commands[command] if command else app
    assert explained.help.split()[:4] == done.stdout.partition("\n\n")[2].split()[:4]
    assert all(option in done.stdout for parameter in explained.params for option in parameter.opts if option[0] == "-")


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
        (["--object", "tetX", "--engine", "povray"], "'workbench', 'cycles', 'eevee'"),
        (["--object", "tetX", "--annotate", "some"], "'all', 'test', 'none'"),
        (["--object", "tetX", "--size", "15"], "16<=x<=2048"),
        (["--object", "tetX", "--size", "2049"], "16<=x<=2048"),
        (["--object", "tetX", "--size", "big"], "--size"),
        (["--object", "tetX", "--workers", "0"], "--workers"),
    ],
)
def test_render_refuses_each_wrong_option_by_its_name(symsol_here, tmp_path, monkeypatch, words, said):
    monkeypatch.chdir(tmp_path)
    done = symsol_here("render", *words)
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
def test_a_wrong_command_line_is_exit_code_2(symsol_here, tetX_set, words, said):
    done = symsol_here(*[tetX_set if word == "DATA" else word for word in words])
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
def test_a_broken_object_toml_is_named_with_its_line_and_its_field(symsol_here, mug, tmp_path, old, new, field):
    line = edit(mug / "object.toml", old, new)
    done = symsol_here("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
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
def test_a_broken_mesh_is_named_with_its_line(symsol_here, mug, tmp_path, old, new):
    line = edit(mug / "mesh.obj", old, new)
    done = symsol_here("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert f"{mug / 'mesh.obj'}, line {line}: " in done.stderr
    assert not (tmp_path / "data").exists()


def test_an_object_without_its_declared_symmetry_is_refused_before_blender_starts(symsol_here, mug, tmp_path):
    edit(mug / "object.toml", "axis = [1, 1, 1]", "axis = [1, -1, -1]")
    done = symsol_here("render", *TINY_SET, "--object", mug, "--out", tmp_path / "data")
    assert done.returncode == 1
    assert "marking.stabiliser moves the marking of 'mug'" in done.stderr
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
def test_another_set_in_the_folder_is_told_apart_and_left_alone(symsol_here, tetX_set, tmp_path, change, differing):
    before = contents(tetX_set)
    done = symsol_here("render", *NUMPY_SET, *change, "--out", tmp_path)
    assert done.returncode == 1
    assert f"{tetX_set} already holds another set" in done.stderr
    differences = [line for line in done.stderr.splitlines() if line.startswith("  - ")]
    assert len(differences) == 1
    assert differences[0].startswith(f"  - {differing}")
    assert contents(tetX_set) == before


def test_a_set_of_another_object_of_the_same_name_is_told_apart_and_left_alone(tetX_set, mug, tmp_path):
    edit(mug / "object.toml", 'name = "mug"', 'name = "tetX"')
    edit(mug / "object.toml", "title = ", "title = 'mine' # ")
    before = contents(tetX_set)
    done = symsol("render", *NUMPY_SET, "--object", mug, "--out", tmp_path)
    assert done.returncode == 1
    assert "  - object_sha256: " in done.stderr
    assert contents(tetX_set) == before


def test_shards_without_a_manifest_are_left_alone(symsol_here, tetX_set, tmp_path):
    (tetX_set / "manifest.json").unlink()
    before = contents(tetX_set)
    done = symsol_here("render", *NUMPY_SET, "--out", tmp_path)
    assert done.returncode == 1
    assert "without a manifest.json" in done.stderr
    assert contents(tetX_set) == before


def test_a_damaged_finished_shard_is_named_and_not_drawn_over(symsol_here, tetX_set, tmp_path):
    (tetX_set / "test-00002-of-00003.h5").write_bytes(b"damaged")
    before = contents(tetX_set)
    done = symsol_here("render", *NUMPY_SET, "--out", tmp_path)
    assert done.returncode == 1
    assert "test-00002-of-00003.h5" in done.stderr
    assert contents(tetX_set) == before


@pytest.mark.parametrize("command", [["info"], ["verify"], ["plot", "images"]])
def test_a_folder_that_holds_no_set_is_an_error_that_names_it(symsol_here, tmp_path, command):
    done = symsol_here(*command, tmp_path / "not there")
    assert done.returncode == 1
    assert done.stderr.startswith(f"Error: {tmp_path / 'not there'}: holds no manifest.json")


def test_plot_says_which_splits_there_are_and_which_path_cannot_be_written(
    symsol_here, tetX_set, tmp_path, make_bare_set
):
    absent = symsol_here("plot", "images", make_bare_set(tmp_path / "other"), "--split", "train")
    assert absent.returncode == 1
    assert "has no split 'train'; it has test" in absent.stderr
    unwritable = symsol_here("plot", "images", tetX_set, "--count", "1", "--out", tmp_path / "no" / "sheet.png")
    assert unwritable.returncode == 1
    assert f"{tmp_path / 'no' / 'sheet.png'}: cannot be written" in unwritable.stderr


# What the machine refuses or lacks


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
    ["gallery", "--out", "out"],
    ["import-symsol"],
    ["leaderboard", "--out", "out.md"],
    ["validate"],
    ["score"],
    ["plot", "coverage", "--object", "tetX", "--out", "out.png"],
]


@pytest.mark.parametrize("words", READERS, ids=" ".join)
def test_a_name_that_is_too_long_is_an_error_that_names_it(symsol_here, tmp_path, monkeypatch, words):
    monkeypatch.chdir(tmp_path)
    done = symsol_here(*words, LONG)
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith("Error: ")
    assert LONG in done.stderr
    assert "File name too long" in done.stderr
    assert list(tmp_path.iterdir()) == []


@obeying_modes
@pytest.mark.parametrize("words", READERS, ids=" ".join)
def test_a_path_through_a_closed_folder_is_an_error_that_names_it(tmp_path, words):
    (tmp_path / "closed").mkdir(mode=0)
    done = run(*AS_WHO_OBEYS_MODES, *COMMAND, *words, tmp_path / "closed" / "inner" / "data", cwd=tmp_path)
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
def test_without_opengl_workbench_says_what_to_do_and_leaves_no_folder(tmp_path):
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
def test_without_opengl_the_doctor_fails_workbench_and_passes_cycles(tmp_path):
    done = symsol("doctor", "--out", tmp_path, env=WITHOUT_EGL)
    assert done.returncode == 1
    assert "FAIL  engine workbench: cannot draw" in done.stdout
    assert "ok    engine cycles" in done.stdout
    assert done.stdout.count("FAIL") == 1


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


# Ctrl-C


@dataclass(frozen=True)
class Interrupted:
    """What a render left that met Ctrl-C after its first shard."""

    code: int
    stdout: str
    stderr: str
    folder: Path
    processes_before: int
    processes_after: int
    temporary_files: list[str]
    new_shared_memory: set[str]


@pytest.fixture(scope="module")
def interrupted(tmp_path_factory):
    out, temporary = tmp_path_factory.mktemp("interrupted"), tmp_path_factory.mktemp("temporary")
    mark = f"SYMSOL_ANNOT_TEST={uuid4()}"
    shared_memory = names_in("/dev/shm")
    process = subprocess.Popen(
        [*INTERRUPTIBLE, "render", *LONGER_SET, "--out", str(out)],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env={**os.environ, "TMPDIR": str(temporary), **dict([mark.split("=")])},
        start_new_session=True,
    )
    with process:
        while not any(out.glob("tetX/*.h5")) and process.poll() is None:
            time.sleep(0.01)
        processes_before = processes_marked(mark)
        os.killpg(process.pid, signal.SIGINT)
        stdout, stderr = process.communicate(timeout=60)
    return Interrupted(
        process.returncode,
        stdout,
        stderr,
        out / "tetX",
        processes_before,
        processes_marked(mark),
        sorted(names_in(temporary)),
        names_in("/dev/shm") - shared_memory,
    )


def names_in(folder):
    return {path.name for path in Path(folder).iterdir()}


def processes_marked(mark):
    """How many processes have a variable in their environment, which children inherit."""
    count = 0
    for environment in Path("/proc").glob("[0-9]*/environ"):
        with contextlib.suppress(OSError):
            count += mark.encode() in environment.read_bytes()
    return count


@pytest.mark.blender
def test_ctrl_c_is_exit_code_130_and_a_message(interrupted):
    assert interrupted.code == 130
    assert "Interrupted." in interrupted.stderr
    assert f"Finished shards in {interrupted.folder} are kept; the same command goes on" in interrupted.stderr
    assert "Traceback" not in interrupted.stderr
    assert interrupted.stdout == ""


@pytest.mark.blender
def test_ctrl_c_keeps_whole_shards_and_no_part_of_one(interrupted):
    manifest = json.loads((interrupted.folder / "manifest.json").read_text())
    shards = manifest["splits"]["test"]["shards"]
    finished = {shard["file"]: shard["sha256"] for shard in shards if shard["sha256"]}
    assert 1 <= len(finished) < len(shards)
    assert names_in(interrupted.folder) == {"manifest.json", *finished}
    for name, sha256 in finished.items():
        assert hashlib.sha256((interrupted.folder / name).read_bytes()).hexdigest() == sha256


@pytest.mark.blender
def test_ctrl_c_ends_every_blender(interrupted):
    assert interrupted.processes_before == 4  # the command, its two workers, and what asks HDF5 about shards
    assert interrupted.processes_after == 0


@pytest.mark.blender
def test_ctrl_c_leaves_nothing_in_temporary_folders(interrupted):
    assert interrupted.temporary_files == []
    assert interrupted.new_shared_memory == set()


@pytest.mark.blender
def test_the_same_command_after_ctrl_c_finishes_the_very_same_set(interrupted, tmp_path):
    folder = Path(shutil.copytree(interrupted.folder, tmp_path / "tetX"))
    kept = {name: found for name, found in contents(folder).items() if name.endswith(".h5")}
    done = symsol("render", *LONGER_SET, "--out", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    after = contents(folder)
    assert {name: after[name] for name in kept} == kept
    assert symsol("render", *LONGER_SET, "--out", tmp_path / "undisturbed").returncode == 0
    assert {name: data for name, (data, _) in after.items()} == {
        name: data for name, (data, _) in contents(tmp_path / "undisturbed" / "tetX").items()
    }
