"""All commands that write, run in folders full of a user's files with unlucky names: each byte stays as it was."""

import os
import shutil
import signal
import stat
import subprocess
import sys
from pathlib import Path

import pytest
import symsol_source

pytestmark = pytest.mark.blender

COMMANDS = """\
import sys
from symsol_annot_cli.main import main
for line in sys.argv[1:]:
    sys.argv = ["symsol-annot", *line.split()]
    try:
        main()
    except SystemExit as ended:
        if ended.code:
            raise
"""
RECIPE = """\
title = "tiny"
model = "hypotheses"
epochs = 1
batch_size = 8
learning_rates = [1e-3]
milestones = []
validation_images = 0
start = "random"
hypotheses = 2
meta_loss = "wta"
embedded_loss = "geodesic"
"""
KILLED_OWNER = (
    "import time; from symsol_annot.system.scratch import Scratch\n"
    "s = Scratch(); print(s.path, flush=True); time.sleep(99)"
)
UNLUCKY_IN_TEMPORARY = (
    "symsol-annot-results/thesis.h5",
    "symsol-annot-main/README.md",
    "symsol-annot-frame",
    "symsol-annot-abcdefgh/MADE-BY-SYMSOL-ANNOT",
    ".symsol-annot-abcdefgh/new",
    "symsol-annot-/x.sgi",
    "tmpabcdefgh/mine",
)
UNLUCKY_BESIDE_OUTPUTS = (
    ".tetX.partial",
    ".tetX.before/old",
    ".manifest.json.partial",
    ".gallery.partial/index.html",
    ".gallery.before/index.html",
    ".preds.h5.partial",
    ".preds.h5.lock",
    "preds.h5~",
    "preds.h5.new",
    ".bundle.partial",
    ".truth.json.partial",
    "new/mine",
    "waiting/mine",
    "superseded/mine",
    ".symsol-annot-mine/new",
    ".symsol-annot-mine/MADE-BY-SYMSOL-ANNOT",
    "SHA256SUMS.unfinished",
    "settings.json",
    "00000000.npz",
    "symsol-annot-runs/state.safetensors",
)


def plant(folder, names):
    """Files of a user's, some that only he may read or nobody write, and links to them, to a folder and to nothing."""
    for number, name in enumerate(names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(f"years of work, {name}")
        path.chmod((0o600, 0o444, 0o640)[number % 3])
    for name, target in (("a.h5", names[0]), ("a-folder", Path(names[0]).parent), ("to-nothing", "nowhere")):
        (folder / f"symsol-annot-link-{name}").symlink_to(target)
        (folder / f".symsol-annot-link-{name}").symlink_to(target)


def snapshot(folder):
    """Path to kind, mode, time and content of all in a folder."""
    found = {}
    for path in folder.rglob("*"):
        status = path.lstat()
        content = str(path.readlink()) if path.is_symlink() else path.read_bytes() if path.is_file() else None
        found[path.relative_to(folder).as_posix()] = (stat.filemode(status.st_mode), content, status.st_ino)
    return found


def copy_a_killed_owners_folder(temporary, environment):
    """A folder that a sweep may take, and a user's copy of it that it may not."""
    with subprocess.Popen(
        [sys.executable, "-c", KILLED_OWNER], stdout=subprocess.PIPE, text=True, env=environment
    ) as owner:
        left = Path(owner.stdout.readline().strip())
        owner.send_signal(signal.SIGKILL)
        owner.wait()
    assert left.parent == temporary
    shutil.copytree(left, temporary / "symsol-annot-backup")
    return left


@pytest.fixture(scope="module")
def user(tmp_path_factory):
    """A working folder and one for temporary files, both full, before and after all commands that write."""
    base = tmp_path_factory.mktemp("user")
    temporary, work = base / "tmp", base / "work"
    for folder in (temporary, work, work / "data", work / "reference", work / "symsol", work / "runs"):
        folder.mkdir()
    environment = {**os.environ, "TMPDIR": str(temporary)}
    left = copy_a_killed_owners_folder(temporary, environment)
    plant(temporary, UNLUCKY_IN_TEMPORARY)
    for folder in (work, work / "data", work / "reference", work / "symsol", work / "runs"):
        plant(folder, UNLUCKY_BESIDE_OUTPUTS)
    before = {folder: snapshot(folder) for folder in (temporary, work)}
    before[temporary] = {name: what for name, what in before[temporary].items() if left.name not in name}

    def run(*lines):
        """Run commands one after another in one process, which has to import but once."""
        done = subprocess.run(
            [sys.executable, "-c", COMMANDS, *lines],
            cwd=work,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr

    (work / "tiny.toml").write_text(RECIPE)
    symsol_source.write_zip(work / "symsol.zip", symsol_source.content(("tet",))[0])
    run("render --object tetX --train 16 --test 16 --size 16 --workers 1", "import-symsol symsol.zip")
    shard = next((work / "data" / "tetX").glob("test-*.h5"))
    damaged = bytearray(shard.read_bytes())
    damaged[len(damaged) // 2] ^= 1
    shard.write_bytes(damaged)
    run(
        "verify data/tetX --repair",
        "reference data/tetX --row evenly-placed --row uniform",
        *["gallery data/tetX --redrawn 0", "publish data/tetX --out bundle"] * 2,
        "train tiny.toml --data data/tetX --device cpu",
        "predict runs/tetX-tiny --data data/tetX --device cpu",
        "score preds.h5 --data data/tetX --json scores.json --per-image scores.csv",
    )
    return before, {folder: snapshot(folder) for folder in (temporary, work)}


def test_each_of_a_users_files_is_as_it_was(user):
    before, after = user
    for folder, there in before.items():
        assert {name: after[folder].get(name) for name in there if there[name][0][0] != "d"} == {
            name: what for name, what in there.items() if what[0][0] != "d"
        }
        assert set(there) <= set(after[folder])


def test_nothing_is_left_among_the_temporary_files(user):
    """Not even what a killed run had left there; torch's own cache, which its import makes, is torch's."""
    before, after = user
    temporary = next(folder for folder in before if folder.name == "tmp")
    left = {name for name in after[temporary] if not name.startswith("torchinductor_")}
    assert left == set(before[temporary])


def test_nothing_but_outputs_is_new(user):
    before, after = user
    work = next(folder for folder in before if folder.name == "work")
    new = {
        Path(name).parts[0]
        if Path(name).parts[0] not in ("data", "runs", "symsol", "reference")
        else "/".join(Path(name).parts[:2])
        for name in set(after[work]) - set(before[work])
    }
    assert new == {
        "data/tetX",
        "reference/evenly-placed.json",
        "reference/uniform.json",
        "gallery",
        "bundle",
        "tiny.toml",
        "runs/tetX-tiny",
        "preds.h5",
        "scores.json",
        "scores.csv",
        "symsol.zip",
        "symsol/tet",
    }
