"""A Renderer in a process of its own, asked for one view or one batch of counts at a time."""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.blender_process import SILENCE_S, Answer, BlenderProcess, open_blender, serve
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import LabelWindow, LitWindow, Scene, View
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations, check_rotations
from symsol_annot.system.closing import Closing

COUNTS_PER_REQUEST = 90  # rotations counted between two looks at the parent


class RenderProcess(Closing):
    """Draws one object through one camera, in a Blender process that it starts and ends.

    Raises:
        RendererMissingError: bpy or a library that it needs is not there.
        RendererCrashedError: the process ended by itself; the message quotes its last lines.
        RendererHungError: it gave no sign of life for `silence_s`.
        RenderError: Blender drew something that is no segmentation.
        RotationError: what should be drawn is no rotation.
    """

    def __init__(
        self, spec: ObjectSpec, camera: Camera, settings: RenderSettings, silence_s: float = SILENCE_S
    ) -> None:
        self._process = BlenderProcess(__name__, Scene.for_object(spec, camera, settings), silence_s)

    @property
    def versions(self) -> dict[str, str]:
        """The software that decides the pixels: name to version."""
        return dict(self._process.first_answer())

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    def render(self, R_m2c: Rotations) -> View:
        """Draw the object under one rotation (3, 3)."""
        view: View = self._process.ask(("render", check_rotations(R_m2c, "R_m2c")))
        return view

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return the marking's visible area in pixels under each of (n, 3, 3) rotations: (n,)."""
        R_m2c = check_rotations(R_m2c, "R_m2c")
        batches = [R_m2c[start : start + COUNTS_PER_REQUEST] for start in range(0, len(R_m2c), COUNTS_PER_REQUEST)]
        counts = [self._process.ask(("marking_pixels", batch)) for batch in batches]
        return np.concatenate([np.zeros(0), *counts])

    def label_windows(self, R_m2c: Rotations) -> list[LabelWindow]:
        """Return what lies around the marking under each of (n, 3, 3) rotations."""
        R_m2c = check_rotations(R_m2c, "R_m2c")
        found: list[LabelWindow] = []
        for start in range(0, len(R_m2c), COUNTS_PER_REQUEST):
            found += self._process.ask(("label_windows", R_m2c[start : start + COUNTS_PER_REQUEST]))
        return found

    def lit_windows(self, R_m2c: Rotations) -> list[LitWindow]:
        """Return what lies around the marking under each of (n, 3, 3) rotations, and its colours."""
        R_m2c = check_rotations(R_m2c, "R_m2c")
        found: list[LitWindow] = []
        for start in range(0, len(R_m2c), COUNTS_PER_REQUEST):
            found += self._process.ask(("lit_windows", R_m2c[start : start + COUNTS_PER_REQUEST]))
        return found

    def close(self) -> None:
        """End the process, whatever it is doing; a request under way in another thread ends as a crash."""
        self._process.close()


def _start(scene: Scene) -> tuple[Answer, dict[str, str]]:
    renderer = open_blender(scene)
    return lambda request, _: getattr(renderer, request[0])(request[1]), renderer.versions


if __name__ == "__main__":
    serve(_start)
