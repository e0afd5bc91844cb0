"""The colours that a view is drawn in: light at the mesh's corners, sRGB, and what was hit by its colour."""

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RenderError, SettingsError
from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import BACKGROUND, BODY, MARKING
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations

Bytes = npt.NDArray[np.uint8]

_NO_ID = 255
_SHADES = 4096  # more than 8 bits can tell apart
_ROUNDING = 1  # levels, by float32
_THIN = 0.25  # lattice spacings; in a thicker triangle a point is at most a fortieth of its height off (2048 pixels)
_BEYOND = 0.025  # light by which such a point may be darker or brighter than the corners


class CornerLight:
    """The colours that the camera's light gives the corners of a mesh; an engine interpolates them.

    A rasteriser takes a triangle's colour at points that lie a little beside it, where its moved corners reach. On a
    triangle that is thinner than that, seen edge-on, such a colour could be any; so thin triangles have a single one.
    """

    def __init__(self, mesh: Mesh, lattice: Camera, settings: RenderSettings) -> None:
        self._mesh, self._lattice, self._settings = mesh, lattice, settings
        self._colours = np.where(mesh.is_marking[:, None], settings.marking_colour, settings.body_colour)[:, None]

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


class ColourIds:
    """Tells from an unmixed colour what was hit: the background, or a material in one of its shades.

    Attributes:
        background: (3,) u8, the background's colour in sRGB.

    Raises:
        SettingsError: two materials have a colour in common.
    """

    def __init__(self, settings: RenderSettings) -> None:
        self._id_of = np.full(1 << 24, _NO_ID, np.uint8)
        light = settings.ambient + settings.diffuse * np.linspace(-_BEYOND, 1.0 + _BEYOND, _SHADES)[:, None]
        self.background = srgb_bytes(np.array(settings.background_colour))
        colours = {BACKGROUND: self.background[None]}
        colours |= {
            BODY: srgb_bytes(light * settings.body_colour),
            MARKING: srgb_bytes(light * settings.marking_colour),
        }
        steps = np.arange(-_ROUNDING, _ROUNDING + 1)
        around = np.stack(np.meshgrid(steps, steps, steps), axis=-1).reshape(-1, 1, 3)
        for number, shades in colours.items():
            known = np.unique(shades, axis=0).astype(int) + (0 if number == BACKGROUND else around)
            keys = _packed(np.clip(known, 0, 255).astype(np.uint8))
            if np.any((self._id_of[keys] != _NO_ID) & (self._id_of[keys] != number)):
                raise SettingsError("render colours: background, body and marking must differ in every shade")
            self._id_of[keys] = number

    def of(self, colours: Bytes) -> Bytes:
        """Return the ids (h, w) of unmixed colours (h, w, 3) in sRGB.

        Raises:
            RenderError: a colour is among them that nothing can show.
        """
        ids: Bytes = self._id_of[_packed(colours)]
        if ids.max(initial=0) == _NO_ID:
            stray = np.unique(colours[ids == _NO_ID], axis=0)
            raise RenderError(
                f"Blender drew colours that are neither background, body nor marking: {stray[:8].tolist()}; "
                "the frame has no segmentation. Finished shards are kept. Please report this, with the command you gave"
            )
        return ids


def srgb(linear: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Return linear colours in [0, 1] as sRGB in [0, 1] (IEC 61966-2-1)."""
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055)


def srgb_bytes(linear: npt.NDArray[np.float64]) -> Bytes:
    """Return linear colours, clipped to [0, 1], as sRGB in 8 bits."""
    return np.asarray(np.floor(255.0 * np.clip(srgb(linear), 0.0, 1.0) + 0.5).astype(np.uint8))


def _packed(colours: Bytes) -> npt.NDArray[np.uint32]:
    """Return each colour (..., 3) as one number, 0xRRGGBB."""
    red, green, blue = (colours[..., channel].astype(np.uint32) for channel in range(3))
    return np.asarray(red << 16 | green << 8 | blue, dtype=np.uint32)
