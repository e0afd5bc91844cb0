"""Pictures of unknown origin, decoded: within limits on their size, and by nothing but their pixels."""

import io
import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from symsol_annot.rendering.camera import SIZE_RANGE
from symsol_annot.system.png import PNG_SIGNATURE

PHOTO_SIDES = (16, 8192)  # pixels each way that a photograph may have
MAX_PHOTO_PIXELS = 2**25
MAX_PHOTO_BYTES = 2**27  # of its file: 8-bit RGBA of as many pixels, hardly compressed
_PNG_KEPT = (b"IHDR", b"PLTE", b"IDAT", b"IEND")  # what decides the pixels; of the rest nothing reaches the decoder
_PNG_START = PNG_SIGNATURE + b"\0\0\0\rIHDR"
PNG_HEADER_BYTES = len(_PNG_START) + 17  # with the header's 13 bytes and their checksum
_PNG_SLACK = 2**16  # what a PNG may have beyond its pixels
_MODES, _PHOTO_MODES = ("RGB", "RGBA"), ("RGB", "RGBA", "L")
_JPEG_START = b"\xff\xd8\xff"


def decoded_png(data: bytes) -> npt.NDArray[np.uint8]:
    """Return the pixels (H, W, 3) of a PNG as RGB; an alpha channel is left out.

    Raises:
        ValueError: it is no 8-bit RGB or RGBA, or is cut short. What Pillow raises on a damaged one passes.
    """
    return _decoded(_plain_png(data), "PNG", _MODES)


def decoded_photo(data: bytes) -> npt.NDArray[np.uint8]:
    """Return the pixels (H, W, 3) of a PNG or JPEG as RGB; an alpha channel and a note on how to turn it are left out.

    Raises:
        ValueError: it is no 8-bit RGB, RGBA or grey one, of no size that is read, or cut short. What Pillow raises on
            a damaged one passes.
    """
    if data.startswith(PNG_SIGNATURE):
        return _decoded(_plain_png(data), "PNG", _PHOTO_MODES)
    if data.startswith(_JPEG_START):
        return _decoded(data, "JPEG", _PHOTO_MODES)
    raise ValueError("is neither PNG nor JPEG")


def most_bytes(start: bytes) -> int:
    """Return how many bytes a PNG may have, given its first `PNG_HEADER_BYTES`: little beyond its pixels.

    Raises:
        ValueError: it is no PNG, or of a size in pixels that no set has.
    """
    if not start.startswith(_PNG_START) or len(start) < PNG_HEADER_BYTES:
        raise ValueError("is no PNG")
    width, height = struct.unpack_from(">II", start, len(_PNG_START))
    _refuse_sides(width, height, SIZE_RANGE)
    return _bytes_of(width, height)


def _decoded(data: bytes, kind: str, modes: Sequence[str]) -> npt.NDArray[np.uint8]:
    from PIL.JpegImagePlugin import JpegImageFile  # noqa: PLC0415 - slow to import
    from PIL.PngImagePlugin import PngImageFile  # noqa: PLC0415

    kinds = {"PNG": PngImageFile, "JPEG": JpegImageFile}  # Image.open has limits of its own, and warns
    with kinds[kind](io.BytesIO(data)) as picture:  # which reads no pixel yet
        _refuse_size(data, *picture.size)
        if picture.mode not in modes:
            raise ValueError(f"is a {kind} of mode {picture.mode}, expected 8-bit {' or '.join(modes)}")
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


def _refuse_sides(width: int, height: int, sides: tuple[int, int]) -> None:
    low, high = sides
    if not (low <= width <= high and low <= height <= high):
        raise ValueError(f"is {width} x {height} pixels, expected {low} to {high} each way")


def _refuse_size(data: bytes, width: int, height: int) -> None:
    _refuse_sides(width, height, PHOTO_SIDES)
    if width * height > MAX_PHOTO_PIXELS:
        raise ValueError(f"is {width} x {height} pixels, expected at most {MAX_PHOTO_PIXELS:,} in all")
    if len(data) > _bytes_of(width, height):
        raise ValueError(f"is of {len(data):,} bytes, more than {width} x {height} pixels have a use for")


def _bytes_of(width: int, height: int) -> int:
    return width * height * len(_MODES[-1]) + _PNG_SLACK
