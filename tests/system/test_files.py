"""Files and folders that are written beside their names: whole, or as if nobody had begun."""

import errno
import os
import signal
import stat
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from symsol_annot.errors import OutputError
from symsol_annot.system.files import new_folder, replaced, replaced_folder, write_atomically
from symsol_annot.system.scratch import sweep

FULL = OSError(errno.ENOSPC, "No space left on device")
STOPS = [(KeyboardInterrupt(), KeyboardInterrupt), (ValueError("mine"), ValueError), (FULL, OutputError)]
stops = pytest.mark.parametrize(("stop", "seen"), STOPS)


def everything(folder):
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()
    }


def test_a_file_is_replaced_only_once_it_is_whole(tmp_path):
    path = tmp_path / "file"
    path.write_bytes(b"before")
    with replaced(path) as partial:
        partial.write_bytes(b"after")
        assert path.read_bytes() == b"before"
    assert everything(tmp_path) == {"file": b"after"}


def write_half(manager, path, stop):
    with manager(path) as partial:
        (partial / "file" if partial.is_dir() else partial).write_bytes(b"half")
        raise stop


@stops
def test_a_file_that_was_not_finished_is_as_it_was(tmp_path, stop, seen):
    path = tmp_path / "file"
    path.write_bytes(b"before")
    with pytest.raises(seen):
        write_half(replaced, path, stop)
    assert everything(tmp_path) == {"file": b"before"}


def test_a_full_disk_is_said_in_words_that_hold_for_any_file(tmp_path):
    with pytest.raises(OutputError) as refused:
        write_half(replaced, tmp_path / "plot.png", FULL)
    path = tmp_path / "plot.png"
    advice = "the disk is full: make room, then run the same command again"
    assert str(refused.value) == f"{path}: cannot be written: {advice}"


def test_a_file_keeps_its_mode_and_a_new_one_gets_the_usual(tmp_path):
    path, new = tmp_path / "file", tmp_path / "new"
    path.write_bytes(b"before")
    path.chmod(0o600)
    for each in (path, new):
        write_atomically(each, b"after")
    assert stat.S_IMODE(path.stat().st_mode) == 0o600
    usual = tmp_path / "usual"
    usual.touch()
    assert new.stat().st_mode == usual.stat().st_mode


@pytest.mark.parametrize("is_there", [True, False])
def test_a_link_stays_a_link_and_its_file_is_written(tmp_path, is_there):
    target, link = tmp_path / "elsewhere" / "file", tmp_path / "link"
    target.parent.mkdir()
    if is_there:
        target.write_bytes(b"before")
    link.symlink_to(Path("elsewhere", "file"))
    write_atomically(link, b"after")
    assert link.is_symlink()
    assert everything(tmp_path) == {"elsewhere/file": b"after", "link": b"after"}


def test_a_pipe_gets_the_bytes_and_stays_a_pipe(tmp_path):
    pipe, got = tmp_path / "pipe", []
    os.mkfifo(pipe)
    reader = threading.Thread(target=lambda: got.append(pipe.read_bytes()))
    reader.start()
    write_atomically(pipe, b"x" * 2**20)
    reader.join()
    assert got == [b"x" * 2**20]
    assert pipe.is_fifo()
    assert [path.name for path in tmp_path.iterdir()] == ["pipe"]


@pytest.mark.parametrize("device", ["/dev/null", "/dev/full"])
def test_a_device_stays_a_device(device):
    before = Path(device).stat()
    if device == "/dev/full":
        with pytest.raises(OutputError, match="the disk is full"):
            write_atomically(Path(device), b"x")
    else:
        write_atomically(Path(device), b"x")
    after = Path(device).stat()
    assert (after.st_mode, after.st_rdev, after.st_ino) == (before.st_mode, before.st_rdev, before.st_ino)


def test_standard_output_that_goes_to_a_file_keeps_what_was_written_before(tmp_path):
    code = "import sys; from pathlib import Path; from symsol_annot.system.files import write_atomically as write\n"
    code += "print('a table', flush=True); write(Path('/dev/stdout'), b'figures')"
    with (tmp_path / "out").open("wb") as out:
        subprocess.run([sys.executable, "-c", code], stdout=out, check=True)
    assert everything(tmp_path) == {"out": b"a table\nfigures"}


def test_what_has_an_unlucky_name_beside_a_file_or_folder_stays(tmp_path):
    mine = {".file.partial", ".folder.partial", ".folder.before", ".symsol-annot-mine/file", ".file.new", "file~"}
    for name in mine:
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"mine")
    (tmp_path / "folder").mkdir()
    write_atomically(tmp_path / "file", b"ours")
    for manager in (new_folder, replaced_folder):
        with manager(tmp_path / "folder") as new:
            (new / "file").write_bytes(b"ours")
        sweep(tmp_path)
        (tmp_path / "folder" / "file").unlink()
    found = everything(tmp_path)
    assert found.pop("file") == b"ours"
    assert found == dict.fromkeys(mine, b"mine")


def test_a_file_that_cannot_take_its_name_leaves_nothing(tmp_path):
    (tmp_path / "name").mkdir()
    with pytest.raises(OutputError, match="name: cannot be written"):
        write_atomically(tmp_path / "name", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["name"]


@pytest.mark.parametrize("manager", [new_folder, replaced_folder])
def test_a_folder_appears_once_it_is_whole(tmp_path, manager):
    for name in ("absent", "empty"):
        if name == "empty":
            (tmp_path / name).mkdir()
        with manager(tmp_path / name) as partial:
            (partial / "file").write_bytes(b"whole")
            assert not (tmp_path / name / "file").exists()
    assert everything(tmp_path) == {"absent/file": b"whole", "empty/file": b"whole"}
    assert len(list(tmp_path.iterdir())) == 2


@stops
@pytest.mark.parametrize("manager", [new_folder, replaced_folder])
def test_a_folder_that_was_not_finished_leaves_nothing(tmp_path, manager, stop, seen):
    with pytest.raises(seen):
        write_half(manager, tmp_path / "folder", stop)
    assert list(tmp_path.iterdir()) == []


def test_a_new_folder_does_not_take_the_place_of_what_was_put_there_meanwhile(tmp_path):
    opened = new_folder(tmp_path / "folder")
    (opened.__enter__() / "file").write_bytes(b"ours")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "notes").write_bytes(b"somebody's")
    with pytest.raises(OutputError, match="not empty"):
        opened.__exit__(None, None, None)
    assert everything(tmp_path) == {"folder/notes": b"somebody's"}


def test_a_folder_is_replaced_with_all_that_it_held(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "old").write_bytes(b"before")
    with replaced_folder(tmp_path / "folder") as partial:
        (partial / "new").write_bytes(b"after")
        assert everything(tmp_path / "folder") == {"old": b"before"}
    assert everything(tmp_path) == {"folder/new": b"after"}
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


@stops
def test_a_folder_whose_replacement_was_not_finished_is_as_it_was(tmp_path, stop, seen):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "old").write_bytes(b"before")
    with pytest.raises(seen):
        write_half(replaced_folder, tmp_path / "folder", stop)
    assert everything(tmp_path) == {"folder/old": b"before"}
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_folder_comes_back_where_the_new_one_cannot_take_its_name(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "old").write_bytes(b"before")
    with pytest.raises(OutputError), replaced_folder(tmp_path / "folder") as partial:
        partial.rmdir()  # so that renaming it fails after the old one was moved away
    assert everything(tmp_path) == {"folder/old": b"before"}
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


KILLED = """
import os, signal, sys
from pathlib import Path
from symsol_annot.system.files import new_folder, replaced, replaced_folder
path, when = Path(sys.argv[1]), sys.argv[3]
rename = Path.rename
def rename_and_die(self, target):
    rename(self, target)
    if "waiting" in str(target):
        os.kill(os.getpid(), signal.SIGKILL)
if when == "between two names":
    Path.rename = rename_and_die
with {"replaced": replaced, "new_folder": new_folder, "replaced_folder": replaced_folder}[sys.argv[2]](path) as new:
    (new / "file" if new.is_dir() else new).write_bytes(b"half")
    if when == "half way":
        os.kill(os.getpid(), signal.SIGKILL)
"""


def kill_a_writer(path, manager, when="half way"):
    ended = subprocess.run([sys.executable, "-c", KILLED, str(path), manager, when], check=False)
    assert ended.returncode == -signal.SIGKILL
    assert any(name.name.startswith(".symsol-annot-") for name in path.parent.iterdir())


@pytest.mark.parametrize("manager", ["replaced", "new_folder", "replaced_folder"])
def test_what_a_killed_writer_left_is_swept_up(tmp_path, manager):
    kill_a_writer(tmp_path / "name", manager)
    sweep(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_a_folder_that_a_killed_writer_moved_away_comes_back(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "old").write_bytes(b"before")
    kill_a_writer(tmp_path / "folder", "replaced_folder", "between two names")
    assert not (tmp_path / "folder").exists()
    sweep(tmp_path)
    assert everything(tmp_path) == {"folder/old": b"before"}
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_a_folder_that_a_killed_writer_moved_away_stays_where_its_name_was_taken(tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "old").write_bytes(b"before")
    kill_a_writer(tmp_path / "folder", "replaced_folder", "between two names")
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "mine").write_bytes(b"mine")
    sweep(tmp_path)
    found = everything(tmp_path)
    assert found.pop("folder/mine") == b"mine"
    assert b"before" in found.values()
