"""The scene as plain data: camera, looks, what one rendered view is, and what a renderer does.

World axes are the camera's, OpenCV's way: x right, y down, z forward. The object is at the origin, the
camera at (0, 0, -distance) looks along +z, and the light shines along the camera's axis.
"""

from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass, fields
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import SettingsError
from symsol_annot.rotations.so3 import Rotations

BACKGROUND, BODY, MARKING = 0, 1, 2  # segmentation ids
ENGINES = ("workbench", "cycles", "eevee")
DEFAULT_SIZE = 224
SIZE_RANGE = (16, 2048)
SAMPLES_PER_AXIS = (2, 4, 6, 8)  # even, and sums of their squares fit 16 bits
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
    def filling(cls, size: int) -> "Camera":
        """Return the default camera for square images: the bounding sphere fills 90% of the width.

        A unit sphere at distance d projects to a disc of radius focal_px / sqrt(d^2 - 1).

        Raises:
            SettingsError: the size is out of range.
        """
        low, high = SIZE_RANGE
        if not low <= size <= high:
            raise SettingsError(f"image size: expected {low} to {high} pixels, found {size}")
        focal_px = 0.5 * _FILLED_WIDTH * size * float(np.sqrt(_DISTANCE**2 - 1.0))
        return cls(_DISTANCE, focal_px, size, size)

    def lattice(self, samples_per_axis: int) -> "Camera":
        """Return the camera whose pixels are this one's samples: on pixel corners, edges and inside, 1/n pixel apart.

        It has n W + 1 by n H + 1 of them; with n even, one lies at each pixel's centre.
        """
        n = samples_per_axis
        return Camera(self.distance, n * self.focal_px, n * self.width + 1, n * self.height + 1)

    def project(self, points: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
        """Return the pixel coordinates (..., 2) of world points (..., 3); pixel centres are at half-integers."""
        depth = points[..., 2] + self.distance
        centre = np.array([self.width / 2, self.height / 2])
        return self.focal_px * points[..., :2] / depth[..., None] + centre

    def to_dict(self) -> dict[str, Any]:
        """Return the camera as JSON data."""
        return asdict(self)


@dataclass(frozen=True)
class RenderSettings:
    """How views are drawn.

    Samples lie 1 / `samples_per_axis` pixel apart, as `Camera.lattice` has them. A pixel's RGB is the average over its
    square by the trapezoidal rule in display values, and its segmentation the sample at its centre; the marking's area
    is counted on the same samples. The light is a headlight: a surface with normal n shows
    colour x (ambient + diffuse x max(0, -n_z)), linear, then sRGB. The colours are linear RGB.
    """

    engine: str = "workbench"
    samples_per_axis: int = 2
    body_colour: tuple[float, float, float] = (0.72, 0.80, 0.94)
    marking_colour: tuple[float, float, float] = (0.95, 0.16, 0.04)
    background_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    ambient: float = 0.04
    diffuse: float = 0.96

    def __post_init__(self) -> None:
        """Refuse an engine that does not exist, a lattice without a sample at a pixel's centre, and odd colours."""
        if type(self.engine) is not str or self.engine not in ENGINES:
            raise SettingsError(f"engine: expected one of {', '.join(ENGINES)}, found {self.engine!r}")
        if type(self.samples_per_axis) is not int or self.samples_per_axis not in SAMPLES_PER_AXIS:
            raise SettingsError(f"samples_per_axis: expected 2, 4, 6 or 8, found {self.samples_per_axis!r}")
        for name in ("body_colour", "marking_colour", "background_colour"):
            colour = getattr(self, name)
            if not isinstance(colour, tuple) or len(colour) != 3 or not all(_is_light(part) for part in colour):
                raise SettingsError(f"{name}: expected three numbers from 0 to 1, found {colour!r}")
        for name in ("ambient", "diffuse"):
            if not _is_light(getattr(self, name)):
                raise SettingsError(f"{name}: expected a number from 0 to 1, found {getattr(self, name)!r}")

    @property
    def samples_per_pixel(self) -> int:
        """How many samples of the lattice lie in one pixel."""
        return self.samples_per_axis**2

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "RenderSettings":
        """Return the settings that `to_dict` gave.

        Raises:
            SettingsError: a setting has a value that makes no sense.
            TypeError: they are no table of all the settings.
        """
        if type(data) is not dict or set(data) != {field.name for field in fields(cls)}:
            raise TypeError(f"expected a table of the render settings, found {type(data).__name__}")
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data.items()}
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data."""
        return {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}


def _is_light(value: Any) -> bool:
    return type(value) in (float, int) and 0 <= value <= 1


@dataclass(frozen=True, eq=False)
class View:
    """One view of an object.

    Attributes:
        rgb: (H, W, 3) u8, anti-aliased.
        segmentation: (H, W) u8, the id (0 background, 1 body, 2 marking) at each pixel's centre.
        marking_pixels: the marking's visible area: its samples, over the samples a pixel.
    """

    rgb: npt.NDArray[np.uint8]
    segmentation: npt.NDArray[np.uint8]
    marking_pixels: float


class Renderer(AbstractContextManager["Renderer"], Protocol):
    """Draws one object through one camera; a context manager, since it may hold a process."""

    @property
    def versions(self) -> dict[str, str]:
        """The software that decides the pixels: name to version."""

    def render(self, R_m2c: Rotations) -> View:
        """Draw the object under one rotation (3, 3)."""

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return the `marking_pixels` of the view under each of (n, 3, 3) rotations, without its pictures: (n,)."""

    def close(self) -> None:
        """Let go of what the renderer holds."""
