"""The process that opens a file of unknown origin: what it may not do, and what its end looks like from outside."""

import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
import zlib
from pathlib import Path

import h5py
import numpy as np
import pytest
from forked_readers import Opened, forked_children
from made_sets import make_set
from valid_predictions import IMAGES, valid_attributes, valid_columns, write_file

from symsol_annot import load
from symsol_annot.bench.predictions.sandboxed_file import SandboxedFile
from symsol_annot.errors import PredictionsError
from symsol_annot.system.sandbox import hdf5_child

COMMAND = (sys.executable, "-c", "from symsol_annot_cli.main import main; main()")
ROWS = np.arange(12.0).reshape(4, 3)
pytestmark = pytest.mark.usefixtures("started")
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="limits and what tells of opened files are Linux's")


@pytest.fixture
def path(tmp_path):
    """A file with a data set."""
    with h5py.File(tmp_path / "case.h5", "w") as file:
        file["rows"] = ROWS
        file.attrs["method"] = "mine"
    return tmp_path / "case.h5"


def is_running(pid):
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, 0)
        return True
    return False


def resident_bytes():
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def read_all(path, **limits):
    with SandboxedFile(path, **limits) as file:
        for name, facts in file.datasets.items():
            file.read(name, 0, facts.shape[0])


def refusal(path, **limits):
    """Describe a file that must be refused, and read what is there; return the one message and the seconds taken."""
    start = time.monotonic()
    with pytest.raises(PredictionsError) as caught:
        read_all(path, **limits)
    (message,) = caught.value.faults
    return message, time.monotonic() - start


# What comes back


def test_what_comes_back_is_what_h5py_reads(path):
    with h5py.File(path, "r+") as file:
        file["big"] = ROWS.astype(">f4")
        file.create_dataset("packed", data=ROWS, chunks=(2, 2), compression="gzip", shuffle=True, fletcher32=True)
        file.attrs["bytes"], file.attrs["number"], file.attrs["list"] = np.bytes_(b"ab"), np.float32(0.5), [1, 2]
    with SandboxedFile(path) as file:
        assert file.attributes == {"method": "mine", "bytes": "ab", "number": 0.5}
        assert file.odd_attributes == {"list": "an array of shape (2,)"}
        facts = file.datasets
        assert (facts["rows"].shape, facts["rows"].dtype, facts["rows"].chunk_bytes) == ((4, 3), "<f8", 0)
        assert (facts["packed"].filters, facts["packed"].chunk_bytes) == ((2, 1, 3), 32)
        for name in ("rows", "big", "packed"):
            assert np.array_equal(file.read(name, 1, 3), ROWS[1:3])
            assert file.read(name, 2, 2).shape == (0, 3)
        assert file.read("big", 0, 4).dtype == np.dtype("<f4")


def test_many_bytes_come_through_whole(tmp_path):
    rows = np.random.default_rng(0).random((2**17, 9))
    with h5py.File(tmp_path / "case.h5", "w") as file:
        file["rows"] = rows
    with SandboxedFile(tmp_path / "case.h5") as file:
        assert np.array_equal(file.read("rows", 0, len(rows)), rows)


@pytest.mark.parametrize("name", ["-P.h5", "with space.h5", "with\nline.h5", "hypothèses.h5", b"\xff.h5"])
def test_a_file_may_have_any_name(path, name):
    with SandboxedFile(path.rename(path.with_name(os.fsdecode(name)))) as file:
        assert list(file.datasets) == ["rows"]


def test_the_process_ends_with_the_file(path):
    with SandboxedFile(path) as file:
        pid = file._process.pid
        assert is_running(pid)
    assert not is_running(pid)
    assert file._process.has_ended


# What is no file


def test_what_is_no_regular_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    expected = {
        tmp_path: "is no regular file",
        tmp_path / "fifo": "is no regular file",
        tmp_path / "missing": "there is no such file",
        tmp_path / "loop": "there is no such file",
        tmp_path / ("x" * 300): "cannot be opened: File name too long",
    }
    assert {path: refusal(path)[0] for path in expected} == expected


# Limits


def test_a_file_that_takes_too_long_ends_in_a_message(path):
    message, seconds = refusal(path, seconds=1e-6)
    assert message == (
        "the file's structure: reading it took more than 1e-06 s, which only a damaged or hostile file does"
    )
    assert seconds < 10


@LINUX
def test_a_few_megabytes_that_inflate_to_gigabytes_end_in_a_message_without_filling_memory(tmp_path):
    compressor = zlib.compressobj(9)
    begin = compressor.compress(bytes(2**20)) + compressor.flush(zlib.Z_FULL_FLUSH)
    again = compressor.compress(bytes(2**20)) + compressor.flush(zlib.Z_FULL_FLUSH)
    with h5py.File(tmp_path / "case.h5", "w") as file:
        rows = file.create_dataset("rows", (1000,), "f8", chunks=(1000,), compression="gzip")
        rows.id.write_direct_chunk((0,), begin + 4096 * again)
    assert (tmp_path / "case.h5").stat().st_size < 2**23
    before = resident_bytes()
    message, seconds = refusal(tmp_path / "case.h5", memory_bytes=3 * 2**28)
    assert message.startswith(("'rows': is damaged: ", "'rows': needs more memory"))
    assert seconds < 30
    assert resident_bytes() < before + 2**26


@LINUX
def test_more_memory_than_allowed_ends_in_a_message(tmp_path):
    with h5py.File(tmp_path / "case.h5", "w") as file:
        file.create_dataset("rows", (2**40,), "f8", chunks=(2**10,))
    message, seconds = refusal(tmp_path / "case.h5")
    assert message == "'rows': needs more memory than a row of such a file should"
    assert seconds < 10


@LINUX
def test_a_process_without_memory_to_start_ends_in_a_message(path):
    assert "the HDF5 library" in refusal(path, memory_bytes=2**20)[0] or "cannot be" in refusal(path)[0]


@pytest.mark.parametrize("number", [signal.SIGSEGV, signal.SIGABRT, signal.SIGBUS, signal.SIGKILL])
def test_a_crash_ends_in_a_message_which_stays(path, number):
    with SandboxedFile(path) as file:
        assert file.datasets
        os.kill(file._process.pid, number)
        for _ in range(2):
            with pytest.raises(PredictionsError) as caught:
                file.read("rows", 0, 4)
            message = f"'rows': the HDF5 library crashed on it ({number.name}); the file is damaged"
            assert caught.value.faults == (message,)


def test_an_early_end_ends_in_a_message(path, monkeypatch):
    monkeypatch.setattr("symsol_annot.system.sandbox.hdf5_process._CHILD", path.with_name("nothing.py"))
    assert "the HDF5 library gave up on it (exit code 2)" in refusal(path)[0]


@LINUX
def test_a_process_outlives_no_parent(path):
    program = (
        "import sys, time; from pathlib import Path\n"
        "from symsol_annot.bench.predictions.sandboxed_file import SandboxedFile\n"
        "file = SandboxedFile(Path(sys.argv[1])); file.datasets; print(file._process.pid, flush=True); time.sleep(600)"
    )
    with subprocess.Popen([sys.executable, "-c", program, str(path)], stdout=subprocess.PIPE, text=True) as parent:
        child = int(parent.stdout.readline())
        assert is_running(child)
        parent.kill()
    deadline = time.monotonic() + 10
    while is_running(child) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not is_running(child)


def test_a_hundred_thousand_groups_are_counted_and_left_alone(tmp_path):
    with h5py.File(tmp_path / "case.h5", "w") as file:
        file.create_group("0")
        for i in range(1, 100_000):  # as many names of one group cost the reader the same
            file.id.links.create_hard(b"%d" % i, file.id, b"0")
    message, seconds = refusal(tmp_path / "case.h5")
    assert message == "holds 100000 names at its root and 0 attributes, more than its format has"
    assert seconds < 10


def test_a_hundred_thousand_attributes_are_counted_and_left_alone(tmp_path):
    with h5py.File(tmp_path / "case.h5", "w", libver="latest") as file:
        space, kind = h5py.h5s.create(h5py.h5s.SCALAR), h5py.h5t.NATIVE_INT8
        for i in range(100_000):
            h5py.h5a.create(file.id, b"%d" % i, kind, space)
    message, seconds = refusal(tmp_path / "case.h5")
    assert message == "holds 0 names at its root and 100000 attributes, more than its format has"
    assert seconds < 10


def test_hdf5s_words_are_short_and_without_what_a_terminal_would_obey():
    text = hdf5_child._text(OSError("no object '\x1b[2J\n\u202e\udcff' " + "x" * 1000))
    assert text.startswith(r"no object '\x1b[2J\n\u202e\udcff' x")
    assert text.endswith("x...")
    assert len(text) < 250


def test_a_huge_string_on_the_heap_is_not_passed_on(path):
    with h5py.File(path, "r+") as file:
        file.attrs["method"] = "x" * 2**24
    with SandboxedFile(path) as file:
        assert (file.attributes, file.odd_attributes) == ({}, {"method": "16777216 characters"})


# Other files


def external_link(file):
    file["link"] = h5py.ExternalLink("canary.h5", "rows")


def link_through_an_external_group(file):
    file["other"] = h5py.ExternalLink("canary.h5", "/")
    file["link"] = h5py.SoftLink("/other/rows")


def external_storage(file):
    file.create_dataset("link", (4, 3), "f8", external=[("canary.h5", 0, h5py.h5f.UNLIMITED)])


def virtual(file):
    layout = h5py.VirtualLayout((4, 3), "f8")
    layout[:] = h5py.VirtualSource("canary.h5", "rows", (4, 3))
    file.create_virtual_dataset("link", layout)


def virtual_without_end(file):
    """HDF5 asks the other file for the shape of such a data set."""
    layout = h5py.VirtualLayout((4, 3), "f8", maxshape=(None, 3))
    source = h5py.VirtualSource("canary.h5", "rows", (4, 3), maxshape=(None, 3))
    layout[0 : h5py.h5s.UNLIMITED] = source[0 : h5py.h5s.UNLIMITED]
    file.create_virtual_dataset("link", layout)


def virtual_by_pattern(file):
    """HDF5 looks for as many sources as there are."""
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_layout(h5py.h5d.VIRTUAL)
    space = h5py.h5s.create_simple((4, 3), (h5py.h5s.UNLIMITED, 3))
    space.select_hyperslab((0, 0), (h5py.h5s.UNLIMITED, 1), stride=(4, 1), block=(4, 3))
    source = h5py.h5s.create_simple((4, 3))
    plist.set_virtual(space, b"canary.h5", b"rows_%b", source)
    whole = h5py.h5s.create_simple((4, 3), (h5py.h5s.UNLIMITED, 3))
    h5py.h5d.create(file.id, b"link", h5py.h5t.IEEE_F64LE, whole, plist)


def name_with_a_slash(file):
    """Such a name is forged: HDF5 takes it for a path, here through a link to another file."""
    external_link(file)
    file["link_rows"] = ROWS


ELSEWHERE = {
    external_link: "a link into another file, 'canary.h5'",
    link_through_an_external_group: "a soft link to '/other/rows'",
    external_storage: "a data set in external storage",
    virtual: "a virtual data set",
    virtual_without_end: "a virtual data set",
    virtual_by_pattern: "a virtual data set",
    name_with_a_slash: "a link into another file, 'canary.h5'",
}


@pytest.fixture
def unlimited(monkeypatch):
    """A process that may open other files, and so must not want to."""
    limit, setrlimit = hdf5_child._limit, resource.setrlimit

    def limit_the_rest(memory_bytes):
        resource.setrlimit = lambda which, to: which == resource.RLIMIT_NOFILE or setrlimit(which, to)
        limit(memory_bytes)

    monkeypatch.setattr(hdf5_child, "_limit", limit_the_rest)
    with forked_children():
        yield


@LINUX
@pytest.mark.parametrize("put", ELSEWHERE, ids=lambda put: put.__name__)
def test_no_other_file_is_opened(tmp_path, path, put, unlimited):
    path.rename(tmp_path / "canary.h5")
    with h5py.File(path, "w", libver=("earliest", "v110")) as file:
        put(file)
    if put is name_with_a_slash:
        path.write_bytes(path.read_bytes().replace(b"link_rows", b"link/rows"))
    opened = Opened(tmp_path)
    with SandboxedFile(path) as file:
        facts = file.datasets
        assert facts["link"].found == ELSEWHERE[put]
        assert "link/rows" not in facts or facts["link/rows"].found == "a name with a slash"
    assert opened.names() == {"case.h5"}
    opened.close()


@LINUX
@pytest.mark.parametrize("put", [external_link, external_storage, virtual_without_end], ids=lambda put: put.__name__)
def test_no_other_file_could_be_opened(tmp_path, path, put):
    """A process that did want to is refused by the kernel."""
    path.rename(tmp_path / "canary.h5")
    with h5py.File(path, "w", libver="latest") as file:
        put(file)
    program = (
        "import sys; from symsol_annot.system.sandbox import hdf5_child; import h5py; hdf5_child._limit(2**32)\n"
        "file = h5py.File(sys.argv[1], 'r'); print(repr(file['link'][...].sum()))"
    )
    opened = Opened(tmp_path)
    done = subprocess.run([sys.executable, "-c", program, path], capture_output=True, text=True, check=False)
    assert opened.names() == {"case.h5"}
    assert done.stdout.strip() in {"", "0.0"}  # HDF5 takes what it cannot find of a virtual data set for 0
    opened.close()


# The commands


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = tmp_path_factory.mktemp("data")
    make_set(folder, "tetX", test=IMAGES)
    return folder


def run(*arguments):
    done = subprocess.run(
        [*COMMAND, *map(str, arguments)], capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False
    )
    assert "Traceback" not in done.stdout + done.stderr
    return done


def test_validate_goes_through_all_files_and_score_refuses_a_faulty_one(data, tmp_path):
    dataset = load(data / "tetX")
    columns, attributes = valid_columns(dataset, np.random.default_rng(0)), valid_attributes(dataset)
    write_file(tmp_path / "good.h5", columns, attributes)
    write_file(tmp_path / "bad.h5", {**columns, "image_index": np.arange(IMAGES) + 1}, {**attributes, "floor": 2.0})
    (tmp_path / "none.h5").write_bytes(b"none")
    done = run("validate", tmp_path / "bad.h5", tmp_path / "good.h5", tmp_path / "none.h5", "--data", data)
    assert done.returncode == 1
    assert done.stdout == f"{tmp_path / 'good.h5'}: valid; tetX, 6 images: hypotheses, classifier, density\n"
    assert f"{tmp_path / 'bad.h5'}: 3 faults" in done.stderr
    assert "cannot be read as HDF5" in done.stderr
    assert run("validate", tmp_path / "good.h5", "--data", data).returncode == 0
    assert run("score", tmp_path / "good.h5", "--data", data).returncode == 0
    done = run("score", tmp_path / "bad.h5", "--data", data, "--json", tmp_path / "scores.json")
    assert (done.returncode, done.stdout) == (1, "")
    assert done.stderr.startswith(f"Error: {tmp_path / 'bad.h5'}: 3 faults")
    assert not (tmp_path / "scores.json").exists()
