"""Ctrl-C while a set is made: what it says, what it leaves, and how the work is resumed."""

import contextlib
import hashlib
import json
import os
import shutil
import signal
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from uuid import uuid4

import pytest
from command_line import INTERRUPTIBLE, LONGER_SET, contents, symsol


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
    assert f"Finished shards in {interrupted.folder} are kept; re-running the command resumes it" in interrupted.stderr
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
