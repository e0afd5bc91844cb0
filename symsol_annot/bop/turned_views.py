"""A picture as a camera would see it that was turned about its own centre, to look at an object's centre.

Such a turn moves no point of the picture in front of another one: the new picture follows from the old one by a
homography. A pixel is named by its centre, (0, 0) that of the first one, as in BOP.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import DataError
from symsol_annot.rendering.camera import Camera
from symsol_annot.rotations.so3 import Rotations

_LEAST_RADII = 1.01  # the camera is outside the object's sphere
_SAME_SCALE = 0.05  # a picture is not shrunk by less
_POINTS_AT_ONCE = 2**19
Pixels = npt.NDArray[np.uint8]
Matrix = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class TurnedView:
    """A camera that looks at an object's centre, turned from one that does not.

    Attributes:
        turn: (3, 3) R_c, from the frame of the camera before to that of the turned one.
        to_before: (3, 3) the homography K R_c^T K_new^-1, from its pixels to those of the picture before.
        size: width and height of its picture, in pixels.
    """

    turn: Rotations
    to_before: Matrix
    size: int


def view_of(centre_mm: Matrix, radius_mm: float, K: Matrix, size: int, what: str) -> TurnedView:
    """Return the camera that looks at an object, which fills as much of its picture as in a rendered set.

    Args:
        centre_mm: (3,) of the object, in the frame of the camera before.
        radius_mm: of the sphere around the object.
        K: (3, 3) the matrix of the camera before.
        size: width and height of the new picture, in pixels.
        what: the instance, in a message.

    Raises:
        DataError: the object is behind the camera, or around it.
    """
    distance_mm = float(np.linalg.norm(centre_mm))
    radii = distance_mm / radius_mm
    if not (centre_mm[2] > 0 and radii >= _LEAST_RADII):
        x, y, z = centre_mm
        raise DataError(
            f"{what}: its centre is at ({x:.4g}, {y:.4g}, {z:.4g}) mm from the camera, its radius is "
            f"{radius_mm:.4g} mm: expected it in front of the camera, which is outside it"
        )
    turn = turn_to_axis(centre_mm / distance_mm)
    focal_px, middle = Camera.filling(size, radii).focal_px, size / 2 - 0.5
    K_new = np.array([[focal_px, 0.0, middle], [0.0, focal_px, middle], [0.0, 0.0, 1.0]])
    return TurnedView(turn, K @ turn.T @ np.linalg.inv(K_new), size)


def turn_to_axis(direction: Matrix) -> Rotations:
    """Return the smallest rotation (3, 3) that takes a unit vector (3,), in front of the camera, to its axis z."""
    x, y, z = direction
    cross = np.array([[0.0, 0.0, -x], [0.0, 0.0, -y], [x, y, 0.0]])  # v -> (n x e_z) x v
    return np.asarray(np.eye(3) + cross + cross @ cross / (1.0 + z))


def picture_of(view: TurnedView, before: Pixels) -> Pixels:
    """Return the view's picture (size, size, 3); what the camera before did not see is black.

    Between pixels it is interpolated linearly. Where it is smaller than the picture before, squares of that are
    averaged first, and then points of each pixel.

    Args:
        view: the turned camera.
        before: (H, W, 3) the picture of the camera before.
    """
    shrunk_by = _pixels_per_pixel(view)
    squares = max(1, min(math.floor(shrunk_by), min(before.shape[:2]) // 2))
    points = max(1, min(math.ceil(shrunk_by / squares - _SAME_SCALE), 2))
    to_square = np.array([[1.0, 0.0, 0.5 - squares / 2], [0.0, 1.0, 0.5 - squares / 2], [0.0, 0.0, squares]])
    averaged, H = _averaged(before, squares), to_square @ view.to_before
    rows = max(1, _POINTS_AT_ONCE // (view.size * points**2))
    found = np.empty((view.size, view.size, 3), dtype=np.uint8)
    for first in range(0, view.size, rows):
        part = found[first : first + rows]
        levels = _levels(averaged, *_places(H, first, len(part), view.size, points))
        means = levels.reshape(len(part), points, view.size, points, 3).mean(axis=(1, 3))
        part[...] = np.rint(means).astype(np.uint8)
    return found


def _pixels_per_pixel(view: TurnedView) -> float:
    """Return how many pixels of the picture before lie along one of the view's, in its middle."""
    middle = np.array([view.size / 2 - 0.5, view.size / 2 - 0.5, 1.0])
    u, v, w = view.to_before @ middle
    jacobian = (view.to_before[:2, :2] - np.outer([u / w, v / w], view.to_before[2, :2])) / w
    return float(np.linalg.norm(jacobian, 2))


def _averaged(before: Pixels, squares: int) -> npt.NDArray[np.uint8] | npt.NDArray[np.float32]:
    """Return the means over squares of so many pixels; at the edges the last pixels count on."""
    if squares == 1:
        return before
    rows, columns = (-(-side // squares) for side in before.shape[:2])
    missing = (rows * squares - before.shape[0], columns * squares - before.shape[1])
    whole = np.pad(before, ((0, missing[0]), (0, missing[1]), (0, 0)), mode="edge")
    return np.asarray(whole.reshape(rows, squares, columns, squares, 3).mean(axis=(1, 3), dtype=np.float32))


def _places(H: Matrix, first: int, rows: int, size: int, points: int) -> tuple[Matrix, Matrix]:
    """Return where (rows points, size points) points of some rows lie in the picture before; NaN behind its camera."""
    within = (np.arange(size * points) + 0.5) / points - 0.5
    x, y = np.meshgrid(within, first + within[: rows * points])
    u, v, w = (H[row, 0] * x + H[row, 1] * y + H[row, 2] for row in range(3))
    w[w <= 0] = np.nan
    return u / w, v / w


def _levels(picture: npt.NDArray[np.uint8] | npt.NDArray[np.float32], u: Matrix, v: Matrix) -> Matrix:
    """Return a picture's levels (.., 3) at places (..), interpolated linearly; 0 outside it."""
    height, width = picture.shape[:2]
    is_inside = (np.abs(u - (width - 1) / 2) <= width / 2) & (np.abs(v - (height - 1) / 2) <= height / 2)  # not NaN
    levels = np.zeros((*u.shape, 3))
    u, v = np.clip(u[is_inside], 0, width - 1), np.clip(v[is_inside], 0, height - 1)
    left, top = np.minimum(u.astype(np.intp), width - 2), np.minimum(v.astype(np.intp), height - 2)
    right, down = (u - left)[:, None], (v - top)[:, None]
    above = (1.0 - right) * picture[top, left] + right * picture[top, left + 1]
    below = (1.0 - right) * picture[top + 1, left] + right * picture[top + 1, left + 1]
    levels[is_inside] = (1.0 - down) * above + down * below
    return levels
