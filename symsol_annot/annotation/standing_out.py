"""Where something of a part certainly shows that stands out of the body: beside the silhouette of all else.

A triangle of a breaking part that faces the camera is drawn where nothing is nearer. Beside the silhouette of the parts
that break nothing there is nothing but breaking parts. So if a front triangle holds a lattice point there, however a
rasteriser moves its vertices, then a breaking part is drawn. docs/annotation.md derives the margins.
"""

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.visibility import vertex_shift
from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations

Floats = npt.NDArray[np.float64]
Flags = npt.NDArray[np.bool_]

_TRIANGLES = 64  # of the breaking parts that are looked at, those that stand out farthest among them
_ROTATIONS = 64  # at a time
_ANGLES = 2.0 * np.pi * np.arange(32) / 32
_WAYS = np.array([np.cos(_ANGLES), np.sin(_ANGLES)])  # (2, 32) in the picture, in which a triangle may lie beside it


class StandingOut:
    """Tells by geometry under which rotations a breaking part certainly shows.

    Args:
        mesh: of a body of any shape.
        camera: what it is seen through.
        settings: the lattice, and the engine that draws it.
    """

    def __init__(self, mesh: Mesh, camera: Camera, settings: RenderSettings) -> None:
        from scipy.spatial import ConvexHull  # noqa: PLC0415 - scipy is slow to load, and few objects need this

        self._lattice, self._per_pixel = camera.lattice(settings.samples_per_axis), settings.points_per_pixel
        shift = np.sqrt(2.0) * vertex_shift(camera, settings)
        self._gap, self._radius = 2.0 * shift, np.sqrt(0.5) + shift
        hull = ConvexHull(mesh.vertices[np.unique(mesh.triangles[~mesh.is_marking])])
        self._hull = hull.points[hull.vertices]
        corners = mesh.vertices[mesh.triangles[mesh.is_marking]]
        heights = corners.mean(axis=1) @ hull.equations[:, :3].T + hull.equations[:, 3]
        order = np.argsort(-heights.max(axis=1), kind="stable")[: np.count_nonzero(heights.max(axis=1) > 0)]
        chosen = order[np.unique(np.linspace(0, len(order) - 1, _TRIANGLES).astype(int))] if len(order) else order
        self._corners = corners[chosen]

    @property
    def is_of_use(self) -> bool:
        """Whether anything stands out of the convex hull of the parts that break nothing."""
        return len(self._corners) > 0

    def areas(self, R_m2c: Rotations, tolerance_px: float) -> Floats:
        """Return that of one point (n,) in pixels where a part certainly shows, and NaN where geometry does not decide.

        NaN also where one point is less than the tolerance.
        """
        areas = np.full(len(R_m2c), np.nan)
        if self.is_of_use and tolerance_px <= 1.0 / self._per_pixel:
            for start in range(0, len(R_m2c), _ROTATIONS):
                some = slice(start, start + _ROTATIONS)
                areas[some][self._shows(R_m2c[some])] = 1.0 / self._per_pixel
        return areas

    def _shows(self, R_m2c: Rotations) -> Flags:
        """Tell under which rotations (n, 3, 3) one of the triangles shows for sure."""
        hull = self._lattice.project(self._hull @ np.swapaxes(R_m2c, 1, 2))  # (n, h, 2)
        flat = self._corners.reshape(-1, 3) @ np.swapaxes(R_m2c, 1, 2)
        corners = self._lattice.project(flat).reshape(len(R_m2c), -1, 3, 2)
        farthest = (hull @ _WAYS).max(axis=1)  # (n, ways)
        nearest = (corners @ _WAYS).min(axis=2)  # (n, t, ways)
        is_large = _inradii(corners) >= self._radius
        is_beside = (nearest > farthest[:, None] + self._gap).any(axis=2)
        return np.asarray((is_large & is_beside).any(axis=1))


def _inradii(corners: Floats) -> Floats:
    """Return the radii (...) of the circles in projected triangles (..., 3, 2), negative of those seen from behind."""
    sides = np.roll(corners, -1, axis=-2) - corners
    doubled = sides[..., 0, 1] * sides[..., 1, 0] - sides[..., 0, 0] * sides[..., 1, 1]  # v runs downwards
    return np.asarray(doubled / np.linalg.norm(sides, axis=-1).sum(axis=-1))
