"""A plain Renderer on the ray caster, for tests that are not about Blender."""

import numpy as np
from oracle import cast

from symsol_annot.scene import View

COLOURS = np.array([[255, 255, 255], [180, 200, 230], [230, 90, 40]], dtype=np.uint8)
SAMPLES_PER_AXIS = 2


class NumpyRenderer:
    """Draws a built-in object in flat colours; `on_frame` is called before each frame, and may raise."""

    def __init__(self, name, size=32, on_frame=lambda: None):
        self.name, self.size, self.on_frame, self.is_closed = name, size, on_frame, False

    @property
    def versions(self):
        return {"renderer": "numpy"}

    def render(self, R_m2c):
        self.on_frame()
        n = SAMPLES_PER_AXIS
        samples = COLOURS[cast(self.name, R_m2c, self.size, n)].astype(np.uint16)
        blocks = samples.reshape(self.size, n, self.size, n, 3)
        return View(
            ((blocks.sum(axis=(1, 3)) + n * n // 2) // (n * n)).astype(np.uint8), cast(self.name, R_m2c, self.size)
        )

    def marking_pixels(self, R_m2c):
        n = SAMPLES_PER_AXIS
        counts = [np.count_nonzero(cast(self.name, R, self.size, n) == 2) for R in R_m2c]
        return np.array(counts, dtype=float) / n**2

    def close(self):
        self.is_closed = True

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()
