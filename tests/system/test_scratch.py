"""Temporary folders: those of the living stay, those of the dead go."""

import errno
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from symsol_annot.system.scratch import MARK_NAME, Scratch, is_marked, sweep

OWNER = """
import sys, time
from symsol_annot.system.scratch import Scratch
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


def test_a_sweep_touches_nothing_foreign_and_follows_no_link(temporary):
    (temporary / "another-program").mkdir()
    elsewhere = temporary / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "mine").write_text("x")
    (temporary / "symsol-annot-link").symlink_to(elsewhere)
    (temporary / "symsol-annot-file").write_text("x")
    before = sorted(temporary.rglob("*"))
    sweep()
    assert sorted(temporary.rglob("*")) == before


def test_a_sweep_leaves_a_users_folders_of_every_unlucky_name_and_content(temporary):
    """Neither name nor mark alone says that this program made a folder: a mark names its folder by inode."""
    left = killed_owner_left()
    (temporary / "symsol-annot-results").mkdir()
    (temporary / "symsol-annot-results" / "thesis.h5").write_text("x")
    (temporary / "symsol-annot-main").mkdir()
    shutil.copytree(left, temporary / "symsol-annot-copy")
    forged = temporary / "symsol-annot-forged"
    forged.mkdir()
    (forged / MARK_NAME).symlink_to(left / MARK_NAME)
    (temporary / "symsol-annot-link").symlink_to(left)
    before = {path for path in temporary.rglob("*") if left not in (path, *path.parents)}
    sweep()
    assert set(temporary.rglob("*")) == before


def test_a_folder_of_another_user_is_left_alone(temporary, monkeypatch):
    left = killed_owner_left()
    monkeypatch.setattr("os.getuid", lambda: left.lstat().st_uid + 1)
    sweep()
    assert left.is_dir()


def test_nothing_is_swept_where_the_file_system_has_no_locks(temporary, monkeypatch):
    left = killed_owner_left()
    monkeypatch.setattr("symsol_annot.system.locks.fcntl.flock", no_locks)
    sweep()
    assert left.is_dir()


def test_a_folder_can_be_had_where_the_file_system_has_no_locks(temporary, monkeypatch):
    monkeypatch.setattr("symsol_annot.system.locks.fcntl.flock", no_locks)
    with Scratch() as scratch:
        assert is_marked(scratch.path)
    assert list(temporary.iterdir()) == []


def test_a_folder_that_is_swept_while_it_is_made_stays(temporary, monkeypatch):
    mkdtemp = Scratch.__init__.__globals__["tempfile"].mkdtemp

    def sweeping_mkdtemp(**arguments):
        path = mkdtemp(**arguments)
        sweep()
        return path

    monkeypatch.setattr("symsol_annot.system.scratch.tempfile.mkdtemp", sweeping_mkdtemp)
    with Scratch() as scratch:
        sweep()
        assert is_marked(scratch.path)


def test_closing_leaves_a_folder_that_took_the_name_meanwhile(temporary):
    scratch = Scratch()
    scratch.path.rename(temporary / "moved")
    scratch.path.mkdir()
    (scratch.path / "mine").write_text("x")
    scratch.close()
    assert (scratch.path / "mine").read_text() == "x"


def test_too_many_open_files_are_an_error_and_leave_no_folder(temporary, monkeypatch):
    open_file = os.open

    def refuse(path, flags, *more):
        if flags & os.O_DIRECTORY:
            raise OSError(errno.EMFILE, "Too many open files")
        return open_file(path, flags, *more)

    monkeypatch.setattr("symsol_annot.system.scratch.os.open", refuse)
    with pytest.raises(OSError, match="Too many open files"):
        Scratch()
    monkeypatch.undo()
    assert list(temporary.iterdir()) == []


def no_locks(*_):
    raise OSError(errno.ENOLCK, "No locks available")


def killed_owner_left():
    """The folder that a killed owner left, of which only the mark and the lock tell that it may go."""
    with subprocess.Popen([sys.executable, "-c", OWNER], stdout=subprocess.PIPE, text=True) as owner:
        left = Path(owner.stdout.readline().strip())
        owner.send_signal(signal.SIGKILL)
        owner.wait()
    return left


def test_a_folder_that_cannot_go_keeps_its_mark_for_a_later_sweep(temporary, monkeypatch):
    """As where the folder for temporary files is made read-only meanwhile; root could still remove from it."""
    scratch, rmdir = Scratch(), Path.rmdir

    def refuse(path):
        raise PermissionError(errno.EACCES, "Permission denied", str(path))

    (scratch.path / "a frame").write_text("x")
    (scratch.path / "deep" / "er").mkdir(parents=True)
    monkeypatch.setattr(Path, "rmdir", refuse)
    scratch.close()
    assert [path.name for path in scratch.path.iterdir()] == [MARK_NAME]
    assert is_marked(scratch.path)
    monkeypatch.setattr(Path, "rmdir", rmdir)
    sweep()
    assert list(temporary.iterdir()) == []
