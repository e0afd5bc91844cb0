"""PNG files: every value is kept, and their bytes depend on the pixels alone."""

import io

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from PIL import Image

from symsol_annot.sets.shard import chunks
from symsol_annot.system.png import to_png

RGB = (np.arange(8 * 6 * 3) * 7 % 256).astype(np.uint8).reshape(8, 6, 3)
IDS = (np.arange(8 * 6) % 3).astype(np.uint8).reshape(8, 6)
DEEP = (np.arange(8 * 6) * 1361 % 65536).astype(np.uint16).reshape(8, 6)
PALETTE = np.array([[255, 255, 255], [10, 20, 30], [200, 100, 0]], dtype=np.uint8)


@pytest.mark.parametrize("pixels", [RGB, IDS, DEEP], ids=["rgb", "grey", "16 bits"])
def test_every_value_is_kept(pixels):
    with Image.open(io.BytesIO(to_png(pixels))) as picture:
        np.testing.assert_array_equal(np.asarray(picture), pixels)


@settings(deadline=None, max_examples=40)
@given(st.one_of(*(arrays(np.uint8, st.tuples(*[st.integers(1, 9)] * 2, *rest)) for rest in ((), (st.just(3),)))))
def test_a_png_holds_every_value(pixels):
    with Image.open(io.BytesIO(to_png(pixels))) as image:
        image.load()
        assert image.mode == ("RGB" if pixels.ndim == 3 else "L")
        assert np.array_equal(np.asarray(image), pixels)


def test_indices_of_a_palette_are_kept_and_the_first_is_transparent():
    with Image.open(io.BytesIO(to_png(IDS, PALETTE))) as picture:
        np.testing.assert_array_equal(np.asarray(picture), IDS)
        colours = np.asarray(picture.convert("RGBA"))
    np.testing.assert_array_equal(colours[..., :3], PALETTE[IDS])
    np.testing.assert_array_equal(colours[..., 3] == 0, IDS == 0)


def test_bytes_do_not_follow_the_compression_of_shards(monkeypatch):
    pixels = np.random.default_rng(0).integers(4, size=(64, 64, 3), dtype=np.uint8)
    before, chunk = to_png(pixels), chunks.stored(pixels)
    monkeypatch.setattr(chunks, "GZIP_LEVEL", 1)
    assert chunks.stored(pixels) != chunk  # so the level matters here
    assert to_png(pixels) == before
