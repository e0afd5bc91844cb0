"""A process that Blender lives in, seen from both its ends: whatever it does to its process is an error message here.

The parent's end, `BlenderProcess`, starts `python -m MODULE CONNECTION LIFELINE`, sends it a task, and then requests.
The module's end is `serve`. What Blender prints goes to an unnamed file that is quoted when it fails. The process
ends with its parent, and is ended when it falls silent.
"""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from importlib import import_module, util
from itertools import groupby
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from symsol_annot.errors import RendererCrashedError, RendererHungError, RendererMissingError, RenderError
from symsol_annot.rendering.engines import Drawing, engine_named, engines_without_opengl
from symsol_annot.rendering.renderer import Renderer, Scene
from symsol_annot.system.scratch import Scratch, remove_marked, temporary_errors

if sys.platform != "win32":
    import fcntl

RENDERING_PYTHON = (3, 11)
SILENCE_S = 300.0  # without a sign of life, by default
END_ITSELF = 75  # the exit code of a process that says why in its last line
_QUOTED_LINES = 12
_FRAME_CHATTER = ("Saved:", "Time:", "Fra:")
_NO_OPENGL = ("No OpenGL vendor detected", "Couldn't find current GLX or EGL context", "libEGL")
_NO_MEMORY = ("std::bad_alloc", "MemoryError", "out of memory", "Cannot allocate memory")
_DECIDES_PIXELS = ("OCIO", "BLENDER_", "LP_", "CYCLES_")  # variables that would change the pictures, unrecorded
_SLOWS = ("MALLOC_",)  # Dask's nannies set MALLOC_TRIM_THRESHOLD_, and drawing takes 1.4 times the CPU time with it


class BlenderProcess:
    """The parent's end.

    Args:
        module: runs as the process; it calls `serve`.
        task: what it is for, its first message; sent at first use.
        silence_s: for how long it may give no sign of life.

    Raises:
        RendererMissingError: bpy or a library that it needs is not there.
        RendererCrashedError: the process ended by itself; the message quotes its last lines.
        RendererHungError: it gave no sign of life.
        RenderError: what it says went wrong.
        OutputError: there is no room for temporary files.
    """

    def __init__(self, module: str, task: Any, silence_s: float = SILENCE_S) -> None:
        check_blender_installed()
        self._task, self._silence_s = task, silence_s
        self._first_answer: Any = None  # until it has started
        with temporary_errors():
            self._scratch = Scratch()  # Blender's, which removes it once it has started
            try:
                self._log = tempfile.TemporaryFile(mode="a+b")  # noqa: SIM115 - lives as long as the process
            except OSError:
                self._scratch.close()
                raise
        ours, theirs = socket.socketpair()
        lifeline, self._lifeline = os.pipe()  # never written to; its end tells that this process has ended
        try:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", module, str(theirs.fileno()), str(lifeline)],
                stdin=subprocess.DEVNULL,
                stdout=self._log,
                stderr=self._log,
                pass_fds=[theirs.fileno(), lifeline],
                env=_environment(str(self._scratch.path)),
                start_new_session=True,  # Ctrl-C is the parent's to handle
            )
        except BaseException:
            self._scratch.close()
            ours.close()
            os.close(self._lifeline)
            self._log.close()
            raise
        finally:
            theirs.close()
            os.close(lifeline)
        self._connection = Connection(ours.detach())
        self._talking = threading.Lock()

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    def first_answer(self) -> Any:
        """Hand over the task, at first use, so that it starts while others do; return what it said when it had."""
        with self._talking:
            return self._start()

    def ask(self, request: Any, is_sign_of_life: Callable[[Any], bool] = lambda _: False) -> Any:
        """Send a request and return its answer, after any number of signs of life."""
        with self._talking:
            self._start()
            answer = self._exchange(request)
            while is_sign_of_life(answer):
                answer = self._receive()
            return answer

    def close(self) -> None:
        """End the process, whatever it is doing; a request under way in another thread ends as a crash."""
        with contextlib.suppress(ProcessLookupError):
            self._process.kill()
        self._process.wait()
        with self._talking:
            if not self._log.closed:
                self._scratch.close()
                self._connection.close()
                os.close(self._lifeline)
                self._log.close()

    def _start(self) -> Any:
        if self._first_answer is None:
            self._first_answer = self._exchange(self._task)
        return self._first_answer

    def _exchange(self, request: Any) -> Any:
        try:
            self._connection.send(request)
        except OSError:
            raise self._crash() from None
        return self._receive()

    def _receive(self) -> Any:
        try:
            if not self._connection.poll(self._silence_s):
                raise self._hung()
            answer = self._connection.recv()
        except (EOFError, OSError):
            raise self._crash() from None
        if isinstance(answer, RenderError):
            raise answer
        return answer

    def _hung(self) -> RendererHungError:
        self._process.kill()
        self._process.wait()
        return RendererHungError(
            f"Blender's process {self.pid} gave no sign of life for {self._silence_s:g} s, and was ended. "
            f"Its last output:\n{_quoted(self._last_output())}\n"
            "Finished shards are kept: re-running the command resumes it, with a longer --time-limit if need be."
        )

    def _crash(self) -> RenderError:
        if self._log.closed:
            return RendererCrashedError("the renderer was closed while it was drawing, or before")
        code = self._process.wait()
        how = f"was ended by signal {signal.Signals(-code).name}" if code < 0 else f"ended with exit code {code}"
        if code == -signal.SIGKILL:
            how += " (as the system does when memory runs out: fewer --workers need less)"
        lines = self._last_output()
        if any(word in line for line in lines for word in _NO_MEMORY):
            how += " (memory ran out: fewer --workers need less)"
        if any(word in line for line in lines for word in _NO_OPENGL):
            return RendererMissingError(
                "this engine draws with OpenGL through EGL, and Blender found none:\n"
                f"{_quoted(lines)}\n`symsol-annot doctor` says what to install; {_other_engines()}."
            )
        if code == END_ITSELF:
            return RendererCrashedError(f"Blender's process {self.pid} ended itself: {lines[-1]}")
        return RendererCrashedError(f"Blender's process {self.pid} {how}. Its last output:\n{_quoted(lines)}")

    def _last_output(self) -> list[str]:
        self._log.seek(0)
        lines = self._log.read().decode(errors="replace").splitlines()
        return [line for line, _ in groupby(lines) if line.strip() and not line.startswith(_FRAME_CHATTER)]


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


def open_blender(scene: Scene) -> Renderer:
    """Return the renderer on Blender, which draws one scene in this process.

    Raises:
        RendererMissingError: bpy, or a library that it needs, cannot be loaded.
    """
    try:
        if engine_named(scene.settings.engine).drawing is Drawing.OFFSCREEN:
            from symsol_annot.rendering.blender.opengl import OpenGLRenderer

            return OpenGLRenderer(scene)
        from symsol_annot.rendering.blender.pipeline import PipelineRenderer

        return PipelineRenderer(scene)
    except ImportError as error:
        raise RendererMissingError(
            f"Blender's module bpy cannot be loaded: {error}. `symsol-annot doctor` says what to install."
        ) from None


Send = Callable[[Any], object]
Answer = Callable[[Any, Send], Any]  # from a request, and what sends signs of life, to its answer


def serve(start: Callable[[Any], tuple[Answer, Any]]) -> None:
    """Be the other end: start on the parent's task, then answer its requests until it goes.

    Args:
        start: from the task to what answers requests, and the first answer.
    """
    connection, lifeline = Connection(int(sys.argv[1])), int(sys.argv[2])
    _die_with_parent(lifeline)
    with contextlib.suppress(ImportError):  # which `open_blender` tells of
        import_module("symsol_annot.rendering.blender.device")  # takes longest, and waits for no task
    try:
        answer, first_answer = start(connection.recv())
        remove_marked(Path(os.environ["TMPDIR"]))  # nothing is left, even if both are killed
        connection.send(first_answer)
        while True:
            request = connection.recv()
            forget_chatter()
            try:
                connection.send(answer(request, connection.send))
            except RenderError as error:
                connection.send(error)
    except RenderError as error:
        connection.send(error)
    except (EOFError, ConnectionError):
        pass  # the parent is gone
    os._exit(0)  # Blender's own shutdown has nothing to save


def forget_chatter() -> None:
    """Empty this process's log, so that it holds the last lines alone and does not grow."""
    sys.stdout.flush()
    with contextlib.suppress(OSError):
        os.ftruncate(1, 0)
        os.lseek(1, 0, os.SEEK_SET)


def _environment(scratch: str) -> dict[str, str]:
    """Return Blender's environment: no other rasteriser threads, this Python's packages, nothing in the user's home.

    Where this process has imported bpy, its path has folders of Blender's own scripts, in which another bpy lies.
    """
    kept = {key: value for key, value in os.environ.items() if not key.startswith((*_DECIDES_PIXELS, *_SLOWS))}
    return {
        **kept,
        "LP_NUM_THREADS": "0",
        "OPENBLAS_NUM_THREADS": "1",
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path and "bpy" not in Path(path).parts),
        "TMPDIR": scratch,
        "BLENDER_USER_RESOURCES": scratch,
        "XDG_CACHE_HOME": scratch,  # else Blender makes ~/.cache/thumbnails
        "MESA_SHADER_CACHE_DISABLE": "true",  # it maps a file, and a full disk ends whoever writes there (SIGBUS)
    }


def _other_engines() -> str:
    """Return which engines draw without OpenGL, in words."""
    return ", ".join(f"`--engine {name}` needs no OpenGL" for name in engines_without_opengl())


def _quoted(lines: list[str]) -> str:
    return "\n".join(f"  | {line}" for line in lines[-_QUOTED_LINES:]) or "  | (nothing)"


def _die_with_parent(lifeline: int) -> None:
    """End this process with its parent, which alone holds the lifeline's other end.

    Linux kills it in whatever it is doing, stopped or stuck; elsewhere a thread waits for the end. The kernel's notice
    of a parent's death (PR_SET_PDEATHSIG) would come when the thread ends that started this process.
    """

    def wait() -> None:
        os.read(lifeline, 1)
        os._exit(1)

    if sys.platform == "linux":
        fcntl.fcntl(lifeline, fcntl.F_SETSIG, signal.SIGKILL)
        fcntl.fcntl(lifeline, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(lifeline, fcntl.F_SETFL, fcntl.fcntl(lifeline, fcntl.F_GETFL) | os.O_ASYNC)
    threading.Thread(target=wait, daemon=True).start()
