"""A plain Renderer on the ray caster, for tests that are not about Blender."""

from functools import cache

import numpy as np
from oracle import cast, cast_samples

from symsol_annot.objects.spec import load_object
from symsol_annot.rendering.renderer import LabelWindow, View
from symsol_annot.rendering.windows import Window

COLOURS = np.array([[255, 255, 255], [180, 200, 230], [230, 90, 40]], dtype=np.uint8)
# Of the 3x3 samples of a pixel, those on its corners are shared by four, those on its edges by two.
WEIGHTS = {(i, j): (2 - abs(i - 1)) * (2 - abs(j - 1)) for i in range(3) for j in range(3)}


@cache
def parts_of(name):
    return load_object(name).mesh.parts


class NumpyRenderer:
    """Draws a built-in object in flat colours; `on_frame` is called before each frame, and may raise.

    Its depths are made up: what is farther down lies nearer.
    """

    def __init__(self, name, size=32, on_frame=lambda: None, *, has_depth=False):
        self.name, self.size, self.on_frame, self.is_closed = name, size, on_frame, False
        self.has_depth = has_depth

    @property
    def versions(self):
        return {"renderer": "numpy"}

    def render(self, R_m2c):
        self.on_frame()
        ids = cast_samples(self.name, R_m2c, self.size)
        samples = COLOURS[ids].astype(int)
        rgb = np.zeros((self.size, self.size, 3), int)
        for (row, column), weight in WEIGHTS.items():
            rgb += weight * samples[row:, column:][: 2 * self.size : 2, : 2 * self.size : 2]
        part_pixels = np.array([np.count_nonzero(ids == part) / 4 for part in (1, 2)[: parts_of(self.name)]])
        segmentation, rows = cast(self.name, R_m2c, self.size), np.arange(self.size)[:, None]
        depth = np.where(segmentation > 0, 4.5 - rows / self.size, 0.0).astype(np.float32) if self.has_depth else None
        return View(((rgb + 8) // 16).astype(np.uint8), segmentation, part_pixels, depth)

    def marking_pixels(self, R_m2c):
        counts = [np.count_nonzero(cast_samples(self.name, R, self.size) == 2) for R in R_m2c]
        return np.array(counts, dtype=float) / 4

    def label_windows(self, R_m2c):
        side = 2 * self.size + 1
        return [LabelWindow(Window(0, 0, side, side), cast_samples(self.name, R, self.size)) for R in R_m2c]

    def close(self):
        self.is_closed = True

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()
