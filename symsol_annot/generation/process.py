"""A maker of shards in a process of its own, with its own Blender."""

import os
import socket
import sys
import threading
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from symsol_annot.errors import RendererCrashedError
from symsol_annot.generation.maker import MadeShard, OnShardImages, ShardMaker
from symsol_annot.rendering.blender_process import (
    END_ITSELF,
    SILENCE_S,
    Answer,
    BlenderProcess,
    Send,
    forget_chatter,
    open_blender,
    serve,
)
from symsol_annot.rendering.control import ControlledRenderer
from symsol_annot.rendering.renderer import Scene
from symsol_annot.sets.manifest import ShardEntry
from symsol_annot.sets.plan import SetPlan

_WATCH_SECONDS = 0.2
_RENEWED_AT = 0.75  # of the memory it may hold, between two shards


@dataclass(frozen=True)
class Limits:
    """How long a worker process is trusted.

    Attributes:
        frames: it is replaced after the shard with which it has drawn so many, candidates counted.
        memory_bytes: it ends where it holds more, and is replaced after a shard with which it holds three quarters.
        silence_s: it is ended when it gives no sign of life for so long; it gives one per image, or per 90 candidates.
    """

    frames: int = 2_000_000
    memory_bytes: int = 4 * 2**30
    silence_s: float = SILENCE_S


DEFAULT_LIMITS = Limits()


class ShardProcess:
    """Makes shards of a plan, in a Blender process that it starts and ends.

    Raises:
        RendererMissingError: bpy or a library that it needs is not there.
        RendererCrashedError: the process ended by itself, or grew beyond its memory, and the message quotes its last
            lines; or it no longer drew as at its start.
        RendererHungError: it gave no sign of life.
    """

    def __init__(self, plan: SetPlan, limits: Limits, *, exhaustive: bool = False) -> None:
        self._limits = limits
        self._process = BlenderProcess(__name__, _Task(plan, exhaustive, limits.memory_bytes), limits.silence_s)
        self.is_spent = False  # after a shard with which it has reached its limits

    @property
    def worker(self) -> str:
        """The process's name: its machine and number."""
        return _name_of(self._process.pid)

    def make(self, entry: ShardEntry, on_shard_images: OnShardImages) -> MadeShard:
        """Make one shard; `on_shard_images` is told of each image, and of the last again while candidates are drawn.

        Raises:
            RenderError: the renderer failed, or the process ended.
        """

        def is_sign_of_life(answer: Any) -> bool:
            if isinstance(answer, int):
                on_shard_images(answer)
            return isinstance(answer, int)

        try:
            made, frames, held_bytes = self._process.ask(entry, is_sign_of_life)
        except RendererCrashedError as error:
            error.worker = self.worker
            raise
        self.is_spent = frames >= self._limits.frames or held_bytes >= _RENEWED_AT * self._limits.memory_bytes
        return made

    def close(self) -> None:
        """End the process, whatever it is doing."""
        self._process.close()


@dataclass(frozen=True)
class _Task:
    """What a worker process is told at its start."""

    plan: SetPlan
    exhaustive: bool
    memory_bytes: int


def _start(task: _Task) -> tuple[Answer, str]:
    plan = task.plan
    _watch_memory(task.memory_bytes)
    renderer = ControlledRenderer(open_blender(Scene.for_object(plan.spec, plan.camera, plan.settings)))
    worker = _name_of(os.getpid())
    maker = ShardMaker(plan, renderer, exhaustive=task.exhaustive, worker=worker, check=renderer.check)

    def answer(entry: ShardEntry, send: Send) -> tuple[MadeShard, int, int]:
        last = 0

        def on_shard_images(made: int) -> None:
            nonlocal last
            last = made
            forget_chatter()
            send(made)

        renderer.on_batch = lambda: send(last)
        return maker.make(entry, on_shard_images), renderer.frames, _held_bytes()

    return answer, worker


def _name_of(pid: int) -> str:
    return f"{socket.gethostname()}/{pid}"


def _watch_memory(memory_bytes: int) -> None:
    """End this process as soon as it holds more, before it takes others with it."""

    def watch() -> None:
        while (held := _held_bytes()) <= memory_bytes:
            time.sleep(_WATCH_SECONDS)
        sys.stderr.write(f"it held {_mib(held)}, more than --worker-memory allows: {_mib(memory_bytes)}\n")
        sys.stderr.flush()
        os._exit(END_ITSELF)

    threading.Thread(target=watch, daemon=True).start()


def _mib(count: int) -> str:
    return f"{count / 2**20:.0f} MiB"


def _held_bytes() -> int:
    """Return the memory that this process holds now; 0 where the system does not tell (all but Linux)."""
    try:
        pages = int(Path("/proc/self/statm").read_text().split()[1])
    except OSError:
        return 0
    return pages * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    serve(_start)
