"""Where a Dask scheduler is: addresses, the files that hold them, and which lead to other machines unprotected."""

import errno
import json
import os
import socket
import subprocess
import sys
import time

import pytest
from click.testing import CliRunner
from symsol_annot_cli.main import app

from symsol_annot.errors import ClusterError
from symsol_annot.generation.dask.address import address_in, is_unprotected, read_address

FOREIGN = "198.51.100.1"  # of TEST-NET-2, where nobody is


@pytest.mark.parametrize("text", ["tcp://127.0.0.1:8786", "tls://[::1]:8786", "tls://node-1.example.org:1"])
def test_an_address_is_read_and_written_alike(text):
    assert str(read_address(text)) == text


def test_an_address_without_a_protocol_has_that_of_dask_s_configuration():
    assert str(read_address("10.0.0.1:8786")) == "tcp://10.0.0.1:8786"


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "names no host and port"),
        ("tcp://", "names no host and port"),
        ("tcp://host", "names no host and port"),
        ("tcp://:8786", "names no host and port"),
        ("tcp://::1:8786", "names no host and port"),
        ("tcp://host:87 86", "names no host and port"),
        ("tcp://host:8786/", "names no host and port"),
        ("tcp://host:٨", "names no host and port"),
        ("tcp://host:0", "no port 0"),
        ("tcp://host:65536", "no port 65536"),
        ("tcp://host\x1b]0;x\x07:8786", "characters that no address has"),
        ("tcp://host\n:8786", "characters that no address has"),
        ("tcp://\ud800:8786", "characters that no address has"),
        ("inproc://10.0.0.1/8/1", "inproc:// is not spoken here; start the scheduler with `--protocol tcp`"),
        ("ucx://10.0.0.1:8786", "ucx:// is not spoken here"),
        ("carrier-pigeon://host:1", "carrier-pigeon:// is not spoken here"),
    ],
)
def test_what_is_no_address_is_refused_with_the_reason_and_an_example(text, words):
    with pytest.raises(ValueError, match=rf"{words}.*expected one like tcp://10\.0\.0\.1:8786"):
        read_address(text)


def made_fifo(path):
    os.mkfifo(path)


CONTENTS = {
    "nothing": b"",
    "no JSON": b"tcp://127.0.0.1:8786",
    "no UTF-8": b'{"address": "tcp://h\xff:1"}',
    "no address": b"{}",
    "a list": b"[]",
    "a text": b'"tcp://127.0.0.1:8786"',
    "a number": b'{"address": 8786}',
    "null": b'{"address": null}',
    "control characters": b'{"address": "tcp://\\u001b[31mh:1"}',
    "a surrogate": b'{"address": "tcp://\\ud800:1"}',
    "an unknown protocol": b'{"address": "inproc://10.0.0.1/1/1"}',
    "a web page": b'{"address": "https://example.org/"}',
    "deep": b"[" * 60_000,
    "a long number": b'{"address": ' + b"1" * 60_000 + b"}",
    "huge": b'{"address": "tcp://127.0.0.1:8786", "more": "' + b"x" * 2**17 + b'"}',
}
MAKE = {
    "a FIFO": made_fifo,
    "an endless device": lambda path: path.symlink_to("/dev/zero"),
    "a folder": lambda path: path.mkdir(),
    "a link to nothing": lambda path: path.symlink_to("nowhere"),
    "a file with a hole": lambda path: (path.touch(), os.truncate(path, 2**40)),
    **{name: lambda path, data=data: path.write_bytes(data) for name, data in CONTENTS.items()},
}


@pytest.mark.parametrize("kind", MAKE)
def test_a_scheduler_file_without_an_address_is_one_error_at_once_whatever_it_is(tmp_path, kind):
    file = tmp_path / "scheduler.json"
    MAKE[kind](file)
    start = time.monotonic()
    with pytest.raises(ClusterError) as refused:
        address_in(file)
    assert time.monotonic() - start < 5
    said = str(refused.value)
    assert "scheduler.json: holds no address of a scheduler (" in said
    assert f"`dask scheduler --scheduler-file {file}` writes one" in said
    assert said.isprintable()
    assert len(said) < 1000


def test_a_missing_scheduler_file_is_an_error(tmp_path):
    with pytest.raises(ClusterError, match=r"holds no address of a scheduler \(No such file"):
        address_in(tmp_path / "scheduler.json")


def test_a_scheduler_file_gives_its_address(tmp_path):
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"type": "Scheduler", "address": "tls://[::1]:8786"}))
    assert address_in(file) == "tls://[::1]:8786"


def own_address():
    """This machine's address beyond loopback; loopback where it has none."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        try:
            sender.connect((FOREIGN, 1))
        except OSError:
            return "127.0.0.1"
        return sender.getsockname()[0]


@pytest.mark.parametrize(
    "host", ["127.0.0.1", "127.8.9.10", "[::1]", "[::ffff:127.0.0.1]", "localhost", "0.0.0.0", own_address()]
)
def test_an_address_of_this_machine_needs_no_warning(host):
    assert not is_unprotected(f"tcp://{host}:8786")


@pytest.mark.parametrize("host", [FOREIGN, "[2001:db8::1]", "[::ffff:198.51.100.1]", "3325256705"])
def test_a_foreign_address_by_plain_tcp_does_and_by_tls_does_not(host):
    assert is_unprotected(f"tcp://{host}:8786")
    assert is_unprotected(f"{host}:8786")
    assert not is_unprotected(f"tls://{host}:8786")


def test_a_name_is_as_foreign_as_any_address_that_it_stands_for(monkeypatch):
    real = socket.getaddrinfo

    def resolve(host, port, *args, **kwargs):
        hosts = ["127.0.0.1", FOREIGN] if host == "cluster.example" else [host]
        return [found for name in hosts for found in real(name, port, *args, **kwargs)]

    monkeypatch.setattr(socket, "getaddrinfo", resolve)
    assert is_unprotected("tcp://cluster.example:8786")
    assert not is_unprotected("tls://cluster.example:8786")


@pytest.mark.parametrize(
    "text", ["", "tcp://host\n:1", "inproc://1/2", "tcp://nowhere.invalid:1", f"tcp://{'a' * 300}:1"]
)
def test_what_cannot_be_reached_at_all_is_not_warned_of(text):
    assert not is_unprotected(text)


@pytest.fixture
def unreachable(monkeypatch):
    """No address can be reached, so that no test sends anything to another machine."""

    def connect(*_, **__):
        raise OSError(errno.ENETUNREACH, "Network is unreachable")

    monkeypatch.setattr(socket, "create_connection", connect)


def render(tmp_path, *where):
    return CliRunner().invoke(
        app, ["render", "--object", "tetX", "--test", "1", "--out", str(tmp_path / "out"), *where]
    )


@pytest.mark.parametrize("way", ["--cluster", "--scheduler-file"])
def test_render_warns_of_plain_tcp_to_another_machine_in_one_line_before_it_connects(tmp_path, unreachable, way):
    address = f"tcp://{FOREIGN}:8786"
    file = tmp_path / "scheduler.json"
    file.write_text(json.dumps({"address": address}))
    done = render(tmp_path, way, address if way == "--cluster" else str(file))
    (warning,) = done.stderr.splitlines()
    assert warning.startswith(f"Warning: the connection to {address} is neither encrypted nor authenticated")
    assert "docs/scale.md#tls" in warning
    assert isinstance(done.exception, ClusterError)
    assert "nobody answers there (Network is unreachable)" in str(done.exception)
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:1", f"tls://{FOREIGN}:8786", "inproc://1/2", ""])
def test_render_does_not_warn_of_another_address(tmp_path, unreachable, address):
    done = render(tmp_path, "--cluster", address)
    assert done.stderr == ""
    assert isinstance(done.exception, ClusterError)


def test_a_configuration_that_dask_cannot_read_is_an_error_without_a_traceback(tmp_path):
    (tmp_path / "dask.yaml").write_text(": : {")
    environment = {**os.environ, "DASK_CONFIG": str(tmp_path), "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    call = [sys.executable, "-c", "from symsol_annot_cli.main import main; main()", "render", "--object", "tetX"]
    where = ["--out", str(tmp_path / "out"), "--cluster", "tcp://127.0.0.1:1"]
    done = subprocess.run([*call, *where], capture_output=True, text=True, env=environment, timeout=120, check=False)
    assert done.returncode == 1
    assert done.stderr.startswith("Error: Dask cannot be imported before its configuration is corrected: ")
    assert "dask.yaml" in done.stderr
    assert "Traceback" not in done.stderr
