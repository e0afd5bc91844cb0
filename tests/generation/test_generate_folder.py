"""The folder that a set is made in: another set's, damaged, locked, not to be written to, or on a full disk."""

import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from bench_sets import SmallDisk
from four_shards import IMAGES, SIZE, Opener, assert_only_whole_shards, contents, python, small_plan, state, unopened
from made_sets import make_set, threads

from symsol_annot.errors import DataError, DifferentSetError, OutputError
from symsol_annot.generation.generate import generate
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.sets.verify import verify
from symsol_annot.system.locks import locked

pytestmark = pytest.mark.usefixtures("_drawn_once")

# What is there already

OTHER_PLANS = {
    "seed": (small_plan(seed=1), ["seed: there 0, asked for 1"]),
    "size": (small_plan(size=32), ["camera", "'width': 16", "'width': 32"]),
    "test images": (small_plan(test=65), ["test images: there 64, asked for 65"]),
    "train images": (small_plan(train=1), ["train images: there 0, asked for 1"]),
    "annotate": (small_plan(annotate="all"), ["annotate: there 'test', asked for 'all'"]),
    "engine": (replace(small_plan(), settings=RenderSettings("cycles")), ["render", "opengl", "cycles"]),
    "object": (small_plan("tetX"), ["object: there 'tet', asked for 'tetX'"]),
    "object's files": (
        replace(small_plan(), spec=replace(small_plan().spec, digest="0" * 64)),
        ["object_sha256", "0" * 64],
    ),
    "all": (small_plan("tetX", seed=1, test=3, annotate="none"), ["object:", "seed:", "annotate:", "test images:"]),
}


@pytest.mark.parametrize("finished", [True, False])
@pytest.mark.parametrize("case", OTHER_PLANS)
def test_folder_that_holds_another_set_is_refused_and_not_touched(undisturbed, half, case, finished):
    plan, words = OTHER_PLANS[case]
    folder = undisturbed if finished else half
    (half / ".test-00003-of-00004.h5.partial").write_bytes(b"half of it")
    before = state(folder)
    with pytest.raises(DifferentSetError) as refusal:
        generate(plan, folder, threads(unopened))
    message = str(refusal.value)
    assert [word for word in [str(folder), "nothing was touched", "--out", *words] if word not in message] == []
    assert all(line in message for line in refusal.value.differences)
    assert state(folder) == before


def test_shards_without_a_manifest_are_refused_and_not_touched(half):
    (half / "manifest.json").unlink()
    before = state(half)
    with pytest.raises(DifferentSetError, match=r"it holds test-00000-of-00004\.h5 without a manifest\.json"):
        generate(small_plan(), half, threads(unopened))
    assert state(half) == before


def test_damaged_manifest_is_refused_and_not_touched(half):
    path = half / "manifest.json"
    path.write_bytes(path.read_bytes()[:-2])
    before = state(half)
    with pytest.raises(DataError, match="manifest"):
        generate(small_plan(), half, threads(unopened))
    assert state(half) == before


def flip_a_bit(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 8
    path.write_bytes(data)


@pytest.mark.parametrize("damage", [flip_a_bit, Path.unlink, lambda path: os.truncate(path, 100)])
def test_damaged_finished_shards_are_refused_by_name_and_not_touched(half, damage):
    for name in ("test-00000-of-00004.h5", "test-00001-of-00004.h5"):
        damage(half / name)
    before = state(half)
    with pytest.raises(DataError, match=r"damaged: test-00000-of-00004\.h5, test-00001-of-00004\.h5\..*--repair"):
        generate(small_plan(), half, threads(unopened))
    assert state(half) == before


def test_folder_that_another_process_works_in_is_left_alone(tmp_path):
    folder = tmp_path / "tetX"
    folder.mkdir()
    who = rf" \({os.getpid()}: .*python.*\)" if sys.platform == "linux" else ""
    with locked(folder), pytest.raises(OutputError, match=f"another process{who} is writing there right now"):
        make_set(tmp_path, test=4)
    assert not list(folder.iterdir())
    assert verify(make_set(tmp_path, test=4)) == []


# Permission

NOBODY = 65534
UNPRIVILEGED_RUN = f"""
import os, sys
from functools import partial
from pathlib import Path
from made_sets import make_plan, threads
from numpy_renderer import NumpyRenderer
from symsol_annot.generation.generate import generate
plan = make_plan("tet", test={IMAGES}, size={SIZE})
if os.geteuid() == 0:  # root may write anywhere; everything is imported by now
    os.setgroups([]), os.setresgid(*[{NOBODY}] * 3), os.setresuid(*[{NOBODY}] * 3)
for folder in sys.argv[1:]:
    try:
        generate(plan, Path(folder), threads(partial(NumpyRenderer, "tet", {SIZE})))
        print("finished")
    except Exception as error:
        print(type(error).__name__, error)
"""


def run_unprivileged(*folders):
    """Make the small plan's set in each folder, without root's rights; a line each says how it went."""
    command, env = python(UNPRIVILEGED_RUN, *folders)
    return subprocess.run(command, env=env, capture_output=True, text=True, check=True, timeout=60).stdout.splitlines()


@pytest.mark.parametrize("mode", [0o555, 0o000])
def test_folder_without_permission_is_an_error_that_says_so(open_folder, mode):
    locked = open_folder / "locked"
    locked.mkdir()
    locked.chmod(mode)
    said = run_unprivileged(locked, locked / "data" / "tet")
    locked.chmod(0o755)
    assert len(said) == 2
    for line in said:
        assert line.startswith("OutputError "), line
        assert str(locked) in line
        assert "permission: choose another folder with --out" in line
    assert list(locked.iterdir()) == []


def test_without_permission_an_unfinished_set_stays_as_it_is_and_a_finished_one_is_no_error(
    open_folder, half, undisturbed
):
    folders = [Path(shutil.copytree(folder, open_folder / folder.parent.name)) for folder in (half, undisturbed)]
    for folder in folders:
        folder.chmod(0o555)
    before = [state(folder) for folder in folders]
    unfinished, finished = run_unprivileged(*folders)
    assert "no write permission" in unfinished
    assert finished == "finished"
    assert [state(folder) for folder in folders] == before


@pytest.mark.parametrize(
    ("there", "folder", "words"), [("tet", "tet", "is a file"), ("data", "data/tet", "path is a file")]
)
def test_file_in_place_of_a_folder_is_an_error_that_says_so(tmp_path, there, folder, words):
    (tmp_path / there).write_text("mine")
    with pytest.raises(OutputError, match=words):
        generate(small_plan(), tmp_path / folder, threads(Opener()))
    assert (tmp_path / there).read_text() == "mine"


# A full disk


@pytest.fixture
def small_disk(tmp_path):
    disk = SmallDisk(tmp_path / "disk")
    disk.folder.mkdir()
    yield disk
    disk.unmount()


# A shard takes 32 KiB, a manifest 4, and the mark of what is not in its place 4; the first manifest is written before
# the shard is in its place. So the disk fills up in the middle of a shard, or just before its manifest.
@pytest.mark.parametrize(
    ("kibibytes", "kept", "workers"),
    [(4, 0, 1), (20, 0, 1), (40, 0, 1), (44, 1, 1), (68, 1, 1), (108, 3, 1), (90, 0, 2)],
)
def test_full_disk_keeps_whole_shards_and_the_same_call_finishes_after_making_room(
    small_disk, undisturbed, kibibytes, kept, workers
):
    small_disk.resize(kibibytes)
    folder = small_disk.folder / "tet"
    with pytest.raises(OutputError, match=r"tet/.*the disk is full: make room, then run the same command again"):
        generate(small_plan(), folder, threads(Opener(), workers=workers))
    assert len(list(folder.glob("*.h5"))) >= kept
    assert_only_whole_shards(folder, undisturbed)
    small_disk.resize(1000)
    generate(small_plan(), folder, threads(Opener(), workers=workers))
    assert contents(folder) == contents(undisturbed)


def test_disk_that_is_full_from_the_start_gets_no_manifest(small_disk):
    small_disk.resize(4)
    (small_disk.folder / "ballast").write_bytes(bytes(4096))
    folder = small_disk.folder / "tet"
    with pytest.raises(OutputError, match="the disk is full"):
        generate(small_plan(), folder, threads(Opener()))
    assert not folder.exists()
