"""Files and folders that are written beside their names: whole, or as if nobody had begun."""

import errno

import pytest

from symsol_annot.errors import OutputError
from symsol_annot.files import new_folder, replaced, replaced_folder, write_atomically

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


def test_a_file_that_cannot_take_its_name_leaves_nothing(tmp_path):
    (tmp_path / "name").mkdir()
    with pytest.raises(OutputError, match="name: cannot be written"):
        write_atomically(tmp_path / "name", b"whole")
    assert [path.name for path in tmp_path.iterdir()] == ["name"]


def test_a_link_that_somebody_left_beside_a_file_is_not_followed(tmp_path):
    (tmp_path / "elsewhere").write_bytes(b"somebody's")
    (tmp_path / ".file.partial").symlink_to(tmp_path / "elsewhere")
    with replaced(tmp_path / "file") as partial:
        partial.write_bytes(b"ours")
    assert everything(tmp_path) == {"elsewhere": b"somebody's", "file": b"ours"}


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


@pytest.mark.parametrize("manager", [new_folder, replaced_folder])
def test_what_a_killed_writer_left_is_swept_up(tmp_path, manager):
    (tmp_path / ".folder.partial").mkdir()
    (tmp_path / ".folder.partial" / "file").write_bytes(b"half")
    with manager(tmp_path / "folder") as partial:
        (partial / "other").write_bytes(b"whole")
    assert everything(tmp_path) == {"folder/other": b"whole"}


@pytest.mark.parametrize("there", ["nothing", "an empty folder", "the next one"])
def test_a_folder_that_a_killed_writer_moved_away_comes_back_where_no_other_came(tmp_path, there):
    path, before = tmp_path / "folder", tmp_path / ".folder.before"
    before.mkdir()
    (before / "old").write_bytes(b"before")
    if there != "nothing":
        path.mkdir()
    if there == "the next one":
        (path / "new").write_bytes(b"after")
    with pytest.raises(KeyboardInterrupt):
        write_half(replaced_folder, path, KeyboardInterrupt())
    kept = {"folder/new": b"after"} if there == "the next one" else {"folder/old": b"before"}
    assert everything(tmp_path) == kept
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
