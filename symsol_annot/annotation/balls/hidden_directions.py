"""From where nothing shows of the parts that break a ball's symmetry: a region of directions, and so a volume of SO(3).

A picture of a ball depends on the direction v from it to the camera, and on the turn about the line of sight, which
turns the picture. Where the parts show less than T of area from v, in the image that is not yet sampled, they show
nothing, and every rotation that sees the ball from there draws the same: S is the region of these v, times all turns.
The region is known at the 24,384 directions of the equivolumetric grid of level 5.
"""

from functools import lru_cache

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.volume import CELLS, Volume, viewing_directions
from symsol_annot.objects.mesh import Mesh, is_convex
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.renderer import Renderer
from symsol_annot.rotations.so3 import Rotations

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_VALUES = 2**20  # of triangles from directions, held at once


def hidden_volume(mesh: Mesh, camera: Camera, tolerance_px: float | None, renderer: Renderer) -> Volume | None:
    """Return the volume of all rotations that show nothing of a mesh's breaking parts; None where there is none.

    Args:
        mesh: a ball with parts.
        camera: what it is seen through.
        tolerance_px: T, the area in pixels that counts as nothing; None where no part breaks the symmetry.
        renderer: counts what shows of parts that stand out of the ball, about which geometry here says nothing.
    """
    if tolerance_px is None:
        return Volume(np.ones(CELLS, dtype=bool))
    if is_convex(mesh):
        return volume_by_geometry(mesh, camera, tolerance_px)
    directions = viewing_directions()
    area_px = renderer.marking_pixels(rotations_seen_from(directions.reshape(-1, 3)))
    return _volume_of((area_px < tolerance_px).reshape(directions.shape[:2]))


@lru_cache(maxsize=4)
def volume_by_geometry(mesh: Mesh, camera: Camera, tolerance_px: float) -> Volume | None:
    """Return `hidden_volume` of a convex mesh, remembered for a few meshes."""
    directions = viewing_directions()
    area_px = visible_area_px(mesh, camera, directions.reshape(-1, 3))
    return _volume_of((area_px < tolerance_px).reshape(directions.shape[:2]))


def visible_area_px(mesh: Mesh, camera: Camera, directions: Floats) -> Floats:
    """Return the area in pixels that the breaking parts of a convex mesh show from directions (n, 3): (n,).

    A triangle shows where it faces the camera. With corners p_i and the camera at c, its projection has the area
    f^2 det(p_1 - c, p_2 - c, p_3 - c) / (2 z_1 z_2 z_3).
    """
    used, corners = np.unique(mesh.triangles[mesh.is_marking], return_inverse=True)
    corners = corners.reshape(-1, 3)
    vertices = mesh.vertices[used]
    a, b, c = np.moveaxis(vertices[corners], 1, 0)
    normals = np.cross(b - a, c - a)
    offsets = (normals * a).sum(axis=1)
    found, step = np.zeros(len(directions)), max(1, _VALUES // max(len(corners), 1))
    for start in range(0, len(directions), step):
        some = directions[start : start + step]
        facing = np.maximum(camera.distance * some @ normals.T - offsets, 0.0)
        depth = camera.distance - some @ vertices.T
        facing /= depth[:, corners[:, 0]] * depth[:, corners[:, 1]] * depth[:, corners[:, 2]]
        found[start : start + step] = facing.sum(axis=1)
    return np.asarray(found * camera.focal_px**2 / 2.0)


def rotations_seen_from(directions: Floats) -> Rotations:
    """Return rotations (n, 3, 3) that see the object from unit vectors (n, 3), in model coordinates."""
    back = -directions
    least = np.eye(3)[np.abs(back).argmin(axis=1)]
    down = least - (least * back).sum(axis=1, keepdims=True) * back
    down /= np.linalg.norm(down, axis=1, keepdims=True)
    return np.stack([np.cross(down, back), down, back], axis=1)


def _volume_of(hidden: Flags) -> Volume | None:
    """Return the volume of the directions of `viewing_directions` that hide all parts; None where there are none."""
    return Volume.of_directions(lambda _: hidden.reshape(-1)) if hidden.any() else None
