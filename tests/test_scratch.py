"""Temporary folders: those of the living stay, those of the dead go."""

import errno
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from symsol_annot.scratch import Scratch, sweep

OWNER = """
import sys, time
from symsol_annot.scratch import Scratch
scratch = Scratch()
(scratch.path / "half a frame").write_text("x")
print(scratch.path, flush=True)
time.sleep(600)
"""


@pytest.fixture
def temporary(tmp_path, monkeypatch):
    """What `tempfile` calls the temporary folder, here and in child processes."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    return tmp_path


def test_a_folder_is_removed_when_it_is_closed_and_no_descriptor_is_left(temporary):
    before = len(list(Path("/proc/self/fd").iterdir()))
    scratch = Scratch()
    assert scratch.path.is_dir()
    assert scratch.path.parent == temporary
    scratch.close()
    scratch.close()
    assert list(temporary.iterdir()) == []
    assert len(list(Path("/proc/self/fd").iterdir())) == before


def test_a_sweep_removes_what_a_killed_owner_left_and_nothing_of_the_living(temporary):
    mine = Scratch()
    with subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE, text=True) as owner:
        theirs = Path(owner.stdout.readline().strip())
        sweep()
        assert theirs.is_dir()
        owner.send_signal(signal.SIGKILL)
        owner.wait()
    assert theirs.is_dir()
    sweep()
    assert list(temporary.iterdir()) == [mine.path]
    mine.close()


def test_a_sweep_touches_no_stranger_and_follows_no_link(temporary):
    (temporary / "another-program").mkdir()
    elsewhere = temporary / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine").write_text("x")
    (temporary / "symsol-annot-link").symlink_to(elsewhere)
    (temporary / "symsol-annot-file").write_text("x")
    before = sorted(temporary.rglob("*"))
    sweep()
    assert sorted(temporary.rglob("*")) == before


def test_a_folder_that_is_swept_while_it_is_made_is_made_again(temporary, monkeypatch):
    """A sweep between the folder's making and its locking."""
    mkdtemp, swept = Scratch.__init__.__globals__["tempfile"].mkdtemp, []

    def sweeping_mkdtemp(**arguments):
        path = mkdtemp(**arguments)
        if not swept:
            swept.append(path)
            sweep()
        return path

    monkeypatch.setattr("symsol_annot.scratch.tempfile.mkdtemp", sweeping_mkdtemp)
    scratch = Scratch()
    assert scratch.path.is_dir()
    assert str(scratch.path) != swept[0]
    scratch.close()


def test_too_many_open_files_are_an_error_and_leave_no_folder(temporary, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr("symsol_annot.scratch._locked_descriptor", refuse)
    with pytest.raises(OSError, match="Too many open files"):
        Scratch()
    monkeypatch.undo()
    assert list(temporary.iterdir()) == []
