"""The camera, and the lattice of points at which an image is drawn.

World axes are the camera's, OpenCV's way: x right, y down, z forward. The object is at the origin, the
camera at (0, 0, -distance) looks along +z, and the light shines along the camera's axis.
"""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import SettingsError

DEFAULT_SIZE = 224  # pixels
SIZE_RANGE = (16, 2048)
_DISTANCE = 4.0
_FILLED_WIDTH = 0.9  # of the image's width, by the unit bounding sphere


@dataclass(frozen=True)
class Camera:
    """A pinhole camera; its principal point is the image's centre and its pixels are square.

    Attributes:
        distance: from the camera to the object's centre, in bounding-sphere radii.
        focal_px: the focal length in pixels.
        width: of the image in pixels.
        height: of the image in pixels.
    """

    distance: float
    focal_px: float
    width: int
    height: int

    @classmethod
    def filling(cls, size: int, distance: float = _DISTANCE) -> "Camera":
        """Return the default camera for square images: the bounding sphere fills 90% of the width.

        A unit sphere at distance d > 1 projects to a disc of radius focal_px / sqrt(d^2 - 1).

        Raises:
            SettingsError: the size is out of range.
        """
        low, high = SIZE_RANGE
        if not low <= size <= high:
            raise SettingsError(f"image size: expected {low} to {high} pixels, found {size}")
        focal_px = 0.5 * _FILLED_WIDTH * size * float(np.sqrt(distance**2 - 1.0))
        return cls(distance, focal_px, size, size)

    def lattice(self, n: int) -> "Camera":
        """Return the camera whose pixels are the points of this one's lattice, which lie 1 / n pixel apart.

        They lie on pixel corners, on edges and inside: n W + 1 by n H + 1 of them; with n even, one at each pixel's
        centre.
        """
        return Camera(self.distance, n * self.focal_px, n * self.width + 1, n * self.height + 1)

    def project(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the pixel coordinates (..., 2) of world points (..., 3); pixel centres are at half-integers."""
        depth = points[..., 2] + self.distance
        centre = np.array([self.width / 2, self.height / 2])
        return self.focal_px * points[..., :2] / depth[..., None] + centre

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as JSON data."""
        return asdict(self)
