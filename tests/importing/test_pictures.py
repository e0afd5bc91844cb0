"""Photographs of unknown origin: PNG and JPEG, colour and grey, of sizes that no memory is short of."""

import io

import numpy as np
import pytest
from PIL import Image

from symsol_annot.importing.pictures import decoded_photo

PIXELS = np.random.default_rng(0).integers(0, 256, (20, 30, 4), dtype=np.uint8)
TURN_IT = Image.Exif()
TURN_IT[0x0112] = 6  # a quarter turn


def encoded(pixels, kind="PNG", **options):
    data = io.BytesIO()
    Image.fromarray(pixels).save(data, kind, **options)
    return data.getvalue()


def test_colour_grey_and_alpha_become_rgb():
    assert np.array_equal(decoded_photo(encoded(PIXELS)), PIXELS[..., :3])
    assert np.array_equal(decoded_photo(encoded(PIXELS[..., :3])), PIXELS[..., :3])
    assert np.array_equal(decoded_photo(encoded(PIXELS[..., 0])), np.stack(3 * [PIXELS[..., 0]], axis=-1))


def test_a_jpeg_is_read_as_it_lies_whatever_a_note_says_of_turning_it():
    smooth = np.repeat(np.arange(0, 240, 8, dtype=np.uint8)[None], 20, axis=0)
    found = decoded_photo(encoded(smooth, "JPEG", quality=95, exif=TURN_IT))
    assert found.shape == (20, 30, 3)
    assert np.abs(found[..., 0].astype(int) - smooth).max() < 6


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "is neither PNG nor JPEG"),
        (encoded(np.zeros((20, 20), np.uint16)), "is a PNG of mode I;16, expected 8-bit RGB or RGBA or L"),
        (encoded(PIXELS, "TIFF"), "is neither PNG nor JPEG"),
        (encoded(PIXELS[:8]), "is 30 x 8 pixels, expected 16 to 8192 each way"),
        (encoded(np.zeros((8000, 8000), np.uint8)), "is 8000 x 8000 pixels, expected at most 33,554,432 in all"),
        (encoded(PIXELS[..., :3], "JPEG") + bytes(2**17), "is of .* bytes, more than 30 x 20 pixels have a use for"),
        (Image.new("CMYK", (20, 20)).tobytes("jpeg", "CMYK"), "is a JPEG of mode CMYK"),
    ],
    ids=["nothing", "16 bits", "TIFF", "flat", "many pixels", "many bytes", "CMYK"],
)
def test_other_pictures_are_refused(data, message):
    with pytest.raises(ValueError, match=message):
        decoded_photo(data)
