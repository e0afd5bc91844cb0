"""`view` serves a gallery to this machine's browser, and ends well at Ctrl-C."""

import re
import signal
import subprocess
import urllib.error
import urllib.request

import pytest
from bench_sets import small_set
from command_line import INTERRUPTIBLE

from symsol_annot.errors import OutputError
from symsol_annot.gallery.serving import served


def got(address):
    with urllib.request.urlopen(address, timeout=60) as answer:
        return answer.status, answer.read()


def test_a_folder_is_served_to_this_machine_alone_and_without_lists(tmp_path):
    (tmp_path / "gallery" / "sets").mkdir(parents=True)
    (tmp_path / "gallery" / "index.html").write_text("the page")
    (tmp_path / "secret").write_text("beside it")
    with served(tmp_path / "gallery") as address:
        assert address.startswith("http://127.0.0.1:")
        assert got(address) == (200, b"the page")
        base = address.removesuffix("index.html")
        for path in ("../secret", "..%2fsecret", "sets/", "nothing"):
            with pytest.raises(urllib.error.HTTPError, match="404"):
                got(base + path)
        port = int(re.search(r":(\d+)/", address).group(1))
        with pytest.raises(OutputError, match=f"port {port}: cannot be listened on"), served(tmp_path, port):
            pass
    with pytest.raises(OSError):
        got(address)


def test_view_makes_a_gallery_serves_it_until_ctrl_c_and_leaves_nothing(tmp_path):
    small_set(tmp_path / "data", "tetX", 3)
    command = [*INTERRUPTIBLE, "view", "data/tetX", "--no-browser"]
    with subprocess.Popen(
        command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        address = process.stdout.readline().split()[0]
        assert b"<title>" in got(address)[1]
        process.send_signal(signal.SIGINT)
        _, errors = process.communicate(timeout=120)
    assert (process.returncode, errors) == (0, "")
    assert [path.name for path in tmp_path.iterdir()] == ["data"]
