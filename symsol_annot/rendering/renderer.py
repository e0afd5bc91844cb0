"""What a renderer draws, what it does, and the view that it gives."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Protocol

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.mesh import BODY_ID, MARKING_ID, Mesh
from symsol_annot.objects.parts import Colour
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rendering.windows import Window
from symsol_annot.rotations.so3 import Rotations

BACKGROUND, BODY, MARKING = 0, BODY_ID, MARKING_ID  # segmentation ids


@dataclass(frozen=True, eq=False)
class Scene:
    """All that decides a view, but for the object's rotation and the software; plain data, for a process to draw.

    Attributes:
        mesh: the object's, in model coordinates.
        camera: what it is seen through.
        settings: engine, supersampling, colours and light.
        colours: linear RGB of each part; empty where the settings have those of body and marking.
        is_ball: whether the mesh stands for the unit sphere, which engine `opengl` then draws (`frames.balls`).
    """

    mesh: Mesh
    camera: Camera
    settings: RenderSettings
    colours: tuple[Colour, ...] = ()
    is_ball: bool = False

    @classmethod
    def for_object(cls, spec: ObjectSpec, camera: Camera, settings: RenderSettings) -> "Scene":
        """Return the scene of an object, in the colours of its parts where it brings them."""
        colours = tuple(part.colour for part in spec.parts) if spec.has_general_rule else ()
        return cls(spec.mesh, camera, settings, colours, spec.is_ball)

    @property
    def part_colours(self) -> npt.NDArray[np.float64]:
        """The (P, 3) linear RGB of the parts, in the order of their ids, of which the first is 1."""
        colours = self.colours or (self.settings.body_colour, self.settings.marking_colour)
        return np.array(colours)[: self.mesh.parts]


@dataclass(frozen=True, eq=False)
class View:
    """One view of an object.

    Attributes:
        rgb: (H, W, 3) u8 in sRGB, anti-aliased.
        segmentation: (H, W) u8, the id (0 background, then the parts in their order) at each pixel's centre.
        part_pixels: (P,) f8, the visible area of each part in pixels, the body's first: the lattice points that show
            it, over those per pixel.
        depth: (H, W) f4, how far along the camera's axis what is seen at each pixel's centre lies from the camera, in
            bounding-sphere radii, 0 at the background; None unless the settings ask for it.
    """

    rgb: npt.NDArray[np.uint8]
    segmentation: npt.NDArray[np.uint8]
    part_pixels: npt.NDArray[np.float64]
    depth: npt.NDArray[np.float32] | None = None

    @property
    def marking_pixels(self) -> float:
        """The marking's visible area in pixels; 0 without a marking."""
        return float(self.part_pixels[MARKING - 1]) if len(self.part_pixels) >= MARKING else 0.0


@dataclass(frozen=True, eq=False)
class LabelWindow:
    """What lies at the lattice's points around an object's marking.

    Attributes:
        window: which points.
        ids: (height, width) u8, the id at each of them.
    """

    window: Window
    ids: npt.NDArray[np.uint8]


@dataclass(frozen=True, eq=False)
class LitWindow(LabelWindow):
    """What lies at the lattice's points around an object's marking, and how it is lit.

    Attributes:
        rgb: (height, width, 3) u8 in sRGB, the colour at each of them.
    """

    rgb: npt.NDArray[np.uint8]


class Renderer(AbstractContextManager["Renderer"], Protocol):
    """Draws one object through one camera, in one way; a context manager, since it may hold a process.

    The same rotation gives the same view every time, whatever was drawn before. Rotations take model coordinates to
    camera coordinates. An implementation raises `RenderError` where it cannot draw.
    """

    @property
    def versions(self) -> dict[str, str]:
        """The software that decides the pixels: name to version."""

    def render(self, R_m2c: Rotations) -> View:
        """Draw the object under one rotation.

        Args:
            R_m2c: (3, 3).

        Returns:
            The view, (H, W) as the camera's height and width.
        """

    def marking_pixels(self, R_m2c: Rotations) -> npt.NDArray[np.float64]:
        """Return the marking's visible area under each rotation, without drawing pictures.

        Args:
            R_m2c: (n, 3, 3); n may be 0.

        Returns:
            (n,) f8 in pixels: the `marking_pixels` of each rotation's view, bit for bit; 0 without a marking.
        """

    def label_windows(self, R_m2c: Rotations) -> list[LabelWindow]:
        """Return what lies around the marking under each rotation, for views to be compared point by point.

        Args:
            R_m2c: (n, 3, 3); n may be 0.

        Returns:
            n windows, each of which holds all of the marking's points that the rotation's view has, bit for bit.

        Raises:
            RenderError: the object has no marking.
        """

    def lit_windows(self, R_m2c: Rotations) -> list[LitWindow]:
        """Return what `label_windows` does, and the colour at each point.

        Args:
            R_m2c: (n, 3, 3); n may be 0.

        Raises:
            RenderError: the object has no marking.
        """

    def close(self) -> None:
        """Let go of what the renderer holds."""
