"""Blender in a process of its own: the same frames every time, an error for every way it can end, nothing left over."""

import os
import signal
import subprocess
import sys
import threading
import time
from importlib import util
from pathlib import Path

import numpy as np
import pytest
from oracle import boundary, cast
from processes import comes_true, is_running

from symsol_annot.errors import RendererCrashedError, RendererMissingError
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering import blender_process
from symsol_annot.rendering.blender_process import check_blender_installed
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import COUNTS_PER_REQUEST, RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import uniform_rotations

pytestmark = pytest.mark.blender

SIZE = 64
PROMPTLY_S = 10.0  # on a busy machine; what is checked would last minutes otherwise
MINUTES_OF_COUNTS = 50_000

PARENT = f"""
import numpy as np
from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings

renderer = RenderProcess(load_object("cylO"), Camera.filling({SIZE}), RenderSettings())
print(renderer.pid, flush=True)
renderer.marking_pixels(np.tile(np.eye(3), ({MINUTES_OF_COUNTS}, 1, 1)))
"""


def open_renderer(name="tetX", size=SIZE, engine="opengl"):
    return RenderProcess(load_object(name), Camera.filling(size), RenderSettings(engine))


def rotations(count, seed=3):
    return uniform_rotations(count, np.random.default_rng(seed))


def descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


def log_bytes(renderer):
    return os.fstat(renderer._process._log.fileno()).st_size


@pytest.fixture(scope="module")
def renderer():
    with open_renderer() as opened:
        yield opened


def test_a_view_has_the_shapes_and_types_that_it_documents(renderer):
    view = renderer.render(np.eye(3))
    assert (view.rgb.shape, view.rgb.dtype) == ((SIZE, SIZE, 3), np.uint8)
    assert (view.segmentation.shape, view.segmentation.dtype) == ((SIZE, SIZE), np.uint8)
    assert set(np.unique(view.segmentation)) <= {0, 1, 2}


def test_marking_pixels_are_one_area_a_rotation_in_quarters_of_a_pixel(renderer):
    pixels = renderer.marking_pixels(rotations(COUNTS_PER_REQUEST + 5))
    assert (pixels.shape, pixels.dtype) == ((COUNTS_PER_REQUEST + 5,), np.float64)
    assert np.array_equal(4 * pixels, np.round(4 * pixels))
    assert pixels.min() == 0 < pixels.max()


def test_marking_pixels_of_no_rotations_are_no_pixels(renderer):
    pixels = renderer.marking_pixels(np.zeros((0, 3, 3)))
    assert (pixels.shape, pixels.dtype) == ((0,), np.float64)


def test_an_unmarked_body_has_no_marking_pixels():
    with open_renderer("cube") as unmarked:
        assert np.array_equal(unmarked.marking_pixels(rotations(7)), np.zeros(7))


def test_frames_are_the_same_in_another_process_and_in_any_order(renderer):
    poses = rotations(6)
    forwards = [(renderer.render(R), renderer.marking_pixels(R[None])[0]) for R in poses]
    with open_renderer() as another:
        counts = another.marking_pixels(poses[::-1])[::-1]
        backwards = [another.render(R) for R in poses[::-1]][::-1]
    for (view, pixels), count, again in zip(forwards, counts, backwards, strict=True):
        assert view.rgb.tobytes() == again.rgb.tobytes()
        assert view.segmentation.tobytes() == again.segmentation.tobytes()
        assert pixels == count
    assert len({view.rgb.tobytes() for view, _ in forwards}) == len(poses)


def test_rows_of_an_odd_width_are_read_without_their_padding():
    """Rows of a BMP are padded to 4 bytes: 17 pixels are 51 bytes, and a padding that is read shears the frame."""
    with open_renderer(size=17) as odd:
        for R in rotations(3):
            view, expected = odd.render(R), cast("tetX", R, 17)
            assert view.rgb.shape == (17, 17, 3)
            inside = ~boundary(expected)
            assert np.array_equal(view.segmentation[inside], expected[inside])
            assert np.array_equal((view.rgb == 255).all(axis=-1)[inside], (expected == 0)[inside])


def test_versions_name_blender_and_the_opengl_that_it_draws_with(renderer):
    assert renderer.versions["bpy"].startswith("4.5")
    assert renderer.versions["opengl"]


@pytest.mark.parametrize("name", ["SIGKILL", "SIGSEGV"])
def test_a_killed_blender_is_an_error_that_names_the_signal(name):
    with open_renderer() as killed:
        os.kill(killed.pid, signal.Signals[name])
        with pytest.raises(RendererCrashedError, match=rf"signal {name}\b"):
            killed.render(np.eye(3))
        with pytest.raises(RendererCrashedError):  # also for whoever asks once more
            killed.marking_pixels(np.eye(3)[None])


def test_close_from_another_thread_ends_a_request_under_way():
    renderer = open_renderer("cylO")
    ended_with = []

    def count():
        try:
            renderer.marking_pixels(np.tile(np.eye(3), (MINUTES_OF_COUNTS, 1, 1)))
        except BaseException as error:  # noqa: BLE001 - whatever it is, the test looks at it
            ended_with.append(error)

    counting = threading.Thread(target=count)
    counting.start()
    time.sleep(0.5)
    assert counting.is_alive()
    start = time.monotonic()
    renderer.close()
    counting.join()
    assert time.monotonic() - start < PROMPTLY_S
    assert [type(error) for error in ended_with] == [RendererCrashedError]


def test_a_request_to_a_closed_renderer_is_a_crash_and_not_an_error_of_python():
    """Close may come between two batches of one request, and then the next batch meets a closed connection."""
    renderer = open_renderer()
    renderer.close()
    renderer.close()
    with pytest.raises(RendererCrashedError):
        renderer.marking_pixels(np.eye(3)[None])


def test_a_renderer_outlives_the_thread_that_opened_it():
    """The kernel's death signal comes when the thread ends that started the process, not when the parent does."""
    opened = []
    thread = threading.Thread(target=lambda: opened.append(open_renderer(size=17)))
    thread.start()
    thread.join()
    with opened[0] as renderer:
        time.sleep(0.2)
        assert renderer.render(np.eye(3)).rgb.shape == (17, 17, 3)


def test_blender_dies_with_a_parent_that_was_killed_in_the_middle_of_a_request():
    with subprocess.Popen([sys.executable, "-c", PARENT], stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        time.sleep(0.2)
        assert is_running(pid)
        parent.kill()
    assert comes_true(lambda: not is_running(pid))


def test_close_leaves_no_process_no_file_and_no_descriptor(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    pids, open_descriptors = [], []
    for _ in range(5):
        with open_renderer(size=17) as renderer:
            pids.append(renderer.pid)
            renderer.render(np.eye(3))
        open_descriptors.append(descriptors())
    assert not any(is_running(pid) for pid in pids)
    assert len(set(open_descriptors)) == 1
    assert list(tmp_path.iterdir()) == []


def test_the_log_holds_the_last_request_alone(renderer):
    few, many = rotations(5), rotations(200)
    renderer.marking_pixels(few)
    after_few = log_bytes(renderer)
    renderer.marking_pixels(many)
    renderer.marking_pixels(few)
    assert log_bytes(renderer) <= after_few + 100  # lines differ by the digits of a duration


def test_the_quoted_output_is_text_however_long_blender_worked():
    with open_renderer() as renderer:
        renderer.marking_pixels(rotations(200))
        os.kill(renderer.pid, signal.SIGKILL)
        with pytest.raises(RendererCrashedError) as caught:
            renderer.render(np.eye(3))
    message = str(caught.value)
    assert "\0" not in message
    assert len(message) < 2000


def test_without_opengl_the_error_says_so_and_no_descriptor_is_left(monkeypatch):
    monkeypatch.setenv("__EGL_VENDOR_LIBRARY_DIRS", "/nonexistent")
    before = descriptors()
    with (
        pytest.raises(RendererMissingError, match=r"(?s)OpenGL through EGL.*doctor.*--engine cycles"),
        open_renderer() as renderer,
    ):
        _ = renderer.versions
    assert descriptors() == before


def test_without_bpy_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setattr(blender_process.util, "find_spec", lambda name: None)
    with pytest.raises(RendererMissingError, match=r"bpy.*not installed.*pip install 'symsol-annot\[render\]'"):
        open_renderer()


def test_a_process_that_has_imported_bpy_itself_starts_another_blender(monkeypatch):
    """Blender puts its own scripts on the path, in which lies a bpy that cannot be imported by itself."""
    scripts = list(Path(util.find_spec("bpy").origin).parent.glob("*/scripts/modules"))
    assert scripts
    assert (scripts[0] / "bpy" / "__init__.py").is_file()
    monkeypatch.syspath_prepend(scripts[0])
    with open_renderer(size=17) as renderer:
        assert renderer.render(np.eye(3)).rgb.shape == (17, 17, 3)


def test_a_bpy_that_lacks_a_library_is_an_error_that_names_the_library(tmp_path, monkeypatch):
    (tmp_path / "bpy.py").write_text("raise ImportError('libXrender.so.1: cannot open shared object file')")
    monkeypatch.syspath_prepend(tmp_path)
    with (
        pytest.raises(RendererMissingError, match=r"libXrender\.so\.1.*doctor"),
        open_renderer() as renderer,
    ):
        _ = renderer.versions


def test_another_python_is_told_which_one_renders_and_how_to_get_it(monkeypatch):
    check_blender_installed()
    monkeypatch.setattr(sys, "version_info", (3, 12, 1))
    with pytest.raises(RendererMissingError, match=r"needs Python 3\.11.*this is Python 3\.12.*python3\.11 -m venv"):
        check_blender_installed()


def test_pictures_do_not_depend_on_the_environment(monkeypatch, tmp_path):
    R = rotations(1)[0]
    with open_renderer() as renderer:
        expected = renderer.render(R).rgb
    monkeypatch.setenv("OCIO", str(tmp_path / "another-config.ocio"))
    monkeypatch.setenv("LP_NATIVE_VECTOR_WIDTH", "128")
    monkeypatch.setenv("BLENDER_SYSTEM_RESOURCES", str(tmp_path))
    with open_renderer() as renderer:
        assert np.array_equal(renderer.render(R).rgb, expected)


def test_a_renderer_that_is_still_starting_can_be_closed_at_once():
    before = time.monotonic()
    renderer = open_renderer()
    renderer.close()
    assert time.monotonic() - before < 1.0
    assert not is_running(renderer.pid)
