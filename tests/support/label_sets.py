"""Small sets of four objects without pictures, with arcs like those of real ones."""

import numpy as np

from symsol_annot.rendering.renderer import View

SIZE = 160  # of the images; shown with under 10.2 pixels is barely shown
IMAGES = {"tetX": 32, "cylO": 28, "cone": 5, "icosa": 6}


class LabelRenderer:
    """Draws nothing; a marking's area is that of a flat patch seen by the camera, with frayed ends."""

    AREA_PX = 25.0

    def __init__(self, name):
        normals = {"tetX": -np.ones(3) / 3**0.5, "cylO": np.array([1.0, 0.0, 0.0])}
        centres = {"tetX": -np.ones(3) / 3**1.5, "cylO": np.array([0.656, 0.0, 0.55])}
        self._normal, self._centre = normals.get(name), centres.get(name)
        self.versions = {"renderer": "labels"}

    def render(self, R_m2c):
        parts = np.array([100.0, *self.marking_pixels(R_m2c[None])][: 1 + (self._normal is not None)])
        return View(np.zeros((SIZE, SIZE, 3), dtype=np.uint8), np.zeros((SIZE, SIZE), dtype=np.uint8), parts)

    def marking_pixels(self, R_m2c):
        if self._normal is None:
            return np.zeros(len(R_m2c))
        ray = R_m2c @ self._centre + [0.0, 0.0, 4.0]
        facing = -np.einsum("ij,ij->i", R_m2c @ self._normal, ray) / 4.0
        is_frayed = (facing > 0) & (facing < 0.05) & (np.sin(1e4 * facing) > 0)
        return np.where(is_frayed, 0.0, np.ceil(4 * self.AREA_PX * np.maximum(facing, 0.0)) / 4)

    def close(self):
        pass

    def __enter__(self):
        return self

    def __exit__(self, *exc):
        self.close()
