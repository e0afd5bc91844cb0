"""Where a predictions file cannot be written: no permission, a file in the way, a full disk."""

import shutil
import tempfile
from pathlib import Path

import numpy as np
import pytest
from bench_sets import SmallDisk, python
from methods import random_rotations
from written_predictions import IMAGES, METHOD, contents, hypothesise, left_beside

from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.errors import OutputError

NOBODY = 65534


@pytest.mark.parametrize("given_as", ["array", "callable"])
def test_folders_on_the_way_are_made_and_a_file_in_the_way_is_named(tetX, tmp_path, given_as):
    hypotheses = random_rotations() if given_as == "array" else hypothesise
    write_hypotheses(tmp_path / "a" / "b" / "preds.h5", tetX, hypotheses, method=METHOD)
    assert (tmp_path / "a" / "b" / "preds.h5").exists()
    (tmp_path / "file").write_text("mine")
    with pytest.raises(OutputError, match=r"file.*cannot be written: .*is a file, not a folder"):
        write_hypotheses(tmp_path / "file" / "preds.h5", tetX, hypotheses, method=METHOD)
    with pytest.raises(OutputError, match="cannot be written: File name too long"):
        write_hypotheses(tmp_path / ("x" * 300), tetX, hypotheses, method=METHOD)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a", "file"]


UNPRIVILEGED = f"""
import os, sys
from pathlib import Path
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.sets.dataset import load
dataset = load(sys.argv[1])
rotation = dataset.labels().rotation[:, None]
if os.geteuid() == 0:  # root may write anywhere; everything is imported and open by now
    os.setgroups([]), os.setresgid(*[{NOBODY}] * 3), os.setresuid(*[{NOBODY}] * 3)
for hypotheses in (rotation, lambda i: rotation[i]):
    try:
        write_hypotheses(Path(sys.argv[2]) / "preds.h5", dataset, hypotheses, method="mine")
        print("finished")
    except Exception as error:
        print(type(error).__name__, error)
"""


@pytest.fixture
def locked_folder():
    """A folder that every user can reach, as pytest's own are not, and none but root write to."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o555)
    yield folder
    folder.chmod(0o755)
    shutil.rmtree(folder)


def test_a_folder_without_permission_is_an_error_that_says_so(tetX, locked_folder):
    done = python(UNPRIVILEGED, tetX.folder, locked_folder)
    assert (done.returncode, done.stderr) == (0, "")
    assert len(done.stdout.splitlines()) == 2
    for line in done.stdout.splitlines():
        assert line.startswith(f"OutputError {locked_folder}")
        assert "no write permission" in line
    assert list(locked_folder.iterdir()) == []


ON_A_FULL_DISK = """
import sys
from methods import random_rotations
from symsol_annot.bench.predictions.writing.submission import write_hypotheses
from symsol_annot.sets.dataset import load
from symsol_annot.errors import OutputError
hypotheses = random_rotations(30)
try:
    write_hypotheses(sys.argv[1], load(sys.argv[2]), lambda i: hypotheses[i], method="mine")
except OutputError as error:
    print(error)
"""


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    disk = SmallDisk(folder)
    yield disk
    disk.unmount()


# The answers about an image take 4 KiB, as the note of the settings and the folder's mark do; the file takes 60. So the
# disk fills up before the first answer, among the answers, or in the middle of the file.
@pytest.mark.parametrize(("kibibytes", "kept"), [(4, 0), (40, 8), (144, IMAGES)])
def test_a_full_disk_keeps_the_answers_and_the_process_and_the_same_call_goes_on(tetX, small_disk, kibibytes, kept):
    small_disk.resize(kibibytes)
    path = small_disk.folder / "preds.h5"
    done = python(ON_A_FULL_DISK, path, tetX.folder)
    assert (done.returncode, done.stderr) == (0, "")  # a file that HDF5 cannot finish would crash it at its end
    assert str(path) in done.stdout
    assert "the disk is full: make room, then run the same command again" in done.stdout
    assert not path.exists()
    assert not list(small_disk.folder.glob(".*"))
    asked = []
    hypotheses = random_rotations(30)
    small_disk.resize(1000)
    write_hypotheses(path, tetX, lambda i: asked.append(i) or hypotheses[i], method="mine", resume=kept > 0)
    assert asked == list(range(kept, IMAGES))
    assert np.array_equal(contents(path)[0]["hypotheses"], hypotheses)


def test_a_full_disk_leaves_the_old_file(tetX, small_disk):
    small_disk.resize(100)
    path = small_disk.folder / "preds.h5"
    write_hypotheses(path, tetX, random_rotations(1), method=METHOD)
    before = path.read_bytes()
    with pytest.raises(OutputError, match="the disk is full"):
        write_hypotheses(path, tetX, random_rotations(60), method=METHOD)
    assert path.read_bytes() == before
    assert left_beside(path) == []
