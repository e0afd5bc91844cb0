"""Fetching: from a path and over real http, resumed, compared, and in place whole or not at all."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from archive_host import DATES, NOTHING, TAGS

import symsol_annot
from symsol_annot.archives import fetching
from symsol_annot.archives.fetching import fetch
from symsol_annot.errors import DataError, DownloadError, OutputError
from symsol_annot.sets.verify import verify

PATH = "/tetX.tar"


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def assert_in_place(fetched, out, packed_set):
    """The set, and nothing else, lies in the folder."""
    assert fetched.folder == out / "tetX"
    assert [path.name for path in out.iterdir()] == ["tetX"]
    assert contents(fetched.folder) == contents(packed_set)


def test_a_set_is_fetched_from_a_path_or_a_file_address_and_loads(packed_set, archive, tmp_path):
    for source in (str(archive), archive.as_uri(), f"file://localhost{archive}"):
        out = tmp_path / str(len(source))
        fetched = fetch(source, out)
        assert_in_place(fetched, out, packed_set)
        assert not fetched.was_there
        assert fetched.sha256 in archive.with_name("tetX.tar.sha256").read_text()
        assert verify(fetched.folder) == []
    assert len(symsol_annot.load(fetched.folder)) == 40


@pytest.mark.parametrize("has_ranges", [True, False])
@pytest.mark.parametrize("has_lengths", [True, False])
def test_a_set_is_fetched_over_http(packed_set, host, tmp_path, has_ranges, has_lengths):
    host.has_ranges, host.has_lengths, told = has_ranges, has_lengths, []
    fetched = fetch(f"{host.url}/tetX.tar", tmp_path, on_begin=lambda *what: told.append(what), on_bytes=told.append)
    assert_in_place(fetched, tmp_path, packed_set)
    size = len(host.files[PATH])
    assert told[0] == (size if has_lengths else None, 0)
    assert sum(told[1:]) == size
    assert host.of(PATH) == [(None, 200)]


def test_redirects_are_followed_and_addresses_may_have_a_query(packed_set, host, tmp_path):
    host.redirects = {"/newest?x=1": "/a", "/a": f"{host.url}/tetX.tar"}
    assert_in_place(fetch(f"{host.url}/newest?x=1", tmp_path), tmp_path, packed_set)


def break_off(host, out, after):
    host.cut_after = after
    with pytest.raises(DownloadError, match=r"broke off after .* MB.*the same command resumes it") as broken:
        fetch(f"{host.url}/tetX.tar", out)
    assert str(broken.value).startswith(f"{host.url}/tetX.tar: ")
    assert not (out / "tetX").exists()
    host.cut_after = None


@pytest.mark.parametrize("validators", [TAGS, DATES, NOTHING])
def test_a_download_that_broke_off_is_resumed_where_it_was(packed_set, host, tmp_path, validators):
    """By a tag, by a time of change, or by the digest alone: no byte is sent twice."""
    host.validators, size = validators, len(host.files[PATH])
    for _ in range(3):
        break_off(host, tmp_path, size // 5)
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)
    part = size // 5
    spans = [(f"bytes={number * part}-", 206) for number in (1, 2, 3)]
    assert host.of(PATH) == [(None, 200), *spans]
    assert host.sent == size + 4 * len(host.files["/tetX.tar.sha256"])


def test_without_ranges_a_download_begins_anew(packed_set, host, tmp_path):
    host.has_ranges = False
    break_off(host, tmp_path, len(host.files[PATH]) // 2)
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)
    assert [status for _, status in host.of(PATH)] == [200, 200]


def test_without_a_digest_and_a_tag_a_download_begins_anew(packed_set, host, tmp_path):
    del host.files["/tetX.tar.sha256"]
    host.validators = NOTHING
    break_off(host, tmp_path, len(host.files[PATH]) // 2)
    fetched = fetch(f"{host.url}/tetX.tar", tmp_path)
    assert_in_place(fetched, tmp_path, packed_set)
    assert fetched.sha256 is None
    assert host.of(PATH) == [(None, 200), (None, 200)]


@pytest.mark.parametrize(("validators", "longer"), [(TAGS, 0), (DATES, 0), (TAGS, 20_480), (NOTHING, 20_480)])
def test_an_archive_that_changed_meanwhile_is_not_put_together_from_two(packed_set, host, tmp_path, validators, longer):
    host.validators, whole = validators, host.files[PATH]
    host.files[PATH] = bytes(len(whole) + longer)
    break_off(host, tmp_path, len(whole) // 2)
    host.files[PATH] = whole
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)


def test_one_that_nothing_tells_apart_fails_by_its_digest_and_the_next_run_begins_anew(packed_set, host, tmp_path):
    host.validators, whole = NOTHING, host.files[PATH]
    host.files[PATH] = bytes(len(whole))
    break_off(host, tmp_path, len(whole) // 2)
    host.files[PATH] = whole
    with pytest.raises(DataError, match=r"expected SHA-256 .*Fetch it again"):
        fetch(f"{host.url}/tetX.tar", tmp_path)
    assert list(tmp_path.iterdir()) == []
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)


def test_one_that_changed_to_fewer_bytes_than_are_there_begins_anew(packed_set, host, tmp_path):
    host.validators, whole = NOTHING, host.files[PATH]
    host.files[PATH] = bytes(3 * len(whole))
    break_off(host, tmp_path, 2 * len(whole))
    host.files[PATH] = whole
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)
    assert [status for _, status in host.of(PATH)] == [200, 416, 200]


KILLED = """
import os, sys
from pathlib import Path
from symsol_annot.archives.fetching import fetch
fetch(sys.argv[1], Path(sys.argv[2]), on_bytes=lambda _: os._exit(9))
"""


def test_a_killed_run_is_resumed(packed_set, host, tmp_path):
    """It wrote one block, of at most 256 KiB, and its note."""
    host.files[PATH] += bytes(2**20)  # behind the end
    del host.files["/tetX.tar.sha256"]
    done = subprocess.run([sys.executable, "-c", KILLED, f"{host.url}/tetX.tar", tmp_path], check=False)
    assert done.returncode == 9
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)
    assert [status for _, status in host.of(PATH)] == [200, 206]


def test_a_download_that_is_whole_is_not_asked_for_again(packed_set, host, tmp_path, monkeypatch):
    def stopped(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(fetching, "read_archive", stopped)
        with pytest.raises(KeyboardInterrupt):
            fetch(f"{host.url}/tetX.tar", tmp_path)
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path), tmp_path, packed_set)
    assert host.of(PATH) == [(None, 200)]


# The digest


def test_a_wrong_digest_is_refused_and_the_next_run_downloads_anew(packed_set, host, tmp_path):
    whole = host.files[PATH]
    host.files[PATH] = bytes(len(whole))
    with pytest.raises(DataError, match=rf"expected SHA-256 \w+ \({host.url}/tetX\.tar\.sha256\), found \w+; nothing"):
        fetch(f"{host.url}/tetX.tar", tmp_path / "data")
    assert not (tmp_path / "data").exists()
    host.files[PATH] = whole
    assert_in_place(fetch(f"{host.url}/tetX.tar", tmp_path / "data"), tmp_path / "data", packed_set)


def test_a_digest_that_is_given_is_the_one_that_counts(packed_set, archive, host, tmp_path):
    right = archive.with_name("tetX.tar.sha256").read_text().split()[0]
    with pytest.raises(DataError, match=r"--sha256 is 0+, and .*sha256 states .*nothing was fetched"):
        fetch(f"{host.url}/tetX.tar", tmp_path, "0" * 64)
    assert host.of(PATH) == []
    del host.files["/tetX.tar.sha256"]
    with pytest.raises(DataError, match=r"expected SHA-256 0+ \(--sha256\), found"):
        fetch(f"{host.url}/tetX.tar", tmp_path, "0" * 64)
    fetched = fetch(f"{host.url}/tetX.tar", tmp_path, right.upper())
    assert_in_place(fetched, tmp_path, packed_set)
    assert fetched.sha256 == right


@pytest.mark.parametrize("text", [b"<html>sorry</html>", b"", b"0" * 63, b"1" * 64 + b"  a\n" + b"2" * 64 + b"  b\n"])
def test_a_page_in_place_of_a_digest_is_an_error_that_says_what_to_do(archive, host, tmp_path, text):
    host.files["/tetX.tar.sha256"] = text
    with pytest.raises(DataError, match=r"tetX\.tar\.sha256: expected one line as sha256sum writes it.*--sha256"):
        fetch(f"{host.url}/tetX.tar", tmp_path)
    fetch(f"{host.url}/tetX.tar", tmp_path, archive.with_name("tetX.tar.sha256").read_text().split()[0])


def test_a_list_of_many_digests_is_searched_for_the_archives(archive, host, tmp_path):
    host.files["/tetX.tar.sha256"] = b"0" * 64 + b"  cylO.tar\n" + host.files["/tetX.tar.sha256"]
    assert fetch(f"{host.url}/tetX.tar", tmp_path).sha256 in archive.with_name("tetX.tar.sha256").read_text()


# What is there already


def test_a_set_that_is_there_and_whole_is_said_to_be_there_and_not_downloaded(packed_set, host, tmp_path):
    fetch(f"{host.url}/tetX.tar", tmp_path)
    before = {path: path.stat().st_mtime_ns for path in (tmp_path / "tetX").iterdir()}
    again = fetch(f"{host.url}/tetX.tar", tmp_path)
    assert again.was_there
    assert len(host.of(PATH)) == 1
    del host.files["/tetX.tar.sha256"]
    assert fetch(f"{host.url}/tetX.tar", tmp_path).was_there
    assert {path: path.stat().st_mtime_ns for path in (tmp_path / "tetX").iterdir()} == before


@pytest.mark.parametrize("has_digest", [True, False])
@pytest.mark.parametrize("there", ["a file", "another file", "a damaged set", "a set without a shard", "a link"])
def test_what_else_is_there_is_not_touched(packed_set, host, tmp_path, there, has_digest):
    if not has_digest:
        del host.files["/tetX.tar.sha256"]
    folder = tmp_path / "data" / "tetX"
    folder.parent.mkdir()
    if there == "a file":
        folder.write_text("mine")
    elif there == "another file":
        folder.mkdir()
        (folder / "notes.txt").write_text("mine")
    elif there == "a link":
        folder.symlink_to(tmp_path / "nowhere")
    else:
        shutil.copytree(packed_set, folder)
        shard = folder / "test-00001-of-00003.h5"
        shard.unlink()
        if there == "a damaged set":
            shard.write_bytes(b"damaged")
    before = {path: path.lstat().st_mtime_ns for path in [folder, *folder.rglob("*")]}
    with pytest.raises(OutputError, match=rf"{folder}: is there already.*nothing was touched.*--out"):
        fetch(f"{host.url}/tetX.tar", folder.parent)
    assert {path: path.lstat().st_mtime_ns for path in [folder, *folder.rglob("*")]} == before
    assert not (tmp_path / "nowhere").exists()
    if has_digest:
        assert host.of(PATH) == []


def test_an_empty_folder_is_filled(packed_set, archive, tmp_path):
    (tmp_path / "tetX").mkdir()
    assert_in_place(fetch(str(archive), tmp_path), tmp_path, packed_set)


@pytest.mark.parametrize("name", ["notes.txt", "download.json"])
def test_a_folder_of_the_downloads_name_that_is_somebody_elses_is_not_touched(host, tmp_path, name):
    break_off(host, tmp_path, 1000)
    (place,) = tmp_path.iterdir()
    (place / name).write_text("mine")
    with pytest.raises(OutputError, match=r"no download of this command; nothing was touched.*--out"):
        fetch(f"{host.url}/tetX.tar", tmp_path)
    assert (place / name).read_text() == "mine"
    assert (place / "archive.part").stat().st_size == 1000


def test_a_link_in_place_of_a_download_is_not_written_through(host, tmp_path):
    break_off(host, tmp_path / "data", 1000)
    (place,) = (tmp_path / "data").iterdir()
    (tmp_path / "theirs").write_text("mine")
    (place / "archive.part").unlink()
    (place / "archive.part").symlink_to(tmp_path / "theirs")
    with pytest.raises(OutputError, match="nothing was touched"):
        fetch(f"{host.url}/tetX.tar", tmp_path / "data")
    assert (tmp_path / "theirs").read_text() == "mine"


def test_two_at_once_are_told_apart(host, tmp_path):
    """The second is refused, and the first is not disturbed."""
    seen = []

    def again(*_):
        if not seen:
            with pytest.raises(OutputError, match="another process") as refused:
                fetch(f"{host.url}/tetX.tar", tmp_path)
            seen.append(refused)

    fetch(f"{host.url}/tetX.tar", tmp_path, on_begin=again)
    assert seen
    assert [path.name for path in tmp_path.iterdir()] == ["tetX"]


def test_what_is_put_there_meanwhile_stays(packed_set, host, tmp_path):
    def put(*_):
        (tmp_path / "tetX").mkdir(exist_ok=True)
        (tmp_path / "tetX" / "mine").write_text("mine")

    with pytest.raises(OutputError, match="tetX"):
        fetch(f"{host.url}/tetX.tar", tmp_path, on_begin=put)
    assert (tmp_path / "tetX" / "mine").read_text() == "mine"
    assert [path.name for path in (tmp_path / "tetX").iterdir()] == ["mine"]


def test_a_set_appears_whole_or_not_at_all(archive, tmp_path):
    """Seen by whoever looks while it is unpacked."""
    seen = []
    fetch(str(archive), tmp_path, on_bytes=lambda _: seen.append((tmp_path / "tetX").exists()))
    assert len(seen) > 3
    assert not any(seen)
    assert Path(tmp_path / "tetX" / "manifest.json").exists()
