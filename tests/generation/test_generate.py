"""Making a set: which bytes it has, what a failure leaves behind, and what the next call makes of that."""

import itertools
import multiprocessing
import os
import shutil
import signal
import stat
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import h5py
import numpy as np
import numpy_renderer
import oracle
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_sets import make_plan, make_set, on_images, threads
from numpy_renderer import NumpyRenderer
from scipy.stats import kstest

from symsol_annot.errors import DataError, DifferentSetError, ObjectError, OutputError, RenderError, SettingsError
from symsol_annot.generation.generate import generate
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.groups import octahedral_group
from symsol_annot.sets.dataset import load
from symsol_annot.sets.manifest import read_manifest, write_manifest
from symsol_annot.sets.plan import label_rotation
from symsol_annot.sets.verify import verify
from symsol_annot.system import files
from symsol_annot.system.locks import locked
from symsol_annot.system.scratch import Scratch

SIZE, IMAGES, PER_SHARD = 16, 64, 16
NOBODY = 65534


def small_plan(name="tet", test=IMAGES, **changes):
    """4 shards of 16 images that cost next to nothing, unless told otherwise."""
    return make_plan(name, **{"test": test, "size": SIZE, **changes})


class Opener:
    """Opens numpy renderers and keeps them; `on_frame` gets the renderer's number and the number of its frame."""

    def __init__(self, name="tet", on_frame=lambda number, frame: None):
        self.name, self.on_frame, self.renderers = name, on_frame, []

    def __call__(self):
        number, frames = len(self.renderers), itertools.count(1)
        self.renderers.append(NumpyRenderer(self.name, SIZE, lambda: self.on_frame(number, next(frames))))
        return self.renderers[-1]


def unopened():
    pytest.fail("a renderer was started")


def failing_at(frame, error):
    def on_frame(_, found):
        if found == frame:
            raise error

    return on_frame


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir()}


def state(folder):
    """All that a touch would change: names, contents, identities and times; reading changes none of it."""

    def of(path):
        status = path.stat()
        return path.name, status.st_ino, status.st_mode, status.st_mtime_ns, status.st_ctime_ns

    return of(folder), [(of(path), path.read_bytes()) for path in sorted(folder.iterdir())]


def assert_only_whole_shards(folder, undisturbed):
    """Every shard is the one that an undisturbed run makes, and no half of anything lies beside them."""
    there = contents(folder) if folder.exists() else {}
    manifest = there.pop("manifest.json", None)
    expected = contents(undisturbed)
    assert set(there) <= set(expected)
    assert [name for name, data in there.items() if data != expected[name]] == []
    if manifest:
        assert {entry.file for entry in read_manifest(folder).shards if entry.is_finished} <= set(there)


@pytest.fixture(scope="module", autouse=True)
def _drawn_once():
    """The tests draw the same few labels again and again; here each is drawn once."""
    drawn = {}

    def cast(name, R_m2c, *lattice):
        key = (name, R_m2c.tobytes(), *lattice)
        if key not in drawn:
            drawn[key] = oracle.cast(name, R_m2c, *lattice)
        return drawn[key].copy()

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(numpy_renderer, "cast", cast)
        yield


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory):
    """The small plan's set, made in one go; not to be written to."""
    folder = tmp_path_factory.mktemp("undisturbed") / "tet"
    generate(small_plan(), folder, threads(Opener()))
    return folder


@pytest.fixture(scope="module")
def _half(tmp_path_factory):
    folder = tmp_path_factory.mktemp("half") / "tet"
    with pytest.raises(RenderError):
        generate(
            small_plan(), folder, threads(Opener(on_frame=failing_at(2 * PER_SHARD + 1, RenderError("the lamp broke"))))
        )
    return folder


@pytest.fixture
def half(_half, tmp_path):
    """A folder that holds the first 2 of the small plan's 4 shards; a test may damage it."""
    return Path(shutil.copytree(_half, tmp_path / "half"))


@pytest.mark.parametrize("workers", [2, 3])
def test_bytes_do_not_depend_on_the_number_of_workers(tmp_path, workers):
    plan = small_plan("tetX", train=20, test=20)
    generate(plan, tmp_path / "one", threads(Opener("tetX")))
    generate(plan, tmp_path / "more", threads(Opener("tetX"), workers=workers))
    assert contents(tmp_path / "more") == contents(tmp_path / "one")


def test_bytes_do_not_depend_on_the_order_of_work(tmp_path, undisturbed):
    others_are_made = threading.Event()

    def on_frame(number, frame):
        if number == 0:
            assert others_are_made.wait(timeout=60)
        elif frame == IMAGES - PER_SHARD:
            others_are_made.set()

    generate(small_plan(), tmp_path / "tet", threads(Opener(on_frame=on_frame), workers=2))
    assert contents(tmp_path / "tet") == contents(undisturbed)


def test_a_prefix_does_not_depend_on_how_many_images_follow(tmp_path):
    few, many = 20, 150  # also divided into shards in another way
    for count in (few, many):
        generate(small_plan(test=count), tmp_path / str(count), threads(Opener()))
    for small, large in zip(load(tmp_path / str(few)), load(tmp_path / str(many)), strict=False):
        np.testing.assert_array_equal(small.image, large.image)
        np.testing.assert_array_equal(small.segmentation, large.segmentation)
        np.testing.assert_array_equal(small.rotation, large.rotation)


def test_image_is_drawn_at_its_own_label(undisturbed):
    renderer = NumpyRenderer("tet", SIZE)
    for sample in load(undisturbed)[::7]:
        np.testing.assert_array_equal(sample.rotation, label_rotation(0, "tet", "test", sample.index))
        view = renderer.render(sample.rotation)
        np.testing.assert_array_equal(sample.image, view.rgb)
        np.testing.assert_array_equal(sample.segmentation, view.segmentation)


@pytest.mark.parametrize(
    "other", [(1, "tetX", "test", 3), (0, "tet", "test", 3), (0, "tetX", "train", 3), (0, "tetX", "test", 4)]
)
def test_label_differs_with_seed_object_split_and_index(other):
    assert np.abs(label_rotation(*other) - label_rotation(0, "tetX", "test", 3)).max() > 1e-3


def test_label_is_a_rotation_that_does_not_depend_on_earlier_calls():
    first = label_rotation(5, "cylO", "train", 9)
    np.random.seed(1)  # noqa: NPY002 - nobody's global state may matter
    label_rotation(5, "cylO", "train", 10)
    np.testing.assert_array_equal(label_rotation(5, "cylO", "train", 9), first)
    np.testing.assert_allclose(first.T @ first, np.eye(3), atol=1e-14)
    assert np.linalg.det(first) == pytest.approx(1)


def test_known_labels():
    # A change here changes every published set.
    expected = {
        (0, "tetX", "test", 0): [
            [0.32257350215929326, 0.22963652487035432, -0.9182665202163017],
            [0.5593581042826, -0.8288559838162017, -0.01078282270336658],
            [-0.7635868299532572, -0.5101615670917826, -0.3958160287108041],
        ],
        (2026, "cylO", "train", 44999): [
            [0.9305706711336112, -0.3598864368077822, -0.0672307863090898],
            [0.1356611344383547, 0.5095168772166087, -0.8496991281826376],
            [0.3400504118933529, 0.7815844832346877, 0.5229640646716822],
        ],
    }
    for arguments, R in expected.items():
        np.testing.assert_allclose(label_rotation(*arguments), R, rtol=0, atol=1e-14)


def test_labels_are_uniform_on_so3():
    labels = np.stack([label_rotation(0, "tetX", "test", index) for index in range(4000)])
    from_one_to_the_next = np.swapaxes(labels[:-1], 1, 2) @ labels[1:]
    for R in (labels, from_one_to_the_next):
        angle = np.arccos(np.clip((np.trace(R, axis1=1, axis2=2) - 1) / 2, -1, 1))
        assert kstest(angle, lambda t: (t - np.sin(t)) / np.pi).pvalue > 0.01  # the Haar measure's law of the angle
        for image in (R[:, :, 0], R[:, :, 2], R @ np.array([0.6, 0.0, 0.8])):  # a point's images: uniform on the sphere
            for coordinate in image.T:
                assert kstest(coordinate, lambda x: (x + 1) / 2).pvalue > 0.001  # Archimedes
            longitude = np.arctan2(image[:, 1], image[:, 0])
            assert kstest(longitude, lambda t: (t + np.pi) / (2 * np.pi)).pvalue > 0.001


def test_same_command_again_makes_nothing_new(tmp_path, undisturbed):
    folder = Path(shutil.copytree(undisturbed, tmp_path / "tet"))
    before = state(folder)
    manifest = generate(small_plan(), folder, threads(unopened, workers=3))
    assert manifest == read_manifest(undisturbed)
    assert state(folder) == before


@pytest.mark.parametrize("frame", [1, PER_SHARD, PER_SHARD + 1, 40, IMAGES])
def test_run_that_failed_is_continued_to_the_bytes_of_an_undisturbed_one(tmp_path, undisturbed, frame):
    folder = tmp_path / "tet"
    with pytest.raises(RenderError, match="the lamp broke"):
        generate(small_plan(), folder, threads(Opener(on_frame=failing_at(frame, RenderError("the lamp broke")))))
    assert_only_whole_shards(folder, undisturbed)
    kept = {path: path.stat().st_mtime_ns for path in folder.glob("*.h5")}
    assert len(kept) == (frame - 1) // PER_SHARD
    drawn = []
    generate(small_plan(), folder, threads(Opener(on_frame=lambda number, frame: drawn.append(frame)), workers=2))
    assert len(drawn) == IMAGES - len(kept) * PER_SHARD
    assert {path: path.stat().st_mtime_ns for path in kept} == kept
    assert contents(folder) == contents(undisturbed)


def test_progress_counts_every_image_once_also_those_that_are_there_already(half):
    counted = []
    generate(small_plan(), half, threads(Opener(), workers=2), on_images(lambda: counted.append(1)))
    assert len(counted) == IMAGES
    generate(small_plan(), half, threads(unopened), on_images(lambda: counted.append(1)))
    assert len(counted) == 2 * IMAGES


def test_returned_manifest_is_the_one_on_disk_and_finished(half):
    manifest = generate(small_plan(), half, threads(Opener()))
    assert manifest == read_manifest(half)
    assert manifest.is_finished


def test_keyboard_interrupt_in_a_worker_leaves_whole_shards_and_stops_the_others(tmp_path, undisturbed):
    opener = Opener(on_frame=failing_at(PER_SHARD + 3, KeyboardInterrupt()))
    with pytest.raises(KeyboardInterrupt):
        generate(small_plan(), tmp_path / "tet", threads(opener, workers=2))
    assert all(renderer.is_closed for renderer in opener.renderers)
    assert list((tmp_path / "tet").glob("*.h5"))
    assert_only_whole_shards(tmp_path / "tet", undisturbed)


ENDLESS_RUN = f"""
import signal, sys, time
from functools import partial
from pathlib import Path
from made_sets import make_plan, threads
from numpy_renderer import NumpyRenderer
from symsol_annot.generation.generate import generate

class Stalling(NumpyRenderer):
    frames = 0

    def render(self, R_m2c):
        self.frames += 1
        while self.frames > {PER_SHARD + 4} and not self.is_closed:  # in the middle of the second shard
            time.sleep(0.01)
        return super().render(R_m2c)

signal.signal(signal.SIGINT, signal.default_int_handler)  # a background job is born without
plan = make_plan("tet", test={IMAGES}, size={SIZE})
generate(plan, Path(sys.argv[1]), threads(partial(Stalling, "tet", {SIZE}), workers=2))
"""


def python(script, *arguments):
    path = os.pathsep.join([str(Path(__file__).parents[1] / "support"), *(p for p in sys.path if p)])
    return [sys.executable, "-c", script, *map(str, arguments)], {**os.environ, "PYTHONPATH": path}


def test_ctrl_c_leaves_whole_shards_from_which_the_same_call_goes_on(tmp_path, undisturbed):
    folder = tmp_path / "tet"
    command, env = python(ENDLESS_RUN, folder)
    with subprocess.Popen(command, env=env, stderr=subprocess.PIPE, text=True) as process:
        try:
            deadline = time.monotonic() + 60
            while not list(folder.glob("*.h5")) and process.poll() is None and time.monotonic() < deadline:
                time.sleep(0.01)
            process.send_signal(signal.SIGINT)
            _, said = process.communicate(timeout=30)
        finally:
            process.kill()  # does nothing to one that has ended
    assert process.returncode == -signal.SIGINT
    assert said.rstrip().endswith("KeyboardInterrupt")
    assert 0 < len(list(folder.glob("*.h5"))) < IMAGES / PER_SHARD
    assert_only_whole_shards(folder, undisturbed)
    generate(small_plan(), folder, threads(Opener()))
    assert contents(folder) == contents(undisturbed)


def killed_at_write(plan, folder, moment):
    """Make a set in a process that loses half of what it just wrote, and its life, at one of its fsyncs."""
    fsync, left = os.fsync, itertools.count(moment, -1)

    def lose(descriptor):
        if next(left) == 0:
            status = os.fstat(descriptor)
            if stat.S_ISREG(status.st_mode):
                os.ftruncate(descriptor, status.st_size // 2)
            os.kill(os.getpid(), signal.SIGKILL)
        fsync(descriptor)

    files.os.fsync = lose
    generate(plan, folder, threads(Opener()))


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize(("moment", "left"), [*enumerate([1, 2, 1, 0, 1, 0, 1, 0, 1, 0])])
def test_set_whose_run_was_killed_at_any_write_is_continued_to_the_same_bytes(tmp_path, moment, left):
    """A shard, the first manifest, and both folders; a manifest and its folder; a shard and its; a manifest and its."""
    plan, killed, whole = small_plan(test=20), tmp_path / "killed", tmp_path / "whole"
    process = multiprocessing.get_context("fork").Process(target=killed_at_write, args=(plan, killed, moment))
    process.start()
    process.join(timeout=60)
    assert process.exitcode == -signal.SIGKILL
    assert len([path for path in killed.iterdir() if path.name.startswith(".symsol-annot-")]) == left
    generate(plan, killed, threads(Opener()))
    generate(plan, whole, threads(Opener()))
    assert contents(killed) == contents(whole)


def leave_scratch(folder):
    """Leave a scratch folder with half a shard, as a process does that is killed."""
    left = Scratch(beside=Path(folder))
    (left.path / "new").write_bytes(b"half of it")
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
def test_what_a_killed_run_left_is_swept_and_nothing_else(tmp_path, half):
    strangers = (".manifest.json.partial", ".test-00000-of-00004.h5.partial", "notes", ".hidden", ".symsol-annot-notes")
    for folder in (half, tmp_path / "new"):
        folder.mkdir(exist_ok=True)
        for name in strangers:
            (folder / name).write_bytes(b"mine")
        process = multiprocessing.get_context("fork").Process(target=leave_scratch, args=(folder,))
        process.start()
        process.join(timeout=60)
        assert len(list(folder.glob(".symsol-annot-*/new"))) == 1
        generate(small_plan(), folder, threads(Opener()))
        shards = {entry.file for entry in read_manifest(folder).shards}
        assert set(contents(folder)) == {"manifest.json", *shards, *strangers}
        assert {(folder / name).read_bytes() for name in strangers} == {b"mine"}


def test_error_in_one_worker_stops_the_others_and_closes_all_renderers(tmp_path):
    failed, late, left_running = threading.Event(), [], []

    def on_frame(number, frame):
        if number == 0 and frame == 3:
            failed.set()
            raise RenderError("the lamp broke")
        if failed.is_set():
            late.append(number)
            deadline = time.monotonic() + 10
            while not opener.renderers[number].is_closed and time.monotonic() < deadline:
                time.sleep(0.005)
            if not opener.renderers[number].is_closed:
                left_running.append(number)
        time.sleep(0.005)

    opener = Opener(on_frame=on_frame)
    with pytest.raises(RenderError, match="the lamp broke"):
        generate(small_plan(), tmp_path / "tet", threads(opener, workers=3))
    assert all(renderer.is_closed for renderer in opener.renderers)
    assert left_running == []
    assert len(late) == len(set(late)), "a worker drew on after the stop"


def test_renderers_are_closed_after_a_good_run_and_there_are_no_more_than_shards(tmp_path):
    opener = Opener()
    generate(small_plan(), tmp_path / "tet", threads(opener, workers=50))
    assert 1 <= len(opener.renderers) <= IMAGES / PER_SHARD
    assert all(renderer.is_closed for renderer in opener.renderers)


def test_nothing_is_created_when_the_renderer_cannot_start(tmp_path):
    def broken():
        raise RenderError("no Blender here")

    with pytest.raises(RenderError, match="no Blender here"):
        generate(small_plan(), tmp_path / "data" / "tet", threads(broken, workers=2))
    assert list(tmp_path.iterdir()) == []


OTHER_PLANS = {
    "seed": (small_plan(seed=1), ["seed: there 0, asked for 1"]),
    "size": (small_plan(size=32), ["camera", "'width': 16", "'width': 32"]),
    "test images": (small_plan(test=65), ["test images: there 64, asked for 65"]),
    "train images": (small_plan(train=1), ["train images: there 0, asked for 1"]),
    "annotate": (small_plan(annotate="all"), ["annotate: there 'test', asked for 'all'"]),
    "engine": (replace(small_plan(), settings=RenderSettings("cycles")), ["render", "workbench", "cycles"]),
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


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"images": {"test": -1}}, "images: .*-1"),
        ({"images": {"train": 10, "test": -1}}, "images: .*-1"),
        ({"images": {"train": 0, "test": 0}}, "not all 0"),
        ({"images": {}}, "not all 0"),
        ({"images": {"test": 1, "validation": 1}}, "splits: expected train, test, found .*validation"),
        ({"annotate": "train"}, "annotate: expected one of all, test, none, found 'train'"),
        ({"annotate": ""}, "annotate: .*''"),
        ({"seed": -1}, "seed: expected 0 to 9223372036854775807, found -1"),
        ({"seed": 2**63}, "found 9223372036854775808"),
    ],
)
def test_settings_that_make_no_set_are_refused(change, words):
    with pytest.raises(SettingsError, match=words):
        replace(small_plan(), **change)


def test_an_object_without_the_symmetries_that_it_declares_is_refused_before_anything_is_touched(tmp_path):
    plan, opened = small_plan(), Opener()
    wrong = replace(plan, spec=replace(plan.spec, symmetry_group=octahedral_group()))
    with pytest.raises(ObjectError, match=r"the surface of 'tet' is not invariant under body\.group"):
        generate(wrong, tmp_path / "tet", threads(opened))
    assert not (tmp_path / "tet").exists()
    generate(plan, tmp_path / "tet", threads(opened))
    with pytest.raises(ObjectError, match="is not invariant"):
        generate(wrong, tmp_path / "tet", threads(opened))


@pytest.mark.parametrize(("annotate", "annotated"), [("test", {"test"}), ("all", {"train", "test"}), ("none", set())])
def test_annotate_decides_which_splits_have_masks(tmp_path, annotate, annotated):
    generate(small_plan(train=2, test=2, annotate=annotate), tmp_path / "tet", threads(Opener()))
    found = set()
    for path in (tmp_path / "tet").glob("*.h5"):
        with h5py.File(path) as file:
            found |= {file.attrs["split"]} if "symmetry_mask" in file else set()
    assert found == annotated


@pytest.fixture
def open_folder():
    """A folder that every user can reach, which pytest's own are not."""
    folder = Path(tempfile.mkdtemp())
    folder.chmod(0o755)
    yield folder
    for path in (folder, *folder.iterdir()):
        path.chmod(0o755)
    shutil.rmtree(folder)


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


class SmallDisk:
    """A disk in memory, of a size that can be changed."""

    def __init__(self, folder):
        self.folder = folder

    def resize(self, kibibytes):
        options = f"size={kibibytes}k" + (",remount" if self.folder.is_mount() else "")
        command = ["mount", "-t", "tmpfs", "-o", options, "tmpfs", str(self.folder)]
        if shutil.which("mount") is None:
            pytest.skip("there is no mount, so no disk that fills up")
        mounted = subprocess.run(command, capture_output=True, text=True, check=False)
        if mounted.returncode != 0:
            pytest.skip(f"no tmpfs can be mounted, so there is no disk that fills up: {mounted.stderr.strip()}")


@pytest.fixture
def small_disk(tmp_path):
    folder = tmp_path / "disk"
    folder.mkdir()
    yield SmallDisk(folder)
    if folder.is_mount():
        subprocess.run(["umount", str(folder)], check=True)


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


def shard_names(split, count):
    return [f"{split}-{number:05d}-of-{count:05d}.h5" for number in range(count)]


def division(**counts):
    return [(entry.file, entry.images) for entry in make_plan("tet", **counts).manifest().shards]


def test_published_test_split_is_ten_shards_of_500():
    assert division(test=5000, size=224) == [(name, 500) for name in shard_names("test", 10)]


def test_small_split_is_still_divided_among_workers():
    assert division(test=64, size=224) == [(name, 16) for name in shard_names("test", 4)]


def test_train_comes_before_test():
    assert [name for name, _ in division(train=20, test=1)] == [*shard_names("train", 2), *shard_names("test", 1)]


def test_large_images_make_smaller_shards():
    bytes_each = 2048 * 2048 * 4  # RGB and segmentation; a shard is built in memory
    sizes = [images for _, images in division(test=5000, size=2048)]
    assert max(sizes) < 500
    assert max(sizes) * bytes_each <= 2**27
    assert sum(sizes) == 5000


@settings(deadline=None)
@given(st.integers(0, 60_000), st.integers(1, 60_000), st.integers(16, 2048))
def test_shards_cover_every_image_of_a_split_once(train, test, size):
    plan = replace(small_plan(), images={"train": train, "test": test}, camera=Camera.filling(size))
    manifest = plan.manifest()
    for split, images in plan.images.items():
        entries = manifest.of_split(split)
        assert [entry.file for entry in entries] == shard_names(split, len(entries))
        ends = [entry.first_index + entry.images for entry in entries]
        assert [entry.first_index for entry in entries] == [0, *ends][:-1]
        assert ends[-1:] == ([images] if images else [])
        assert all(0 < entry.images <= 500 for entry in entries)


def test_folder_that_another_process_works_in_is_left_alone(tmp_path):
    folder = tmp_path / "tetX"
    folder.mkdir()
    who = rf" \({os.getpid()}: .*python.*\)" if sys.platform == "linux" else ""
    with locked(folder), pytest.raises(OutputError, match=f"another process{who} is writing there right now"):
        make_set(tmp_path, test=4)
    assert not list(folder.iterdir())
    assert verify(make_set(tmp_path, test=4)) == []


def test_set_begun_with_other_software_is_not_finished_with_this(tmp_path):
    folder = make_set(tmp_path, test=40)
    manifest = read_manifest(folder)
    last = manifest.shards[-1]
    (folder / last.file).unlink()
    write_manifest(folder, manifest.with_finished(replace(last, bytes=None, sha256=None, content_sha256=None)))
    before = {path.name: path.read_bytes() for path in folder.iterdir()}

    class OtherRenderer(NumpyRenderer):
        versions = MappingProxyType({"renderer": "another"})

    with pytest.raises(DifferentSetError, match="renderer: there numpy, here another"):
        generate(make_plan(test=40), folder, threads(lambda: OtherRenderer("tetX")))
    assert {path.name: path.read_bytes() for path in folder.iterdir()} == before
