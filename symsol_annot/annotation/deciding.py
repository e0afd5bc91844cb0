"""Which geometry decides whether a marking shows, for which objects."""

from typing import Protocol

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.standing_out import StandingOut
from symsol_annot.annotation.visibility import MarkingVisibility
from symsol_annot.objects.mesh import is_convex
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.rendering.camera import Camera
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.so3 import Rotations


class Visibility(Protocol):
    """Decides by geometry how much of what breaks a body's symmetry shows, where it can."""

    def areas(self, R_m2c: Rotations, tolerance_px: float) -> npt.NDArray[np.float64]:
        """Return an area (n,) in pixels under each rotation (n, 3, 3), or NaN where geometry does not decide.

        It is on the same side of the tolerance as the area that a renderer counts, and 0 where that is 0.
        """


def visibility_of(spec: ObjectSpec, camera: Camera, settings: RenderSettings) -> Visibility | None:
    """Return what decides by geometry whether an object's marking shows; None where nothing does.

    On a convex body that is where its front is; of parts that stand out of a body, whether they do beside it.
    """
    if spec.marking is None or spec.mesh.is_marking.all():  # where all parts break the group, each image shows one
        return None
    if is_convex(spec.mesh):
        return MarkingVisibility(spec.mesh, camera, settings)
    standing_out = StandingOut(spec.mesh, camera, settings) if spec.has_general_rule else None
    return standing_out if standing_out is not None and standing_out.is_of_use else None
