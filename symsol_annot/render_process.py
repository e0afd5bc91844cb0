"""A Renderer in a process of its own, so that whatever Blender does to its process is an error message here.

The parent starts `python -m symsol_annot.render_process DESCRIPTOR`, hands over the scene, and then asks for one
frame or one batch of counts at a time. What Blender prints goes to an unnamed file that is quoted when it fails.
"""

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from importlib import util
from itertools import groupby
from multiprocessing.connection import Connection
from types import TracebackType
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RendererCrashedError, RendererMissingError, RenderError
from symsol_annot.mesh import Mesh
from symsol_annot.objects import ObjectSpec
from symsol_annot.scene import Camera, RenderSettings, View
from symsol_annot.so3 import Rotations, check_rotations

RENDERING_PYTHON = (3, 11)
COUNTS_PER_REQUEST = 90  # rotations counted between two looks at the parent
_QUOTED_LINES = 12
_FRAME_CHATTER = ("Saved:", "Time:", "Fra:")
_NO_OPENGL = ("No OpenGL vendor detected", "Couldn't find current GLX or EGL context", "libEGL")
_WATCH_SECONDS = 0.2
_DECIDES_PIXELS = ("OCIO", "BLENDER_", "LP_", "CYCLES_")  # variables that would change the pictures, unrecorded


class RenderProcess:
    """Draws one object through one camera, in a Blender process that it starts and ends.

    Raises:
        RendererMissingError: bpy or a library that it needs is not there.
        RendererCrashedError: the process ended by itself; the message quotes its last lines.
        RenderError: Blender drew something that is no segmentation.
        RotationError: what should be drawn is no rotation.
    """

    def __init__(self, spec: ObjectSpec, camera: Camera, settings: RenderSettings) -> None:
        check_blender_installed()
        self._scene = (os.getpid(), spec.mesh, camera, settings)
        self._versions: dict[str, str] | None = None  # until it has started
        self._talking = threading.Lock()
        self._log = tempfile.TemporaryFile(mode="a+b")  # noqa: SIM115 - lives as long as the process
        self._scratch = tempfile.mkdtemp(prefix="symsol-annot-")  # Blender's, which removes it once it has started
        ours, theirs = socket.socketpair()
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "symsol_annot.render_process", str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                pass_fds=[theirs.fileno()],
                env=_environment(self._scratch),
                start_new_session=True,  # Ctrl-C is the parent's to handle
            )
        except BaseException:
            shutil.rmtree(self._scratch, ignore_errors=True)
            ours.close()
            self._log.close()
            raise
        finally:
            theirs.close()
        self._connection = Connection(ours.detach())

    @property
    def versions(self) -> dict[str, str]:
        """The software that decides the pixels: name to version."""
        with self._talking:
            return dict(self._started())

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    def render(self, R_m2c: Rotations) -> View:
        """Draw the object under one rotation (3, 3)."""
        view: View = self._ask("render", check_rotations(R_m2c, "R_m2c"))
        return view

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return the marking's visible area in pixels under each of (n, 3, 3) rotations: (n,)."""
        R_m2c = check_rotations(R_m2c, "R_m2c")
        batches = [R_m2c[start : start + COUNTS_PER_REQUEST] for start in range(0, len(R_m2c), COUNTS_PER_REQUEST)]
        return np.concatenate([np.zeros(0), *(self._ask("marking_pixels", batch) for batch in batches)])

    def close(self) -> None:
        """End the process, whatever it is doing; a request under way in another thread ends as a crash."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        shutil.rmtree(self._scratch, ignore_errors=True)
        with self._talking:
            self._connection.close()
            self._log.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _ask(self, *request: Any) -> Any:
        with self._talking:
            self._started()
            return self._exchange(request)

    def _started(self) -> dict[str, str]:
        """Hand over the scene at first use, so that the process starts while others do, and can be closed meanwhile."""
        if self._versions is None:
            self._versions = self._exchange(self._scene)
        return self._versions

    def _exchange(self, request: Any) -> Any:
        try:
            self._connection.send(request)
            answer = self._connection.recv()
        except (EOFError, OSError):
            raise self._crash() from None
        if isinstance(answer, RenderError):
            raise answer
        return answer

    def _crash(self) -> RenderError:
        if self._log.closed:
            return RendererCrashedError("the renderer was closed while it was drawing, or before")
        code = self._process.wait()
        how = f"was ended by signal {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").splitlines()
        telling = [line for line, _ in groupby(lines) if line.strip() and not line.startswith(_FRAME_CHATTER)]
        said = "\n".join(f"  | {line}" for line in telling[-_QUOTED_LINES:]) or "  | (nothing)"
        if any(word in line for line in telling for word in _NO_OPENGL):
            return RendererMissingError(
                f"the engine {self._scene[3].engine!r} draws with OpenGL through EGL, and Blender found none:\n{said}\n"
                "`symsol-annot doctor` says what to install; `--engine cycles` needs no OpenGL."
            )
        return RendererCrashedError(
            f"Blender's process {how}. Its last words:\n{said}\n"
            "Finished shards are kept: the same command goes on from there. "
            "`symsol-annot doctor` tells what Blender may be missing here."
        )


def _environment(scratch: str) -> dict[str, str]:
    """Return Blender's environment: one rasteriser thread, this Python's packages, nothing in the user's home."""
    kept = {key: value for key, value in os.environ.items() if not key.startswith(_DECIDES_PIXELS)}
    return {
        **kept,
        "LP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        "TMPDIR": scratch,
        "BLENDER_USER_RESOURCES": scratch,
    }


def check_blender_installed() -> None:
    """Check that bpy can be imported by this Python.

    Raises:
        RendererMissingError: it cannot; the message says why and what to do.
    """
    has_right_python = sys.version_info[:2] == RENDERING_PYTHON
    if not has_right_python:
        raise RendererMissingError(
            "rendering needs Python 3.11: Blender's module bpy (4.5 LTS) is built for that version alone, and this "
            f"is Python {sys.version_info[0]}.{sys.version_info[1]}. Make an environment with it: "
            "in a clone of this project, `python3.11 -m venv env && env/bin/pip install '.[render]'`. "
            "Loading and verifying work here as they are."
        )
    if util.find_spec("bpy") is None:
        raise RendererMissingError(
            "rendering needs Blender's module bpy, which is not installed: `pip install 'symsol-annot[render]'`"
        )


def _serve(descriptor: int) -> None:
    """Answer the parent's requests until it closes the connection."""
    connection = Connection(descriptor)
    parent, mesh, camera, settings = connection.recv()
    _die_with(parent)
    try:
        renderer = _start_blender(mesh, camera, settings)
    except RenderError as error:
        connection.send(error)
        return
    shutil.rmtree(os.environ["TMPDIR"], ignore_errors=True)  # nothing is left, even if parent and child are killed
    connection.send(renderer.versions)
    while True:
        try:
            method, argument = connection.recv()
        except EOFError:
            return
        _forget_chatter()
        try:
            connection.send(getattr(renderer, method)(argument))
        except RenderError as error:
            connection.send(error)


def _start_blender(mesh: Mesh, camera: Camera, settings: RenderSettings) -> Any:
    try:
        from symsol_annot.blender import BlenderRenderer
    except ImportError as error:
        raise RendererMissingError(
            f"Blender's module bpy cannot be loaded: {error}. `symsol-annot doctor` says what to install."
        ) from None
    return BlenderRenderer(mesh, camera, settings)


def _die_with(parent: int) -> None:
    """End this process soon after its parent, also where the parent was killed in the middle of a frame.

    The kernel's own notice (PR_SET_PDEATHSIG) would come when the thread ends that started this process.
    """

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(_WATCH_SECONDS)
        shutil.rmtree(os.environ["TMPDIR"], ignore_errors=True)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _forget_chatter() -> None:
    """Empty the log before the next request, so that it holds the last one's lines and does not grow."""
    sys.stdout.flush()
    with contextlib.suppress(OSError):
        os.ftruncate(1, 0)
        os.lseek(1, 0, os.SEEK_SET)


if __name__ == "__main__":
    _serve(int(sys.argv[1]))
    os._exit(0)  # Blender's own shutdown has nothing to save
