"""The colour of each face, where it has one: from colours of its corners, or from its place in a texture."""

import io
from typing import Any

import numpy as np
import numpy.typing as npt
from PIL import Image

from symsol_annot.objects.mesh_files.mesh_file import MIXED_COLOURS, NO_COLOUR, Indices, Points

Bytes = npt.NDArray[np.uint8]
Colours = npt.NDArray[np.int64]

_SAME_IN_TEXTURE = 16  # of 255 levels: what a JPEG makes of one colour
_MAX_PIXELS = 2**26
_PLACES = np.array(  # of a face, whose texture is looked at: weights of its corners
    [
        *([0.98, 0.01, 0.01], [0.01, 0.98, 0.01], [0.01, 0.01, 0.98]),
        *([0.49, 0.49, 0.02], [0.02, 0.49, 0.49], [0.49, 0.02, 0.49]),
        *([0.6, 0.2, 0.2], [0.2, 0.6, 0.2], [0.2, 0.2, 0.6], [1 / 3, 1 / 3, 1 / 3]),
    ]
)
_AT_ONCE = 2**16


def no_colours(count: int) -> Colours:
    """Return the colours (count,) of faces that have none."""
    return np.full(count, NO_COLOUR, dtype=np.int64)


def packed(rgb: npt.NDArray[Any]) -> Colours:
    """Return colours (..., 3) of 8 bits as one number each."""
    wide = np.asarray(rgb).astype(np.int64)
    return np.asarray(wide[..., 0] << 16 | wide[..., 1] << 8 | wide[..., 2])


def unpacked(colour: int) -> tuple[int, int, int]:
    """Return the red, green and blue of a colour that is one number."""
    return colour >> 16 & 255, colour >> 8 & 255, colour & 255


def to_linear(colour: int) -> tuple[float, float, float]:
    """Return the linear RGB from 0 to 1 of a colour in sRGB that is one number, to 4 digits."""
    red, green, blue = (_linear(byte / 255.0) for byte in unpacked(colour))
    return red, green, blue


def colours_of_corners(rgb: Bytes, triangles: Indices) -> Colours:
    """Return the colours (T,) of faces whose vertices have colours (V, 3): mixed where a face's corners differ."""
    corners = packed(rgb)[triangles]
    is_one = (corners == corners[:, :1]).all(axis=1)
    return np.where(is_one, corners[:, 0], MIXED_COLOURS)


def colours_in_texture(picture: Bytes, corner_uv: Points) -> Colours:
    """Return the colours (T,) of faces in a texture: mixed where places of a face differ.

    Args:
        picture: (H, W, 3), the first row on top.
        corner_uv: (T, 3, 2) where each face's corners are: from left to right, and from the bottom up. A face of which
            one is no number has no colour.
    """
    height, width = picture.shape[:2]
    found = no_colours(len(corner_uv))
    for start in range(0, len(corner_uv), _AT_ONCE):
        uv = np.einsum("pc,tci->tpi", _PLACES, corner_uv[start : start + _AT_ONCE])
        is_there = np.isfinite(uv).all(axis=(1, 2))
        uv = np.where(is_there[:, None, None], uv, 0.0) % 1.0
        column = np.minimum((uv[..., 0] * width).astype(np.intp), width - 1)
        row = np.minimum(((1.0 - uv[..., 1]) * height).astype(np.intp), height - 1)
        seen = picture[row, column].astype(np.int64)
        is_one = (np.ptp(seen, axis=1) <= _SAME_IN_TEXTURE).all(axis=1)
        colours = np.where(is_one, packed(np.median(seen, axis=1).round()), MIXED_COLOURS)
        found[start : start + _AT_ONCE] = np.where(is_there, colours, NO_COLOUR)
    return found


def nearby_joined(colours: Colours, areas: npt.NDArray[np.float64], most: int) -> Colours:
    """Return colours (T,) of which those that a texture's noise told apart are one, that of the larger area.

    More than `most` different ones stay as they are.
    """
    known, place = np.unique(colours, return_inverse=True)
    kept: list[int] = []
    becomes = known.copy()
    for index in np.argsort(-np.bincount(place, areas), kind="stable").tolist():
        rgb = np.array(unpacked(int(known[index])))
        near = next((one for one in kept if np.abs(rgb - unpacked(one)).max() <= _SAME_IN_TEXTURE), None)
        if near is None:
            if len(kept) == most:
                return colours
            kept.append(int(known[index]))
        becomes[index] = kept[-1] if near is None else near
    return becomes[place]


def to_picture(image: Any) -> Bytes:
    """Return Pillow's image as (H, W, 3) bytes.

    Raises:
        ValueError: it is larger than a texture has a reason to be.
    """
    if image.width * image.height > _MAX_PIXELS:
        raise ValueError(f"a texture of {image.width} x {image.height} pixels is larger than what is read")
    return np.asarray(image.convert("RGB"), dtype=np.uint8)


def read_picture(data: bytes) -> Bytes | None:
    """Return the picture (H, W, 3) in a file's bytes; None where they are none, or one that is too large."""
    try:
        with Image.open(io.BytesIO(data)) as image:
            return to_picture(image)
    except (OSError, ValueError, SyntaxError, Image.DecompressionBombError, Image.DecompressionBombWarning):
        return None


def _linear(value: float) -> float:
    return round(value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4, 4)
