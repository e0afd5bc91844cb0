"""How views are drawn: engine, supersampling, colours and light."""

from dataclasses import asdict, dataclass, fields
from typing import Any

from symsol_annot.errors import SettingsError
from symsol_annot.objects.parts import BODY_COLOUR, MARKING_COLOUR, Colour
from symsol_annot.rendering.engines import DEFAULT_ENGINE, engine_named, engines_with_depth

SAMPLES_PER_AXIS = (2, 4, 6, 8)  # even, and sums of their squares fit 16 bits

_ONLY_IF_SET = "depth"


@dataclass(frozen=True)
class RenderSettings:
    """How views are drawn.

    The light is a headlight: a surface with normal n shows colour x (ambient + diffuse x max(0, -n_z)), linear, then
    sRGB. A pixel's RGB is the average over its square by the trapezoidal rule in display values, and its segmentation
    what lies at its centre; a marking's area is counted on the same points.

    Attributes:
        engine: the name of one in `engines.ENGINES`.
        samples_per_axis: the supersampling: the lattice's points lie 1 / `samples_per_axis` pixel apart, as
            `Camera.lattice` has them.
        body_colour: linear RGB, from 0 to 1; an object of format version 2 brings colours of its own.
        marking_colour: linear RGB, of the same objects.
        background_colour: linear RGB.
        ambient: light on every surface, from 0 to 1.
        diffuse: light on a surface that faces the camera, from 0 to 1.
        depth: whether views have the depth at each pixel's centre.

    Raises:
        SettingsError: an engine that does not exist or has no depth, a lattice without a point at a pixel's centre, or
            a colour or a light that is none.
    """

    engine: str = DEFAULT_ENGINE
    samples_per_axis: int = 2
    body_colour: Colour = BODY_COLOUR
    marking_colour: Colour = MARKING_COLOUR
    background_colour: Colour = (1.0, 1.0, 1.0)
    ambient: float = 0.04
    diffuse: float = 0.96
    depth: bool = False

    def __post_init__(self) -> None:
        engine = engine_named(self.engine)
        if type(self.depth) is not bool:
            raise SettingsError(f"depth: expected true or false, found {self.depth!r}")
        if self.depth and not engine.has_depth:
            raise SettingsError(
                f"depth: the engine {self.engine} does not tell it; {', '.join(engines_with_depth())} does"
            )
        if type(self.samples_per_axis) is not int or self.samples_per_axis not in SAMPLES_PER_AXIS:
            raise SettingsError(f"samples_per_axis: expected 2, 4, 6 or 8, found {self.samples_per_axis!r}")
        for name in ("body_colour", "marking_colour", "background_colour"):
            colour = getattr(self, name)
            if not isinstance(colour, tuple) or len(colour) != 3 or not all(_is_light(part) for part in colour):
                raise SettingsError(f"{name}: expected three numbers from 0 to 1, found {colour!r}")
        for name in ("ambient", "diffuse"):
            if not _is_light(getattr(self, name)):
                raise SettingsError(f"{name}: expected a number from 0 to 1, found {getattr(self, name)!r}")

    @property
    def points_per_pixel(self) -> int:
        """How many points of the lattice stand for one pixel's area."""
        return self.samples_per_axis**2

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> "RenderSettings":
        """Return the settings that `to_dict` gave.

        Raises:
            SettingsError: a setting has a value that makes no sense.
            TypeError: they are no table of all the settings.
        """
        if type(data) is not dict or {*data, _ONLY_IF_SET} != {field.name for field in fields(cls)}:
            raise TypeError(f"expected a table of the render settings, found {type(data).__name__}")
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in data.items()}
        return cls(**values)

    def to_dict(self) -> dict[str, Any]:
        """Return the settings as JSON data; `depth` stands there only where it is asked for."""
        data = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(self).items()}
        if not self.depth:
            del data[_ONLY_IF_SET]
        return data


def _is_light(value: Any) -> bool:
    return type(value) in (float, int) and 0 <= value <= 1
