"""A cache gives back what was put there or nothing, is bounded, removes files of its own alone, and never fails."""

import os
import shutil
from pathlib import Path

import pytest

from symsol_annot.system import cache
from symsol_annot.system.cache import Cache, user_cache_folder

A, B, C = ("a" * 64, "b" * 64, "c" * 64)


def test_what_was_put_comes_back_by_its_key(tmp_path):
    kept = Cache(tmp_path / "new" / "folder")
    assert kept.get(A) is None
    assert kept.put(A, b"one", memoryview(b" and two"))
    assert kept.get(A) == b"one and two"
    assert kept.get(B) is None
    assert [path.name for path in (tmp_path / "new" / "folder").iterdir()] == [f"{A}.cached"]


@pytest.mark.parametrize("damage", ["a bit", "cut", "longer", "empty", "another program's", "a pipe", "a folder"])
def test_what_is_damaged_is_not_there_and_can_be_put_again(damage, tmp_path):
    kept, path = Cache(tmp_path), tmp_path / f"{A}.cached"
    kept.put(A, b"0123456789")
    whole = path.read_bytes()
    path.unlink()
    if damage == "a pipe":
        os.mkfifo(path)
    elif damage == "a folder":
        path.mkdir()
    else:
        made = {"a bit": whole[:-1] + b"8", "cut": whole[:-1], "longer": whole + b"0", "empty": b""}
        path.write_bytes(made.get(damage, b"0123456789" * 20))
    assert kept.get(A) is None
    can_be_put = damage not in ("a pipe", "a folder")
    assert kept.put(A, b"0123456789") is can_be_put
    assert kept.get(A) == (b"0123456789" if can_be_put else None)


def test_beyond_its_bound_what_was_used_longest_ago_goes_and_nothing_else(tmp_path):
    kept = Cache(tmp_path, max_bytes=3000)
    strangers = [tmp_path / "notes.txt", tmp_path / f"{'d' * 64}.cached", tmp_path / "short.cached"]
    for path in strangers:
        path.write_bytes(b"x" * 5000)
        os.utime(path, (1, 1))
    for number, key in enumerate((A, B)):
        kept.put(key, bytes(1000))
        os.utime(tmp_path / f"{key}.cached", (10 + number, 10 + number))
    assert kept.get(A) is not None  # which is a use of it
    assert kept.put(C, bytes(1000))
    assert (kept.get(A), kept.get(B), kept.get(C)) == (bytes(1000), None, bytes(1000))
    assert all(path.stat().st_size == 5000 for path in strangers)
    assert not kept.put(B, bytes(3001))


def test_a_folder_that_cannot_be_written_or_a_full_disk_keeps_nothing_and_raises_nothing(tmp_path, monkeypatch):
    (tmp_path / "file").write_text("")
    assert not Cache(tmp_path / "file" / "below").put(A, b"1")
    assert Cache(tmp_path / "file" / "below").get(A) is None
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(cache.shutil, "disk_usage", lambda _: usage._replace(free=100))
    assert not Cache(tmp_path).put(A, bytes(26))
    assert Cache(tmp_path).put(A, bytes(25))


def test_a_key_that_is_a_path_is_refused(tmp_path):
    with pytest.raises(ValueError, match="expected a key of 64 hexadecimal digits"):
        Cache(tmp_path).get("../" * 21 + "x")


def test_the_folder_of_a_user(monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", "/somewhere")
    assert user_cache_folder() == Path("/somewhere/symsol-annot")
    monkeypatch.setenv("HOME", "/home/ada")
    for wrong in ("", "relative"):  # which the standard says is to be ignored
        monkeypatch.setenv("XDG_CACHE_HOME", wrong)
        assert user_cache_folder() == Path("/home/ada/.cache/symsol-annot")
