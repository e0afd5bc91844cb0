"""Folders held by one process alone, and what is done where a file system cannot tell."""

import errno
import logging
import os
import subprocess
import sys
from functools import partial

import pytest
from made_sets import SIZE, make_plan, threads
from numpy_renderer import NumpyRenderer
from tampering import descriptors

from symsol_annot.errors import OutputError
from symsol_annot.generation.generate import generate
from symsol_annot.sets.dataset import load
from symsol_annot.sets.verify import verify
from symsol_annot.system import locks
from symsol_annot.system.locks import Held, held_folder, locked, try_lock

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows locks no folders")

HOLDING = """
import sys
from pathlib import Path
from symsol_annot.system.locks import locked
with locked(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def other(tmp_path):
    """Another process that holds tmp_path."""
    command = [sys.executable, "-c", HOLDING, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout.readline() == "held\n"
        yield process
        process.kill()


def probed(folder):
    """Who holds a folder, as one who would like to hold it is told."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        return try_lock(descriptor)
    finally:
        os.close(descriptor)


def without_locks(monkeypatch, number):
    def refuse(*_):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(locks.fcntl, "flock", refuse)


def test_folder_that_another_process_holds_is_refused_by_the_name_of_who_holds_it(tmp_path, other):
    who = rf" \({other.pid}: .*python.*\)" if sys.platform == "linux" else ""
    for hold in (locked, held_folder):
        with pytest.raises(OutputError, match=f"another process{who} is writing there right now"), hold(tmp_path):
            pass


def test_lock_ends_with_its_process_however_that_ends(tmp_path, other):
    assert probed(tmp_path) is Held.ELSEWHERE
    other.kill()
    other.wait()
    assert probed(tmp_path) is Held.HERE


def test_lock_ends_with_its_block_and_leaves_no_file(tmp_path):
    before = descriptors()
    for _ in range(2):
        with locked(tmp_path):
            assert list(tmp_path.iterdir()) == []
    with pytest.raises(ZeroDivisionError), locked(tmp_path):
        raise ZeroDivisionError
    assert descriptors() == before


def test_folder_that_was_removed_meanwhile_is_not_held(tmp_path, monkeypatch):
    folder, flock = tmp_path / "folder", locks.fcntl.flock
    folder.mkdir()

    def remove_and_lock(*arguments):
        folder.rmdir()
        flock(*arguments)

    monkeypatch.setattr(locks.fcntl, "flock", remove_and_lock)
    with pytest.raises(FileNotFoundError), locked(folder):
        pass


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.ENOTSUP, errno.EBADF, errno.EINVAL, errno.EIO])
def test_file_system_without_locks_lets_everybody_in_and_says_that_it_cannot_tell(
    tmp_path, monkeypatch, caplog, number
):
    without_locks(monkeypatch, number)
    descriptor = os.open(tmp_path, os.O_RDONLY)
    assert try_lock(descriptor) is Held.UNKNOWN
    os.close(descriptor)
    with caplog.at_level(logging.WARNING, logger="symsol_annot"), locked(tmp_path), locked(tmp_path):
        pass
    assert f"{tmp_path}: this file system has no locks, so whether another process writes there" in caplog.text


def test_set_is_made_continued_verified_and_loaded_without_locks(tmp_path, monkeypatch):
    without_locks(monkeypatch, errno.ENOLCK)
    for _ in range(2):
        generate(make_plan("tetX", test=3), tmp_path / "tetX", threads(partial(NumpyRenderer, "tetX", SIZE)))
    assert verify(tmp_path / "tetX") == []
    assert len([sample.symmetry_set for sample in load(tmp_path / "tetX")]) == 3


def test_held_folder_is_made_and_removed_again_where_nothing_was_put_in_it(tmp_path):
    with held_folder(tmp_path / "a" / "b"):
        assert (tmp_path / "a" / "b").is_dir()
    assert list(tmp_path.iterdir()) == []
    with held_folder(tmp_path / "a" / "b"):
        (tmp_path / "a" / "b" / "file").touch()
    assert (tmp_path / "a" / "b" / "file").exists()


def test_held_folder_that_was_there_stays(tmp_path):
    (tmp_path / "mine").mkdir()
    with held_folder(tmp_path / "mine"):
        pass
    assert (tmp_path / "mine").is_dir()
