"""Where a pixel holds some of the marking is told from the colours of the set."""

import numpy as np
import pytest

from symsol_annot.errors import SettingsError
from symsol_annot.generation.marking_trace import MarkingTrace
from symsol_annot.rendering.settings import RenderSettings

BLUE_ON_YELLOW = {"body_colour": (0.9, 0.8, 0.2), "marking_colour": (0.05, 0.1, 0.9)}
COLOURS = {
    "published": {},
    "blue on yellow": BLUE_ON_YELLOW,
    "green on red, before black": {
        "body_colour": (0.9, 0.2, 0.2),
        "marking_colour": (0.1, 0.9, 0.1),
        "background_colour": (0.0, 0.0, 0.0),
    },
    "orange on yellow": {"body_colour": (0.9, 0.85, 0.05), "marking_colour": (0.95, 0.2, 0.02)},
}


def srgb(linear):
    linear = np.asarray(linear)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * np.maximum(linear, 1e-9) ** (1 / 2.4) - 0.055)


def mixtures(settings, marked, rng, count=4000):
    """Pixels of random shades of body and background, of which a share is marked."""
    shade = lambda colour: srgb((settings.ambient + settings.diffuse * rng.random((count, 1))) * colour)  # noqa: E731
    body, marking, background = shade(settings.body_colour), shade(settings.marking_colour), settings.background_colour
    share = rng.random((count, 1))
    rest = share * body + (1 - share) * srgb(background)
    return np.round(255 * (marked * marking + (1 - marked) * rest)).astype(np.uint8)


@pytest.mark.parametrize("colours", COLOURS.values(), ids=COLOURS)
def test_a_marked_pixel_has_a_trace_and_no_mixture_of_body_and_background_has(colours):
    settings = RenderSettings(**colours)
    trace, rng = MarkingTrace(settings), np.random.default_rng(0)
    assert not trace.of(mixtures(settings, 0.0, rng)).any()
    assert trace.of(mixtures(settings, 1.0, rng)).all()


def test_with_the_published_colours_it_is_more_red_than_blue():
    trace = MarkingTrace(RenderSettings())
    rgb = np.random.default_rng(0).integers(0, 256, (64, 64, 3)).astype(np.uint8)
    np.testing.assert_array_equal(trace.of(rgb), rgb[..., 0] > rgb[..., 2])


def test_another_marking_is_not_looked_for_in_red():
    assert MarkingTrace(RenderSettings(**BLUE_ON_YELLOW)).channels[0] == 2


def test_a_marking_that_mixtures_look_like_is_refused():
    grey_between = RenderSettings(body_colour=(0.2, 0.2, 0.9), marking_colour=(0.5, 0.5, 0.5))
    with pytest.raises(SettingsError, match=r"no two of red, green and blue tell the marking .*\(0\.5, 0\.5, 0\.5\)"):
        MarkingTrace(grey_between)
