"""What a Blender process leaves in the folders of whoever runs it, and what it says where it cannot have its own."""

import errno
import os
import subprocess
import sys

import pytest
from conftest import make_plan

from symsol_annot.errors import OutputError
from symsol_annot.shard_process import Limits, ShardProcess

PLAN = make_plan("tetX", test=4, size=48)
MAKE_A_SHARD = """
from conftest import make_plan
from symsol_annot.shard_process import Limits, ShardProcess
plan = make_plan("tetX", test=4, size=48)
process = ShardProcess(plan, Limits())
process.make(plan.manifest().shards[0], lambda made: None)
process.close()
"""


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
