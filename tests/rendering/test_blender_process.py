"""What a Blender process leaves in the folders of whoever runs it, and what it says where it cannot have its own."""

import errno
import os
import subprocess
import sys

import pytest
from bench_sets import SmallDisk
from made_sets import make_plan

from symsol_annot.errors import OutputError, RendererCrashedError
from symsol_annot.generation.process import Limits, ShardProcess
from symsol_annot.rendering.blender_process import BlenderProcess

PLAN = make_plan("tetX", test=4, size=48)
MAKE_A_SHARD = """
from made_sets import make_plan
from symsol_annot.generation.process import Limits, ShardProcess
from symsol_annot.rendering.blender_process import BlenderProcess
plan = make_plan("tetX", test=4, size=48)
process = ShardProcess(plan, Limits())
process.make(plan.manifest().shards[0], lambda made: None)
process.close()
"""
CALL_MAIN = "from symsol_annot_cli.main import main; main()"


@pytest.fixture
def temporary_disk(tmp_path):
    """A small disk for temporary files alone."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    disk = SmallDisk(folder)
    yield disk
    disk.unmount()


def fill(folder, left):
    """Fill a disk until so many bytes are left."""
    status = os.statvfs(folder)
    with (folder / "ballast").open("wb") as file:
        file.write(bytes(max(status.f_bavail * status.f_frsize - left, 0)))


def render_with(temporary, out):
    words = f"render --object tetX --train 0 --test 32 --size 32 --workers 1 --out {out}"
    environment = {**os.environ, "TMPDIR": str(temporary)}
    command = [sys.executable, "-c", CALL_MAIN, *words.split()]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300, check=False)


@pytest.mark.parametrize("function", ["mkdtemp", "TemporaryFile"])
def test_no_room_for_temporary_files_is_an_error_that_says_what_to_do_and_leaves_none(tmp_path, monkeypatch, function):
    def refuse(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device", str(tmp_path))

    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    monkeypatch.setattr(f"tempfile.{function}", refuse)
    words = "temporary files cannot be written: .*No space left on device.*set TMPDIR to another folder"
    with pytest.raises(OutputError, match=words):
        ShardProcess(PLAN, Limits())
    assert list(tmp_path.iterdir()) == []


@pytest.mark.blender
def test_blender_leaves_nothing_in_the_home_folder_or_among_temporary_files(tmp_path):
    home, temporary = tmp_path / "home", tmp_path / "temporary"
    home.mkdir()
    temporary.mkdir()
    folders = {"HOME": str(home), "TMPDIR": str(temporary), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    kept = {key: value for key, value in os.environ.items() if not key.startswith("XDG_")}
    subprocess.run([sys.executable, "-c", MAKE_A_SHARD], env={**kept, **folders}, check=True)
    assert list(home.rglob("*")) == []
    assert list(temporary.rglob("*")) == []


@pytest.mark.blender
@pytest.mark.parametrize("pages_left", [0, 1, 2, 16])
def test_temporary_files_that_find_no_or_little_room_cost_no_blender(temporary_disk, tmp_path, pages_left):
    """Mesa's shader cache maps a file there; on a full disk it would end each process that writes to it (SIGBUS)."""
    temporary_disk.resize(1024)
    fill(temporary_disk.folder, pages_left * os.sysconf("SC_PAGE_SIZE"))
    ended = render_with(temporary_disk.folder, tmp_path / "data")
    assert "begun again" not in ended.stdout + ended.stderr
    if ended.returncode == 0:
        assert len(list((tmp_path / "data" / "tetX").glob("*.h5"))) == 2
    else:
        (error,) = [line for line in ended.stderr.splitlines() if "Error" in line]
        assert "temporary files cannot be written: " in error
        assert "set TMPDIR to another folder" in error
    assert [path.name for path in temporary_disk.folder.iterdir()] == ["ballast"]


@pytest.mark.blender
@pytest.mark.parametrize(
    ("ending", "how"),
    [
        ("raise MemoryError", r"ended with exit code 1 \(memory ran out: fewer --workers need less\)"),
        ("sys.stderr.write('std::bad_alloc'); sys.stderr.flush(); os.abort()", r"ended by signal SIGABRT \(memory ran"),
        ("os.abort()", r"ended by signal SIGABRT\. Its last output"),
    ],
)
def test_a_process_that_ran_out_of_memory_is_said_to_have(tmp_path, monkeypatch, ending, how):
    (tmp_path / "ending.py").write_text(f"import os, sys\n{ending}\n")
    monkeypatch.syspath_prepend(tmp_path)
    process = BlenderProcess("ending", None)
    with pytest.raises(RendererCrashedError, match=how):
        process.first_answer()
    process.close()
