"""The process that HDF5 lives in while shards are loaded: one per process, which nobody's end takes others with."""

import json
import multiprocessing
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import h5py
import numpy as np
import pytest
from bench_sets import python
from describer_workers import opens, pid_of, put_pid
from made_sets import make_set
from tampering import descriptors

from symsol_annot import load
from symsol_annot.bench.predictions.sandboxed_file import SandboxedFile
from symsol_annot.errors import DataError, PredictionsError
from symsol_annot.sets import plan
from symsol_annot.sets.shard import reader as shards
from symsol_annot.system.sandbox import hdf5_process as sandbox

CASES = Path(__file__).parents[2] / "tools" / "attack" / "cases"
HANGING, CRASHING = "hung 01398", "crashed 00651"
LINUX = pytest.mark.skipif(sys.platform != "linux", reason="what processes have open and begot is told by Linux")
FORKS = pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")


@pytest.fixture(autouse=True)
def describer(started, monkeypatch):
    """A describer of the test's own."""
    own = shards._Describer()
    os.register_at_fork(after_in_child=own.forget)
    monkeypatch.setattr(shards, "_DESCRIBER", own)
    yield own
    own.close()


@pytest.fixture
def many_shards(_pristine, tmp_path):
    """Copies of one shard under many names."""
    source = _pristine / "test-00000-of-00003.h5"
    return [Path(shutil.copy(source, tmp_path / f"{number}.h5")) for number in range(12)]


def damaged(path, case):
    """Write a shard that HDF5 hangs or crashes on."""
    data = bytearray((CASES / "shard.h5").read_bytes())
    for offset, text in json.loads((CASES / "shards.json").read_text())[case]:
        data[offset : offset + len(text) // 2] = bytes.fromhex(text)
    path.write_bytes(data)
    return path


def is_running(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except FileNotFoundError:
        return False


def has_ended(pid):
    """Whether a process is gone, which it is given a minute for."""
    deadline = time.monotonic() + 60
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.02)
    return not is_running(pid)


# It serves one shard after the other


def test_shards_are_described_by_one_process(many_shards, describer):
    assert opens(many_shards[0]) == (16, 3, 3)
    pid = pid_of(describer)
    for path in many_shards:
        assert opens(path) == (16, 3, 3)
    assert pid_of(describer) == pid


@LINUX
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM, signal.SIGSEGV])
def test_process_that_somebody_ended_between_two_shards_is_started_again(many_shards, describer, number):
    for path in many_shards[:3]:
        assert opens(path) == (16, 3, 3)
        pid = pid_of(describer)
        os.kill(pid, number)
        assert has_ended(pid)
    assert opens(many_shards[3]) == (16, 3, 3)


@LINUX
@pytest.mark.parametrize("case", [HANGING, CRASHING])
def test_shard_that_hdf5_hangs_or_crashes_on_is_an_error_and_the_next_is_opened(tmp_path, many_shards, case):
    path = damaged(tmp_path / "damaged.h5", case)
    for _ in range(2):
        with pytest.raises(DataError, match=r"damaged\.h5: "):
            opens(path)
        assert opens(many_shards[0]) == (16, 3, 3)


def test_process_that_cannot_be_started_is_an_error_of_ours(many_shards, monkeypatch):
    monkeypatch.setattr(sandbox.sys, "executable", "/nowhere/python")
    with pytest.raises(DataError, match=r"0\.h5: the process that opens it cannot be started: No such file"):
        opens(many_shards[0])
    with pytest.raises(PredictionsError, match="cannot be started: No such file"):
        SandboxedFile(many_shards[0])
    monkeypatch.undo()
    assert opens(many_shards[0]) == (16, 3, 3)


@LINUX
def test_nothing_is_left_open_by_two_hundred_shards(many_shards, tmp_path):
    broken = tmp_path / "broken.h5"
    broken.write_bytes(many_shards[0].read_bytes()[:-100])
    opens(many_shards[0])
    before, errors = open_by_kind(), []
    for number in range(200):
        opens(many_shards[number % 12])
        if number % 10 == 0:
            with pytest.raises(DataError) as refused:
                opens(broken)
            errors.append(refused)  # with its traceback
    assert open_by_kind() == before


def open_by_kind():
    """What this process has open; pipes have new numbers when the process was started again."""
    return sorted(name.split("[")[0] for name in descriptors())


def test_process_holds_no_shard_but_the_last(many_shards, describer):
    for path in many_shards:
        opens(path)
    held = {os.readlink(link) for link in Path(f"/proc/{pid_of(describer)}/fd").iterdir()}  # noqa: PTH115
    assert {name for name in held if name.endswith(".h5")} <= {str(many_shards[-1])}


# Threads and forks


def test_threads_open_shards_at_once(many_shards):
    with ThreadPoolExecutor(12) as pool:
        assert list(pool.map(opens, many_shards * 4)) == [(16, 3, 3)] * 48


@FORKS
def test_process_that_is_forked_while_a_thread_describes_has_a_describer_of_its_own(many_shards, describer):
    """A fork copies a lock as it is, and nobody in the child lets go of it."""
    opens(many_shards[0])
    begun, may_end = threading.Event(), threading.Event()

    def hold():
        with describer._lock:
            begun.set()
            may_end.wait(timeout=60)

    thread = threading.Thread(target=hold)
    thread.start()
    begun.wait(timeout=60)
    child = multiprocessing.get_context("fork").Process(target=opens, args=(many_shards[1],))
    child.start()
    child.join(timeout=60)
    may_end.set()
    thread.join()
    assert child.exitcode == 0
    assert opens(many_shards[2]) == (16, 3, 3)


@FORKS
def test_forked_and_spawned_workers_have_processes_of_their_own_which_end_with_them(many_shards, describer):
    opens(many_shards[0])
    pids = [pid_of(describer)]
    for method in ("fork", "fork", "spawn"):
        context = multiprocessing.get_context(method)
        receiving, sending = context.Pipe(duplex=False)
        worker = context.Process(target=put_pid, args=(many_shards[1], sending))
        worker.start()
        sending.close()  # so that a worker that dies first is an end of file, and is not waited for
        pids.append(receiving.recv())
        worker.join(timeout=60)
        assert worker.exitcode == 0
        assert has_ended(pids[-1])
    assert len(set(pids)) == 4
    assert opens(many_shards[2]) == (16, 3, 3)
    assert pid_of(describer) == pids[0]


@FORKS
def test_forks_while_threads_describe_all_read_the_same(many_shards):
    is_over = threading.Event()

    def keep_opening():
        while not is_over.is_set():
            opens(many_shards[0])

    threads = [threading.Thread(target=keep_opening) for _ in range(2)]
    for thread in threads:
        thread.start()
    try:
        context = multiprocessing.get_context("fork")
        children = [context.Process(target=opens, args=(path,)) for path in many_shards[:6]]
        for child in children:
            child.start()
        for child in children:
            child.join(timeout=120)
        assert [child.exitcode for child in children] == [0] * 6
    finally:
        is_over.set()
        for thread in threads:
            thread.join()


# Ends


INTERRUPTED = """
import signal, sys
from pathlib import Path
from symsol_annot.errors import DataError
from symsol_annot.sets.shard.reader import _DESCRIBER, open_shard
signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job is born without
hanging, good = map(Path, sys.argv[1:])
with open_shard(good) as shard:
    print(len(shard), _DESCRIBER._process.pid, flush=True)
try:
    with open_shard(hanging):
        print("opened", flush=True)
except KeyboardInterrupt:
    print("interrupted", flush=True)
with open_shard(good) as shard:
    print(len(shard), flush=True)
"""


@LINUX
def test_ctrl_c_is_obeyed_while_hdf5_hangs_and_the_next_shard_is_opened(tmp_path, many_shards):
    hanging = damaged(tmp_path / "hanging.h5", HANGING)
    command = [sys.executable, "-c", INTERRUPTED, str(hanging), str(many_shards[0])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        pid = int(process.stdout.readline().split()[1])
        while processor_seconds(pid) < 0.9:  # of which starting it takes half
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        said, error = process.communicate(timeout=60)
    assert (said.split(), error) == (["interrupted", "16"], "")
    assert not is_running(pid)


def processor_seconds(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


OUTLIVED = """
import os, sys, time
from pathlib import Path
from symsol_annot.sets.shard.reader import _DESCRIBER, open_shard
with open_shard(Path(sys.argv[1])):
    print(_DESCRIBER._process.pid, flush=True)
{end}
"""


@LINUX
@pytest.mark.parametrize("end", ["time.sleep(600)", "sys.exit(3)", "os._exit(3)", "os.abort()", "raise ValueError", ""])
def test_process_outlives_no_parent_however_that_ends(many_shards, end):
    command = [sys.executable, "-c", OUTLIVED.format(end=end), str(many_shards[0])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as process:
        pid = int(process.stdout.readline())
        if "sleep" in end:
            process.kill()
        process.wait(timeout=60)
    assert has_ended(pid)


# What this process takes no part in


def test_load_imports_no_hdf5_no_scipy_and_no_torch(tetX_set):
    code = """
import sys, symsol_annot
with symsol_annot.load(sys.argv[1]) as dataset:
    dataset[0].symmetry_set, dataset.labels()
print([name for name in ("h5py", "scipy", "torch", "matplotlib", "bpy") if name in sys.modules])
"""
    assert python(code, tetX_set).stdout == "[]\n"


@LINUX
def test_no_other_file_is_opened_on_behalf_of_a_shard(tmp_path, many_shards, describer):
    """The process may hold one file open, and no more."""
    opens(many_shards[0])
    limits = Path(f"/proc/{pid_of(describer)}/limits").read_text()
    soft, hard = next(line for line in limits.splitlines() if line.startswith("Max open files")).split()[3:5]
    assert int(soft) == int(hard) < 10


NO_LOCKS = """
#include <errno.h>
int flock(int fd, int operation) { errno = ENOLCK; return -1; }
"""


@pytest.fixture
def no_locks(tmp_path):
    """An environment in which the system has no locks, as on some network file systems."""
    compiler = shutil.which("cc")
    if compiler is None or sys.platform != "linux":
        pytest.skip("there is no C compiler to take the locks away with")
    source, library = tmp_path / "no_locks.c", tmp_path / "no_locks.so"
    source.write_text(NO_LOCKS)
    subprocess.run([compiler, "-shared", "-fPIC", "-o", library, source], check=True)
    return {"LD_PRELOAD": str(library)}


@pytest.mark.parametrize("setting", [None, "TRUE", "BEST_EFFORT", "FALSE"])
def test_set_on_a_file_system_without_locks_is_loaded_and_verified(tetX_set, no_locks, setting):
    code = """
import sys
from pathlib import Path
from symsol_annot import load
from symsol_annot.sets.verify import verify
print(len([sample.symmetry_set for sample in load(sys.argv[1])]), verify(Path(sys.argv[1])))
"""
    environment = {**no_locks, **({"HDF5_USE_FILE_LOCKING": setting} if setting else {})}
    assert python(code, tetX_set, env=environment).stdout == "40 []\n"


def test_hdf5_itself_opens_no_file_there(tetX_set, no_locks):
    """Else the test beside this one would pass for another reason."""
    code = "import h5py, sys; h5py.File(sys.argv[1])"
    path = next(tetX_set.glob("test-*.h5"))
    done = subprocess.run(
        [sys.executable, "-c", code, str(path)],
        env={**os.environ, **no_locks, "HDF5_USE_FILE_LOCKING": "TRUE"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert "unable to lock file" in done.stderr


# Loading again and again


def test_loading_many_shards_keeps_few_open_and_one_process(tmp_path, monkeypatch, describer):
    monkeypatch.setattr(plan, "MAX_IMAGES_PER_SHARD", 2)
    folder = make_set(tmp_path, "tet", test=60, size=16)
    before = len(descriptors())
    with load(folder) as dataset:
        assert [sample.index for sample in dataset] == list(range(60))
        assert len(descriptors()) <= before + 8 + 2  # and the pipes to the process
    assert len(descriptors()) <= before + 2


def test_what_another_program_holds_open_for_writing_is_loaded(tetX_set):
    before = load(tetX_set)[0]
    with h5py.File(tetX_set / "test-00000-of-00003.h5", "r+"):
        np.testing.assert_array_equal(load(tetX_set, check=False)[0].rotation, before.rotation)
