"""PNG files of unknown origin, decoded: of a size that a set may have, and by nothing but their pixels."""

import io
import struct

import numpy as np
import numpy.typing as npt

from symsol_annot.rendering.camera import SIZE_RANGE
from symsol_annot.system.png import PNG_SIGNATURE

_PNG_KEPT = (b"IHDR", b"PLTE", b"IDAT", b"IEND")  # what decides the pixels; of the rest nothing reaches the decoder
_PNG_START = PNG_SIGNATURE + b"\0\0\0\rIHDR"
PNG_HEADER_BYTES = len(_PNG_START) + 17  # with the header's 13 bytes and their checksum
_PNG_SLACK = 2**16  # what a PNG may have beyond its pixels
_MODES = ("RGB", "RGBA")


def _png_size(data: bytes) -> tuple[int, int]:
    """Return width and height of a PNG, within those that a set may have, before any memory is taken for them."""
    if not data.startswith(_PNG_START) or len(data) < PNG_HEADER_BYTES:
        raise ValueError("is no PNG")
    width, height = struct.unpack_from(">II", data, len(_PNG_START))
    low, high = SIZE_RANGE
    if not (low <= width <= high and low <= height <= high):
        raise ValueError(f"is {width} x {height} pixels, expected {low} to {high} each way")
    return width, height


def decoded_png(data: bytes) -> npt.NDArray[np.uint8]:
    """Return the pixels (H, W, 3) of a PNG as RGB; an alpha channel is left out.

    Raises:
        ValueError: it is no 8-bit RGB or RGBA, or is cut short. What Pillow raises on a damaged one passes.
    """
    from PIL import Image  # noqa: PLC0415 - slow to import

    with Image.open(io.BytesIO(_plain_png(data)), formats=["PNG"]) as picture:
        if picture.mode not in _MODES:
            raise ValueError(f"is a PNG of mode {picture.mode}, expected 8-bit {' or '.join(_MODES)}")
        return np.asarray(picture.convert("RGB"))


def _plain_png(data: bytes) -> bytes:
    """Return a PNG with the parts alone that decide its pixels: no second header, text, profile or animation."""
    kept, place, kind = [PNG_SIGNATURE], len(PNG_SIGNATURE), b""
    while kind != b"IEND":
        length, kind = struct.unpack_from(">I4s", data, place) if place + 8 <= len(data) else (len(data), b"")
        end = place + 12 + length  # behind length, kind and checksum
        if end > len(data):
            raise ValueError("image file is truncated")
        if kind == b"IHDR" and len(kept) > 1:
            raise ValueError("is a PNG with two headers")
        if kind in _PNG_KEPT:
            kept.append(data[place:end])
        place = end
    return b"".join(kept)


def most_bytes(start: bytes) -> int:
    """Return how many bytes a PNG may have, given its first `PNG_HEADER_BYTES`: little beyond its pixels.

    Raises:
        ValueError: it is no PNG, or of a size in pixels that no set has.
    """
    width, height = _png_size(start)
    return width * height * len(_MODES[-1]) + _PNG_SLACK
