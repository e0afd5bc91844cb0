"""Where the RGB of a view has a trace of the marking's colour, whatever the colours of a set are."""

from itertools import permutations

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import SettingsError
from symsol_annot.rendering.frames.shading import srgb_bytes
from symsol_annot.rendering.settings import RenderSettings

_SHADES = 4096  # more than 8 bits can tell apart
_ROUNDING = 1  # levels, by float32


class MarkingTrace:
    """Finds pixels that body and background alone cannot draw.

    In every shade, they have at most `ratio` times as much of one channel as of another, and so have all their
    mixtures; the marking has more in every shade. With the published colours that is a pixel with more red than
    blue, a sixth of which or more is marked.

    Attributes:
        channels: the two channels compared, 0 for red, 1 for green, 2 for blue.
        ratio: how much of the first, in units of the second, body and background have at most.
    """

    def __init__(self, settings: RenderSettings) -> None:
        """Choose the channels that tell the marking from body and background best.

        Raises:
            SettingsError: no two channels do.
        """
        light = settings.ambient + settings.diffuse * np.linspace(0.0, 1.0, _SHADES)[:, None]
        body, marking = (srgb_bytes(light * c).astype(float) for c in (settings.body_colour, settings.marking_colour))
        background = srgb_bytes(np.array(settings.background_colour)).astype(float)

        def ratio_of(more: int, less: int) -> float:
            of_body = (body[:, more] + _ROUNDING) / np.maximum(body[:, less] - _ROUNDING, 1.0)
            return max(float(of_body.max()), float(background[more] / max(background[less], 1.0)))

        def margin(pair: tuple[int, int]) -> float:
            ratio = ratio_of(*pair)
            return float((marking[:, pair[0]] - ratio * marking[:, pair[1]]).min()) - _slack(ratio)

        self.channels: tuple[int, int] = max(permutations(range(3), 2), key=margin)
        self.ratio = ratio_of(*self.channels)
        if margin(self.channels) <= 0:
            raise SettingsError(
                "render colours: no two of red, green and blue tell the marking from mixtures of body and background, "
                f"which an audit looks for: marking {settings.marking_colour}, body {settings.body_colour}, "
                f"background {settings.background_colour}"
            )

    def of(self, rgb: npt.NDArray[np.uint8]) -> npt.NDArray[np.bool_]:
        """Tell which pixels (H, W) of a view's RGB (H, W, 3) carry the marking's colour."""
        more, less = self.channels
        return np.asarray(rgb[..., more] > self.ratio * rgb[..., less] + _slack(self.ratio))


def _slack(ratio: float) -> float:
    """Return by how many levels rounding two channels to 8 bits can exceed a ratio; it never reverses their order."""
    return 0.0 if ratio == 1.0 else 0.5 + 0.5 * ratio
