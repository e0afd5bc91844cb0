"""PNG files in a zip of unknown origin: their pixels are read, and nothing else of them."""

import struct
import zipfile
import zlib

import numpy as np
import pytest
import symsol_source
from hostile_zips import IMAGE, assert_refused, jpeg, png_header, png_of_size, put, with_chunk
from imported_sets import imported
from symsol_source import png, write_zip

import symsol_annot


def test_an_alpha_channel_is_left_out(tmp_path):
    files, arrays = symsol_source.content(("tet",))
    pixels = arrays["tet", "test", "images"][2]
    files["test/images/tet_00002.png"] = png(np.dstack([pixels, np.full((16, 16), 7, dtype=np.uint8)]))
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert np.array_equal(symsol_annot.load(made["tet"].folder)[2].image, pixels)


EXTRAS = {
    "a profile that unpacks to a gigabyte": (b"iCCP", b"x\0\0" + zlib.compress(bytes(2**24), 9)),
    "a text that unpacks to a gigabyte": (b"zTXt", b"x\0\0" + zlib.compress(bytes(2**24), 9)),
    "an animation": (b"acTL", struct.pack(">II", 2**31 - 1, 0)),
    "a colour that is none": (b"tRNS", struct.pack(">HHH", 1, 2, 3)),
    "a chunk of nonsense": (b"eXIf", b"nonsense"),
}


@pytest.mark.parametrize(("kind", "content"), EXTRAS.values(), ids=EXTRAS)
def test_what_else_a_png_holds_changes_no_pixel(tmp_path, kind, content):
    files, arrays = symsol_source.content(("tet",))
    files[IMAGE] = with_chunk(files[IMAGE], kind, content)
    made = imported(write_zip(tmp_path / "s.zip", files, zipfile.ZIP_STORED), tmp_path / "sets")
    assert np.array_equal(symsol_annot.load(made["tet"].folder)[4].image, arrays["tet", "test", "images"][4])


def test_an_interlaced_png_is_read_as_it_is(tmp_path):
    """Adam7 of 16 x 16 pixels of one colour: seven pictures of it, each row behind a filter's byte."""
    rows = [(-(-(16 - y) // dy), -(-(16 - x) // dx)) for x, y, dx, dy in ADAM7]
    data = b"".join((b"\0" + b"\x01\x02\x03" * width) * height for height, width in rows)
    files, _ = symsol_source.content(("tet",))
    head = struct.pack(">IIBBBBB", 16, 16, 8, 2, 0, 0, 1)
    plain = b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        for kind, content in ((b"IHDR", head), (b"IDAT", zlib.compress(data)), (b"IEND", b""))
    )
    files[IMAGE] = plain
    made = imported(write_zip(tmp_path / "s.zip", files), tmp_path / "sets")
    assert (symsol_annot.load(made["tet"].folder)[4].image == (1, 2, 3)).all()


ADAM7 = [(0, 0, 8, 8), (4, 0, 8, 8), (0, 4, 4, 8), (2, 0, 4, 4), (0, 2, 2, 4), (1, 0, 2, 2), (0, 1, 1, 2)]
HOSTILE = {
    "half a PNG": (put(IMAGE, lambda data: data[: len(data) // 2]), "tet_00004.png: image file is truncated"),
    "no PNG": (put(IMAGE, jpeg), "tet_00004.png: is no PNG"),
    "nothing": (put(IMAGE, b""), "tet_00004.png: is no PNG"),
    "grey": (put(IMAGE, png(np.zeros((16, 16), np.uint8))), "PNG of mode L, expected 8-bit RGB"),
    "grey of 16 bits": (put(IMAGE, png(np.zeros((16, 16), np.uint16))), "PNG of mode I;16"),
    "a giant": (put(IMAGE, png_of_size(2**30, 2**30)), "1073741824 x 1073741824 pixels, expected 16 to 2048"),
    "a PNG with two headers": (
        put(IMAGE, lambda data: with_chunk(data, b"IHDR", png_header(2**14, 2**14))),
        "two hea",
    ),
    "a PNG without an end": (put(IMAGE, lambda data: data[:-12]), "image file is truncated"),
    "a PNG with a chunk of 4 GB": (
        put(IMAGE, lambda data: data[:33] + b"\xff\xff\xff\xffIDAT" + data[41:]),
        "image file is truncated",
    ),
}


@pytest.mark.parametrize(("damage", "message"), HOSTILE.values(), ids=HOSTILE)
def test_a_damaged_or_hostile_zip_is_one_error_and_leaves_nothing(tmp_path, damage, message):
    assert_refused(tmp_path, damage, message)
