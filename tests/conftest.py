"""Which tests are slow; small sets, which are made once per session, a folder for every user, and the command here."""

import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest
from forked_readers import forked_children, started_children
from made_sets import make_set
from symsol_annot_cli.main import main

from symsol_annot.sets.shard import reader

TESTS = Path(__file__).parent
SLOW = {line for line in (TESTS / "slow.txt").read_text().splitlines() if line and not line.startswith("#")}


@pytest.hookimpl(tryfirst=True)  # before pytest leaves out what -m names
def pytest_collection_modifyitems(config, items):
    """Mark what slow.txt names: a file, a test, or a test with some parameters."""
    unknown = set(SLOW)
    for item in items:
        file, _, test = item.nodeid.removeprefix("tests/").partition("::")
        names = {file, f"{file}::{test.partition('[')[0]}", f"{file}::{test}"}
        if not SLOW.isdisjoint(names):
            item.add_marker(pytest.mark.slow)
        unknown -= names
    if unknown and not config.option.file_or_dir:  # all tests are here
        raise pytest.UsageError(f"tests/slow.txt names what is no test: {', '.join(sorted(unknown))}")


@pytest.fixture(scope="session", autouse=True)
def _forked():
    """Processes that read files of unknown origin are forked, which is faster than those that the product starts."""
    with forked_children():
        yield


@pytest.fixture
def started():
    """The same processes started as the product starts them: for tests that are about them."""
    reader._DESCRIBER.close()
    with started_children():
        yield


@pytest.fixture(scope="session")
def _pristine(tmp_path_factory):
    """A small tetX set of both splits, 3 shards of test and 1 of train; not to be written to."""
    return make_set(tmp_path_factory.mktemp("pristine"), train=5, test=40)


@pytest.fixture
def tetX_set(_pristine, tmp_path):
    """A copy of a small tetX set that a test may damage."""
    return Path(shutil.copytree(_pristine, tmp_path / "tetX"))


@pytest.fixture
def open_folder():
    """A folder that every user can reach, which pytest's own are not."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    for path in (folder, *folder.rglob("*")):
        path.chmod(0o755)
    shutil.rmtree(folder)


@pytest.fixture
def here(monkeypatch, capfd):
    """The command's entry point in this process, which is sooner: for the many things that are refused at once."""

    def call(*arguments):
        monkeypatch.setattr(sys, "argv", ["symsol-annot", *(str(word) for word in arguments)])
        handler = signal.getsignal(signal.SIGTERM)  # which processes forked later must not inherit
        try:
            with pytest.raises(SystemExit) as ended:
                main()
        finally:
            signal.signal(signal.SIGTERM, handler)
        done = subprocess.CompletedProcess(arguments, ended.value.code, *capfd.readouterr())
        assert "Traceback" not in done.stdout + done.stderr
        return done

    return call
