"""Does a renderer still draw what it drew at its start? A process whose memory is damaged does not, or dies of it."""

import hashlib
import os
from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RendererCrashedError
from symsol_annot.rendering.renderer import LabelWindow, LitWindow, Renderer, View
from symsol_annot.rotations.so3 import Rotations, uniform_rotations
from symsol_annot.system.closing import Closing

FRAMES_PER_CONTROL = 1000  # drawn at most between two controls
_COUNTS_PER_SIGN = 90  # rotations counted between two signs of life
_CONTROL_COUNTS = 4
_CONTROL_SEED = 10  # by which the markings of the built-in objects show in the picture, and hide in another view


class ControlledRenderer(Closing):
    """A renderer that draws the same few frames again and again: all must be as the first were, byte for byte.

    The control is one view with its picture, and the marking counted in four. It is drawn at the start, after every
    1000 frames, and when `check` is called.

    Args:
        renderer: draws.

    Attributes:
        frames: how many were drawn, those of controls included.
        on_batch: called after each 90 candidates counted, as a sign of life.

    Raises:
        RendererCrashedError: a control was drawn otherwise than at the start; no frame since the start is to be kept.
    """

    def __init__(self, renderer: Renderer) -> None:
        self._renderer, self.frames = renderer, 0
        self.on_batch: Callable[[], object] = lambda: None
        self._rotations = control_rotations()
        self._expected = self._control()

    @property
    def versions(self) -> dict[str, str]:
        """The software that decides the pixels: name to version."""
        return self._renderer.versions

    def render(self, R_m2c: Rotations) -> View:
        """Draw the object under one rotation (3, 3)."""
        self._check_now_and_then()
        self.frames += 1
        return self._renderer.render(R_m2c)

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return the marking's visible area in pixels under each of (n, 3, 3) rotations: (n,)."""
        counts = [np.zeros(0)]
        for start in range(0, len(R_m2c), _COUNTS_PER_SIGN):
            self._check_now_and_then()
            counts.append(self._renderer.marking_pixels(R_m2c[start : start + _COUNTS_PER_SIGN]))
            self.frames += len(counts[-1])
            self.on_batch()
        return np.concatenate(counts)

    def label_windows(self, R_m2c: Rotations) -> list[LabelWindow]:
        """Return what lies around the marking under each of (n, 3, 3) rotations."""
        found: list[LabelWindow] = []
        for start in range(0, len(R_m2c), _COUNTS_PER_SIGN):
            self._check_now_and_then()
            found += self._renderer.label_windows(R_m2c[start : start + _COUNTS_PER_SIGN])
            self.frames += min(_COUNTS_PER_SIGN, len(R_m2c) - start)
            self.on_batch()
        return found

    def lit_windows(self, R_m2c: Rotations) -> list[LitWindow]:
        """Return what lies around the marking under each of (n, 3, 3) rotations, and its colours."""
        found: list[LitWindow] = []
        for start in range(0, len(R_m2c), _COUNTS_PER_SIGN):
            self._check_now_and_then()
            found += self._renderer.lit_windows(R_m2c[start : start + _COUNTS_PER_SIGN])
            self.frames += min(_COUNTS_PER_SIGN, len(R_m2c) - start)
            self.on_batch()
        return found

    def check(self) -> None:
        """Draw the control again; to be called before anything that was drawn is kept.

        Raises:
            RendererCrashedError: it is not as it was at the start.
        """
        if self._control() != self._expected:
            raise RendererCrashedError(
                f"Blender's process {os.getpid()} drew a frame otherwise than at its start: its memory is damaged. "
                "None of what it drew since a control is kept. If this happens again, test the memory of this machine"
            )

    def close(self) -> None:
        """Let go of the renderer."""
        self._renderer.close()

    def _check_now_and_then(self) -> None:
        if self.frames >= self._due:
            self.check()

    def _control(self) -> bytes:
        """Draw the control, and return a digest of all that was drawn."""
        view = self._renderer.render(self._rotations[0])
        counts = self._renderer.marking_pixels(self._rotations)
        self.frames += 1 + len(counts)
        self._due = self.frames + FRAMES_PER_CONTROL
        digest = hashlib.sha256(view.part_pixels.tobytes() + counts.tobytes())
        for picture in (view.rgb, view.segmentation):
            digest.update(f"{picture.shape} {picture.dtype}".encode() + picture.tobytes())
        return digest.digest()


def control_rotations() -> Rotations:
    """Return the rotations (4, 3, 3) that every control draws; of the first, the picture as well."""
    return uniform_rotations(_CONTROL_COUNTS, np.random.default_rng(_CONTROL_SEED))
