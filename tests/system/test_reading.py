"""Files of unknown origin: regular ones are read up to a limit, anything else is refused and not waited for."""

import hashlib
import os
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest
from tampering import descriptors

from symsol_annot.system import reading
from symsol_annot.system.reading import file_sha256, open_regular, read_bytes, read_text

READERS = [lambda path: read_bytes(path, 100), lambda path: read_text(path, 100), file_sha256, open_regular]


def make_socket(path):
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(os.path.relpath(path))  # whose length is limited


IRREGULAR = {
    "folder": (Path.mkdir, "is a folder, where a file belongs"),
    "fifo": (os.mkfifo, "is no regular file"),
    "socket": (make_socket, "is no regular file"),
    "device": (lambda path: path.symlink_to("/dev/null"), "is no regular file"),
    "endless device": (lambda path: path.symlink_to("/dev/zero"), "is no regular file"),
    "terminal": (lambda path: path.symlink_to("/dev/tty"), "is no regular file"),
    "link to a folder": (lambda path: path.symlink_to(path.parent), "is a folder, where a file belongs"),
    "link to itself": (lambda path: path.symlink_to(path), "Too many levels of symbolic links"),
    "link to nowhere": (lambda path: path.symlink_to("nowhere"), "No such file or directory"),
    "nothing": (lambda path: None, "No such file or directory"),
}


@pytest.mark.parametrize("reader", READERS, ids=["bytes", "text", "sha256", "descriptor"])
@pytest.mark.parametrize("kind", IRREGULAR)
def test_what_is_no_regular_file_is_an_error_that_says_what_it_is(tmp_path, kind, reader, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make, words = IRREGULAR[kind]
    make(tmp_path / "file")
    before = descriptors()
    with pytest.raises(OSError, match=words) as refused:
        reader(tmp_path / "file")
    assert refused.value.strerror == words
    assert descriptors() == before


@pytest.mark.parametrize("reader", READERS[:3], ids=["bytes", "text", "sha256"])
def test_pipe_that_takes_a_files_place_between_look_and_opening_is_refused_and_not_waited_for(
    tmp_path, monkeypatch, reader
):
    path, really_stat = tmp_path / "file", os.stat
    path.write_text("mine")

    def stat_and_replace(*arguments, **options):
        status = really_stat(*arguments, **options)
        path.unlink()
        os.mkfifo(path)
        return status

    before = descriptors()
    with monkeypatch.context() as patch:
        patch.setattr(reading.os, "stat", stat_and_replace)
        with pytest.raises(OSError, match="is no regular file"):
            reader(path)
    assert descriptors() == before


def test_file_is_read_up_to_its_limit_and_not_beyond(tmp_path):
    path = tmp_path / "file"
    for size in (0, 1, 99, 100):
        path.write_bytes(bytes(size))
        assert read_bytes(path, 100) == bytes(size)
    for size in (101, 5000):
        path.write_bytes(bytes(size))
        with pytest.raises(OSError, match="is larger than the 100 bytes that such a file may have") as refused:
            read_bytes(path, 100)
        assert refused.value.filename == str(path)


def test_file_of_terabytes_costs_no_time_and_no_memory(tmp_path):
    path = tmp_path / "file"
    path.touch()
    os.truncate(path, 2**40)
    before = time.process_time()
    with pytest.raises(OSError, match="is larger than the 1,048,576 bytes"):
        read_bytes(path, 2**20)
    assert time.process_time() - before < 1


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="only Linux has files that grow while they are read")
def test_file_that_says_it_has_no_bytes_is_read_up_to_its_limit():
    status = Path("/proc/self/status")
    assert status.stat().st_size == 0
    assert read_bytes(status, 2**20).startswith(b"Name:")
    with pytest.raises(OSError, match="is larger than the 10 bytes"):
        read_bytes(status, 10)


def test_links_are_followed(tmp_path):
    (tmp_path / "file").write_text("mine")
    (tmp_path / "link").symlink_to("file")
    (tmp_path / "link to the link").symlink_to("link")
    for name in ("link", "link to the link"):
        assert read_text(tmp_path / name, 100) == "mine"


@pytest.mark.parametrize(
    ("data", "text"),
    [(b"", ""), (b"a\nb", "a\nb"), (b"\xef\xbb\xbfa", "a"), ("ö\u2028".encode(), "ö\u2028"), (b"a\r\n\0", "a\r\n\0")],
)
def test_text_is_utf8_with_or_without_a_mark_and_its_line_ends_stay(tmp_path, data, text):
    (tmp_path / "file").write_bytes(data)
    assert read_text(tmp_path / "file", 100) == text


@pytest.mark.parametrize("data", [b"\xff\xfea\0", b"\x80", "ö".encode("latin-1"), b"a\xed\xa0\x80"])
def test_text_of_another_encoding_is_an_error(tmp_path, data):
    (tmp_path / "file").write_bytes(data)
    with pytest.raises(UnicodeDecodeError):
        read_text(tmp_path / "file", 100)


def test_digest_is_the_sha256(tmp_path):
    data = os.urandom(3 * 2**20 + 1)
    (tmp_path / "file").write_bytes(data)
    assert file_sha256(tmp_path / "file") == hashlib.sha256(data).hexdigest()


@pytest.mark.parametrize("name", ["name\nwith a line end", "ö", "-rf", "a" * 255, b"\xff"])
def test_file_may_have_any_name(tmp_path, name):
    path = tmp_path / os.fsdecode(name)
    path.write_text("mine")
    assert read_text(path, 100) == "mine"


def test_nothing_that_is_read_stays_open(tmp_path):
    (tmp_path / "file").write_text("mine")
    before = descriptors()
    for reader in READERS[:3]:
        reader(tmp_path / "file")
    assert descriptors() == before


def test_reading_imports_nothing_beyond_the_standard_library():
    code = "import sys; import symsol_annot.system.reading; print('numpy' in sys.modules, 'h5py' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split()[1] == "False"
