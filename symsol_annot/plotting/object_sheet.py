"""A picture of an object from all sides: views by the ordinary renderer, each over its segmentation."""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.plotting.contact_sheet import ID_COLOURS
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.render_process import RenderProcess
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations
from symsol_annot.system.png import to_png

SHEET_SIZE = 192  # pixels of a view
_GAP = 6


def object_sheet(spec: ObjectSpec) -> bytes:
    """Return a PNG of 8 views of an object, each with its segmentation below it.

    Raises:
        RendererMissingError: bpy is not installed.
        RenderError: Blender cannot draw.
    """
    with RenderProcess(spec, Camera.filling(SHEET_SIZE), RenderSettings()) as renderer:
        views = [renderer.render(R) for R in sheet_rotations()]
    tiles = [np.concatenate([view.rgb, ID_COLOURS[view.segmentation]]) for view in views]
    half = len(tiles) // 2
    return to_png(_stacked([_beside(tiles[:half]), _beside(tiles[half:])]))


def sheet_rotations() -> Rotations:
    """Return the (8, 3, 3) rotations of the views: the corners of a cube towards the camera, z upwards in the image."""
    corners = np.array(
        [[x, y, z] for z in (1.0, -1.0) for x, y in ((1.0, 0.4), (-0.4, 1.0), (-1.0, -0.4), (0.4, -1.0))]
    )
    back = -corners / np.linalg.norm(
        corners, axis=1, keepdims=True
    )  # from the object away from the camera, model frame
    down = np.array([0.0, 0.0, -1.0]) + back * back[:, 2:]
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    return np.stack([np.cross(down, back), down, back], axis=1)


def _beside(tiles: list[npt.NDArray[np.uint8]]) -> npt.NDArray[np.uint8]:
    gap = np.full((tiles[0].shape[0], _GAP, 3), 255, dtype=np.uint8)
    return np.concatenate([part for tile in tiles for part in (tile, gap)][:-1], axis=1)


def _stacked(rows: list[npt.NDArray[np.uint8]]) -> npt.NDArray[np.uint8]:
    gap = np.full((_GAP, rows[0].shape[1], 3), 255, dtype=np.uint8)
    return np.concatenate([part for row in rows for part in (row, gap)][:-1], axis=0)
