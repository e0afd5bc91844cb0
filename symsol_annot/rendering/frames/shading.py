"""The colours that a view is drawn in: sRGB, and for Blender's render pipeline the light at the mesh's corners."""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import BODY
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations

Bytes = npt.NDArray[np.uint8]

_THIN = 0.25  # lattice spacings; in a thicker triangle a point is at most a fortieth of its height off (2048 pixels)


class CornerLight:
    """The colours that the camera's light gives the corners of a mesh; an engine interpolates them.

    A rasteriser takes a triangle's colour at points that lie a little beside it, where its moved corners reach. On a
    triangle that is thinner than that, seen edge-on, such a colour could be any; so thin triangles have a single one.
    """

    def __init__(
        self, mesh: Mesh, part_colours: npt.NDArray[np.float64], lattice: Camera, settings: RenderSettings
    ) -> None:
        self._mesh, self._lattice, self._settings = mesh, lattice, settings
        self._colours = part_colours[mesh.part_ids - BODY][:, None]

    def colours(self, R_m2c: Rotations) -> npt.NDArray[np.float32]:
        """Return linear colours (T, 3, 4) with an alpha of 1: colour x (ambient + diffuse x max(0, -n_z))."""
        cosine = np.maximum(0.0, -(self._mesh.corner_normals @ R_m2c[2]))
        is_thin = self._heights(R_m2c) < _THIN
        cosine[is_thin] = cosine[is_thin].mean(axis=1, keepdims=True)
        colours = np.ones((*cosine.shape, 4), np.float32)
        light = self._settings.ambient + self._settings.diffuse * cosine
        colours[..., :3] = self._colours * light[..., None]
        return colours

    def _heights(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return how far each triangle (T,) reaches from its longest side, in the lattice's spacing."""
        corners = self._lattice.project(self._mesh.vertices @ R_m2c.T)[self._mesh.triangles]
        sides = np.roll(corners, -1, axis=1) - corners
        doubled_area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
        return np.asarray(doubled_area / np.sqrt((sides**2).sum(axis=2).max(axis=1)))


def srgb(linear: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return linear colours in [0, 1] as sRGB in [0, 1] (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def linear(encoded: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return sRGB colours in [0, 1] as linear ones: the inverse of `srgb`."""
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def srgb_bytes(linear: npt.NDArray[np.float64]) -> Bytes:
    """Return linear colours, clipped to [0, 1], as sRGB in 8 bits."""
    return np.asarray(np.floor(255.0 * np.clip(srgb(linear), 0.0, 1.0) + 0.5).astype(np.uint8))
