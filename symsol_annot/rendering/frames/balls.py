"""A ball drawn as the sphere that its facets stand for, so that nothing of its picture tells how it is turned.

Facets leave a ring of up to `max_offset` off the sphere's outline, and at the rim, where light falls off fast, they
change the shade: a network could read the rotation from what should look the same. So a ball's outline, its light and
its depth are those of the unit sphere; its mesh tells the parts alone.
"""

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.mesh import BODY_ID
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.windows import Window

Words = npt.NDArray[np.uint32]

_ID_BITS, _LIGHT = 16, (1 << 16) - 1  # a word is an id above these bits, and light in them


@dataclass(frozen=True, eq=False)
class BallPicture:
    """What a camera sees of the unit sphere at the origin, at (height, width) points.

    Attributes:
        is_inside: bool, which points see it.
        light: u4, max(0, -n_z) of its normal there, from 0 to 65,535; 0 elsewhere.
        z: f4, how far along the camera's axis it lies there from the camera; 0 elsewhere.
    """

    is_inside: npt.NDArray[np.bool_]
    light: Words
    z: npt.NDArray[np.float32]

    @classmethod
    def seen_by(cls, camera: Camera) -> "BallPicture":
        """Return the picture at a camera's pixels' centres, or at a lattice's points.

        The ray through a point is (0, 0, -D) + t d with d = (x, y, 1). It meets the sphere where
        t^2 |d|^2 - 2 t D + D^2 - 1 = 0, first at t = (D - sqrt(D^2 - |d|^2 (D^2 - 1))) / |d|^2, which is the depth; the
        normal is the point itself, whose z is t - D.
        """
        x = (np.arange(camera.width) + 0.5 - camera.width / 2) / camera.focal_px
        y = (np.arange(camera.height) + 0.5 - camera.height / 2) / camera.focal_px
        squared = np.square(x) + np.square(y)[:, None] + 1.0
        D = camera.distance
        discriminant = D**2 - squared * (D**2 - 1.0)
        is_inside = discriminant >= 0.0
        z = np.where(is_inside, (D - np.sqrt(np.maximum(discriminant, 0.0))) / squared, 0.0)
        light = np.where(is_inside, np.floor(np.clip(D - z, 0.0, 1.0) * _LIGHT + 0.5), 0.0)
        return cls(is_inside, light.astype(np.uint32), z.astype(np.float32))

    @property
    def window(self) -> Window:
        """The window of all points that see it."""
        rows, columns = (np.flatnonzero(self.is_inside.any(axis=axis)) for axis in (1, 0))
        return Window(int(columns[0]), int(rows[0]), int(np.ptp(columns)) + 1, int(np.ptp(rows)) + 1)

    def cut(self, window: Window) -> "BallPicture":
        """Return what lies in a window."""
        return replace(
            self, is_inside=self.is_inside[window.slices], light=self.light[window.slices], z=self.z[window.slices]
        )

    def drawn_over(self, words: Words) -> Words:
        """Return a mesh's words (height, width) with the sphere's outline and light; where it has none, the body's.

        Of a part that the mesh draws beyond the outline, by the rounding of its vertices, nothing is taken away.
        """
        ids = words >> np.uint32(_ID_BITS)
        ids[self.is_inside & (ids == 0)] = BODY_ID
        ids[~self.is_inside & (ids == BODY_ID)] = 0
        return np.where(ids > 0, (ids << np.uint32(_ID_BITS)) | self.light, np.uint32(0))
