"""The command `fetch`: what it says, and each thing that goes wrong in one message."""

import contextlib
import re
import socket
import subprocess
import sys
import threading

import pytest
from bench_sets import SmallDisk
from command_line import AS_WHO_OBEYS_MODES, COMMAND, obeying_modes, run


def test_the_command_says_what_is_there_now_and_what_to_do_next(here, archive, host, tmp_path):
    done = here("fetch", f"{host.url}/tetX.tar", "--out", tmp_path)
    assert done.returncode == 0, done.stderr
    first, *rest = done.stdout.splitlines()
    assert first == f"{tmp_path}/tetX: 5 train, 40 test images; every shard has its SHA-256"
    assert rest == ["Next:", f"  symsol-annot info {tmp_path}/tetX", f"  symsol-annot verify {tmp_path}/tetX"]
    again = here("fetch", archive, "--out", tmp_path)
    assert again.stdout.startswith(f"{tmp_path}/tetX: 5 train, 40 test images; was there already, whole\n")
    assert here("verify", tmp_path / "tetX").returncode == 0


def test_without_a_digest_the_command_says_so(here, host, tmp_path):
    del host.files["/tetX.tar.sha256"]
    done = here("fetch", f"{host.url}/tetX.tar", "--out", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert "No digest was given, and none lies beside the archive" in done.stdout


WRONG = {
    "ftp://example.org/tetX.tar": "ftp:// is not known: expected a path, file://, http:// or https://",
    "s3://bucket/tetX.tar": "s3:// is not known",
    "HTTPX://example.org/": "httpx:// is not known",
    "http://": "names no host",
    "https:///tetX.tar": "names no host",
    "http://[::1/tetX.tar": "is no address",
    "http://127.0.0.1:99999/tetX.tar": "cannot be reached",
    "http://127.0.0.1:1/te tX.tar": "ASCII without spaces",
    "http://127.0.0.1/t\u00e4tX.tar": "ASCII without spaces",
    "file://elsewhere/tetX.tar": "is on another machine",
    "file:///a%00b": "null byte",
    "nowhere/tetX.tar": "cannot be read: No such file or directory",
    "": "is a folder",
    ".": "is a folder",
    "/dev/null": "no regular file",
}


@pytest.mark.parametrize("source", WRONG)
def test_an_address_or_path_that_leads_to_no_archive_is_one_message(here, tmp_path, monkeypatch, source):
    monkeypatch.chdir(tmp_path)
    done = here("fetch", source)
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(rf"Error: .*{WRONG[source]}.*\n", done.stderr), done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("status", "said"),
    [
        (404, "has no such file"),
        (410, "any more"),
        (403, "permission"),
        (429, "too often"),
        (500, "again later"),
        (418, "whether the address is right"),
    ],
)
def test_what_a_host_refuses_is_said_with_its_number(here, host, tmp_path, status, said):
    host.statuses["/tetX.tar"] = status
    done = here("fetch", f"{host.url}/tetX.tar", "--out", tmp_path / "data")
    assert (done.returncode, done.stdout) == (1, "")
    assert re.fullmatch(rf"Error: {host.url}/tetX\.tar: HTTP {status} .*{said}.*\n", done.stderr)
    assert not (tmp_path / "data").exists()


def test_a_redirect_loop_and_a_redirect_to_a_file_are_refused(here, host, tmp_path):
    host.redirects = {"/a.tar": "/b.tar", "/b.tar": "/a.tar", "/c.tar": "file:///etc/passwd", "/d.tar": "ftp://x/y"}
    for name, said in {"a": "redirects in a loop", "c": "not allowed", "d": "ftp"}.items():
        done = here("fetch", f"{host.url}/{name}.tar", "--out", tmp_path / "data")
        assert (done.returncode, done.stdout) == (1, "")
        assert re.fullmatch(rf"Error: {host.url}/{name}\.tar: .*{said}.*\n", done.stderr), done.stderr
    assert not (tmp_path / "data").exists()


OK = b"HTTP/1.1 200 OK\r\n"


@pytest.mark.parametrize(
    "answer",
    [
        b"",
        b"hello\r\n\r\n",
        OK + b"Content-Length: x\r\n\r\nhello",
        OK + b"Content-Length: " + b"9" * 5000 + b"\r\n\r\nhello",
        OK + b"Transfer-Encoding: chunked\r\n\r\nzz\r\nhello",
        OK + b"Transfer-Encoding: chunked\r\n\r\n9\r\nhello",
        OK + b"Content-Range: bytes 0-" + b"9" * 5000 + b"/" + b"9" * 5000 + b"\r\n\r\nhello",
    ],
    ids=lambda answer: str(answer[:60]),
)
def test_a_host_that_speaks_no_http_is_one_message(here, tmp_path, monkeypatch, answer):
    monkeypatch.setenv("no_proxy", "*")
    with socket.create_server(("127.0.0.1", 0)) as server:

        def speak():
            with contextlib.suppress(
                OSError
            ):  # the server closes when the command is done, with or without a second call
                for _ in range(2):
                    connection, _ = server.accept()
                    with connection:
                        connection.recv(4096)
                        connection.sendall(answer)

        thread = threading.Thread(target=speak, daemon=True)
        thread.start()
        done = here(
            "fetch", f"http://127.0.0.1:{server.getsockname()[1]}/x.tar", "--sha256", "0" * 64, "--out", tmp_path / "d"
        )
    assert done.returncode == 1
    assert re.fullmatch(r"Error: http://.*\n", done.stderr)
    assert not (tmp_path / "d").exists()


def test_a_download_that_breaks_off_says_that_the_same_command_resumes_it_and_it_does(host, tmp_path):
    command = (*COMMAND, "fetch", f"{host.url}/tetX.tar", "--out", tmp_path)
    host.cut_after = len(host.files["/tetX.tar"]) // 2
    broken = run(*command)
    assert broken.returncode == 1
    assert re.fullmatch(r"Error: .*broke off after 0\.\d of 0\.\d MB: .*the same command resumes it\n", broken.stderr)
    resumed = run(*command)
    assert resumed.returncode == 0, resumed.stderr
    assert [status for _, status in host.of("/tetX.tar")] == [200, 206]


def test_a_full_disk_is_said_before_and_while_it_fills(host, archive, tmp_path):
    """A real one. From a host, the room is looked at first; from a path, the disk fills up while it is unpacked."""
    (tmp_path / "disk").mkdir()
    disk, size = SmallDisk(tmp_path / "disk"), archive.stat().st_size // 1024
    try:
        disk.resize(size + size // 2)
        done = run(*COMMAND, "fetch", f"{host.url}/tetX.tar", "--out", tmp_path / "disk" / "data")
        assert re.fullmatch(r"Error: .*has no room: .* MB are needed.*make room, then run .* again\n", done.stderr)
        disk.resize(size // 2)
        done = run(*COMMAND, "fetch", archive, "--out", tmp_path / "disk" / "data")
        assert re.fullmatch(r"Error: .*the disk is full: make room, then run the same command again\n", done.stderr)
        assert list((tmp_path / "disk").iterdir()) == []
        disk.resize(4 * size)
        assert run(*COMMAND, "fetch", archive, "--out", tmp_path / "disk" / "data").returncode == 0
    finally:
        disk.unmount()


@obeying_modes
def test_a_folder_without_permission_is_said(archive, open_folder):
    (open_folder / "data").mkdir(mode=0o555)
    copied = open_folder / "tetX.tar"
    copied.write_bytes(archive.read_bytes())
    done = run(*AS_WHO_OBEYS_MODES, *COMMAND, "fetch", copied, "--out", open_folder / "data")
    assert done.returncode == 1
    assert re.fullmatch(r"Error: .*no write permission: choose another folder with --out.*\n", done.stderr)
    copied.chmod(0)
    done = run(*AS_WHO_OBEYS_MODES, *COMMAND, "fetch", copied, "--out", open_folder / "data2")
    assert re.fullmatch(r"Error: .*tetX\.tar: cannot be read: Permission denied\n", done.stderr)


def test_the_base_installation_is_enough(archive, tmp_path):
    """No package of an extra, nor numpy's, is there to be imported beyond what `info` needs."""
    extras = ("bpy", "torch", "pyarrow", "matplotlib", "plotly", "distributed")
    code = f"import sys; sys.modules |= dict.fromkeys({extras!r}); from symsol_annot_cli.main import main; main()"
    words = [sys.executable, "-c", code, "fetch", archive, "--out", tmp_path]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
