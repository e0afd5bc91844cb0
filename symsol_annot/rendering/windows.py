"""Rectangles of a picture, or of the lattice of points that it is drawn at."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt


@dataclass(frozen=True)
class Window:
    """A rectangle of pixels, or of lattice points; top and left are counted from the upper left corner."""

    left: int
    top: int
    width: int
    height: int

    @classmethod
    def around(cls, points: npt.NDArray[np.float64], width: int, height: int, step: int = 1) -> "Window":
        """Return the window that holds points (k, 2), with one pixel around them, within a picture of a size.

        Args:
            points: (u, v) in pixels, k of them, at least one.
            width: of the picture.
            height: of the picture.
            step: the window's sides are multiples of it, where the picture is not smaller.
        """
        low, high = np.floor(points.min(axis=0)) - 1, np.ceil(points.max(axis=0)) + 1
        size = np.array([width, height])
        sides = np.minimum(np.ceil((high - low) / step) * step, size)
        left, top = np.clip(low, 0, size - sides).astype(int).tolist()
        return cls(left, top, *sides.astype(int).tolist())

    @classmethod
    def around_each(cls, points: npt.NDArray[np.float64], width: int, height: int) -> "list[Window]":
        """Return n windows, each of which holds the points (n, k, 2) of one row, as `around` does, cut at the edges."""
        size = np.array([width, height])
        low = np.clip(np.floor(points.min(axis=1)) - 1, 0, size)
        sides = np.clip(np.ceil(points.max(axis=1)) + 1, 0, size) - low
        return [cls(*window) for window in np.concatenate([low, sides], axis=1).astype(int).tolist()]

    @property
    def area(self) -> int:
        """How many pixels it has."""
        return self.width * self.height

    @property
    def corners(self) -> npt.NDArray[np.float64]:
        """Its upper left and lower right corner (2, 2), as (u, v)."""
        left, top = self.left, self.top
        return np.array([[left, top], [left + self.width, top + self.height]], dtype=np.float64)

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns in the whole picture."""
        return slice(self.top, self.top + self.height), slice(self.left, self.left + self.width)

    def lattice(self, n: int) -> "Window":
        """Return the window of lattice points that lie in this window of pixels, on its edges too, n per pixel."""
        return Window(n * self.left, n * self.top, n * self.width + 1, n * self.height + 1)

    def within(self, other: "Window") -> "Window | None":
        """Return what both windows hold; None where that is nothing."""
        left, top = max(self.left, other.left), max(self.top, other.top)
        right = min(self.left + self.width, other.left + other.width)
        bottom = min(self.top + self.height, other.top + other.height)
        return Window(left, top, right - left, bottom - top) if left < right and top < bottom else None

    def seen_from(self, other: "Window") -> "Window":
        """Return this window as it lies in the picture that another window cuts out."""
        return Window(self.left - other.left, self.top - other.top, self.width, self.height)
