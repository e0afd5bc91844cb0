"""Where a mesh's vertices fall on the camera's lattice, rounded as every rasteriser would round them.

OpenGL leaves a rasteriser free in how finely it rounds a projected vertex. Here it is rounded before it gets one, to
1/256 of a lattice spacing, which any rasteriser of today keeps. So which points a triangle holds is integer arithmetic,
the same in every window and on every machine.
"""

import numpy as np
import numpy.typing as npt

from symsol_annot.rendering.camera import Camera
from symsol_annot.rotations.so3 import Rotations

SUBPIXELS = 256  # per lattice spacing
Floats = npt.NDArray[np.float64]


def projected(vertices: Floats, R_m2c: Rotations, lattice: Camera) -> tuple[Floats, Floats]:
    """Return vertices on the lattice, and their depths.

    Args:
        vertices: (V, 3) in model coordinates.
        R_m2c: (..., 3, 3).
        lattice: the camera whose pixels are the lattice's points.

    Returns:
        (..., V, 2) in lattice spacings, multiples of 1/256, the points at half-integers; (..., V) depths z along the
        camera's axis, in bounding-sphere radii.
    """
    world = vertices @ np.swapaxes(R_m2c, -1, -2)
    rounded = np.floor(SUBPIXELS * lattice.project(world) + 0.5) / SUBPIXELS
    return rounded, world[..., 2] + lattice.distance


def doubled_areas(points: Floats, triangles: npt.NDArray[np.intp]) -> Floats:
    """Return twice the area (..., T) of projected triangles (T, 3) of points (..., V, 2), negative seen from outside.

    With v downwards, a triangle that is counter-clockwise seen from outside has a negative area. At 1/256 of a spacing
    it is exact; a triangle is drawn where it is negative.
    """
    a, b, c = (points[..., triangles[:, corner], :] for corner in range(3))
    f, g = b - a, c - a
    return np.asarray(f[..., 0] * g[..., 1] - f[..., 1] * g[..., 0])
