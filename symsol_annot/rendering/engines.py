"""The engines that draw: all that is known of each, in one table.

An engine draws one colour and one part's id for each point of the camera's lattice, unmixed.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

from symsol_annot.errors import SettingsError


class Drawing(Enum):
    """How a frame comes about; the room `rendering.blender` has what each takes."""

    OFFSCREEN = "a shader of our own draws light and ids into a buffer in memory"
    VERTEX_COLOURS = "Blender's render pipeline shows the colours at the mesh's corners as they are"
    EMISSION = "Blender's render pipeline, in which a material of shader nodes emits them"


_OPENGL_SHIFT = 1.0 / 512.0  # rounding to a sub-pixel grid of 1/256
_FLOAT32, _FLOAT64 = 1e-6, 1e-12


@dataclass(frozen=True)
class Engine:
    """One engine.

    Attributes:
        name: in commands, manifests and shards.
        blender_name: what Blender calls it.
        drawing: how a frame comes about.
        vertex_shift: by how many lattice spacings at most, along u or v, it moves a projected vertex, or casts a ray
            beside the point: its rounding, without that of floating-point numbers.
        float_shift: what that moves a vertex besides, as a share of the lattice's width.
        needs_opengl: whether it draws with OpenGL, which then decides pixels too.
        needs_gpu: whether it is of use only with a GPU; `doctor` does not try it.
        has_depth: whether it can tell the depth of what it draws.
        draws_spheres: whether it draws a ball of facets as the sphere that they stand for.
        scene_settings: what is set on Blender's scene: the dotted path of each attribute, to its value.
    """

    name: str
    blender_name: str
    drawing: Drawing
    vertex_shift: float
    needs_opengl: bool
    float_shift: float = _FLOAT32
    needs_gpu: bool = False
    has_depth: bool = False
    draws_spheres: bool = False
    scene_settings: Mapping[str, Any] = field(default_factory=dict)


_ALL = (
    Engine(
        name="opengl",
        blender_name="BLENDER_WORKBENCH",  # which opens the graphics device
        drawing=Drawing.OFFSCREEN,
        vertex_shift=_OPENGL_SHIFT,
        needs_opengl=True,
        float_shift=_FLOAT64,
        has_depth=True,
        draws_spheres=True,
    ),
    Engine(
        name="workbench",
        blender_name="BLENDER_WORKBENCH",
        drawing=Drawing.VERTEX_COLOURS,
        vertex_shift=_OPENGL_SHIFT,
        needs_opengl=True,
        scene_settings={
            "display.render_aa": "OFF",
            "display.shading.color_type": "VERTEX",
            "display.shading.light": "FLAT",
            "display.shading.show_backface_culling": True,
            "display.shading.show_xray": False,
            "display.shading.show_shadows": False,
            "display.shading.show_object_outline": False,
            "display.shading.show_cavity": False,
        },
    ),
    Engine(
        name="cycles",
        blender_name="CYCLES",
        drawing=Drawing.EMISSION,
        vertex_shift=1.0 / 64.0,  # its rays pass up to 0.005 beside the point; the rest is set aside
        needs_opengl=False,
        scene_settings={
            "render.filter_size": 0.0,
            "cycles.device": "CPU",
            "cycles.samples": 1,
            "cycles.use_adaptive_sampling": False,
            "cycles.use_denoising": False,
            "cycles.transparent_max_bounces": 8,
            "cycles.max_bounces": 8,
            "cycles.pixel_filter_type": "BOX",
            "cycles.filter_width": 0.01,
            "cycles.seed": 0,
            "render.threads_mode": "FIXED",
            "render.threads": 1,
        },
    ),
    Engine(
        name="eevee",
        blender_name="BLENDER_EEVEE_NEXT",
        drawing=Drawing.EMISSION,
        vertex_shift=_OPENGL_SHIFT,
        needs_opengl=True,
        needs_gpu=True,
        scene_settings={"render.filter_size": 0.0, "eevee.taa_render_samples": 1},
    ),
)

ENGINES = {engine.name: engine for engine in _ALL}
DEFAULT_ENGINE = "opengl"


def engine_named(name: Any) -> Engine:
    """Return the engine of a name.

    Raises:
        SettingsError: there is none.
    """
    if type(name) is not str or name not in ENGINES:
        raise SettingsError(f"engine: expected one of {', '.join(ENGINES)}, found {name!r}")
    return ENGINES[name]


def engines_without_opengl() -> list[str]:
    """Return the names of the engines that draw where there is no OpenGL."""
    return [engine.name for engine in ENGINES.values() if not engine.needs_opengl]


def engines_with_depth() -> list[str]:
    """Return the names of the engines that tell the depth of what they draw."""
    return [engine.name for engine in ENGINES.values() if engine.has_depth]
