"""What was found, as JSON, and as BOP's models_info.json states symmetries."""

from typing import Any

import numpy as np
from scipy.spatial.distance import pdist

from symsol_annot.objects.finding.candidates import hull_corners
from symsol_annot.objects.finding.found import CIRCLE_WITH_HALF_TURNS, CertifiedGroup, Group, Symmetries
from symsol_annot.objects.finding.surface import Points, Surface
from symsol_annot.rotations.groups import ALL_ROTATIONS, CIRCLE_STEPS


def symmetries_to_json(found: Symmetries) -> dict[str, Any]:
    """Return all that was found as plain data; lengths are parts of the radius, places in the mesh's unit."""
    return {
        "shape": {**group_to_json(found.shape.group), **_certificate(found.shape)},
        "object": group_to_json(found.object),
        "centre": found.shape.centre.tolist(),
        "radius": found.radius,
        "tolerance": found.tolerance,
        "parts": [
            {
                "name": part.name,
                "triangles": part.triangles,
                "stabiliser": group_to_json(part.stabiliser),
                "residual": part.residual,
            }
            for part in found.parts
        ],
        "round": found.roundness and {"group": found.roundness.group.name, "within": found.roundness.deviation},
        "larger": [
            {
                **group_to_json(one.group),
                "but_for": one.what,
                "faces": one.taken_away.tolist(),
                "area_left": one.area_left,
                "centre": one.centre.tolist(),
                "residual": one.residual,
            }
            for one in found.larger
        ],
        "not_looked_for": list(found.not_looked_for),
    }


def group_to_json(group: Group) -> dict[str, Any]:
    """Return a group as plain data; `rotations` is None where there are more than can be listed."""
    return {
        "group": group.name,
        "kind": group.kind,
        "order": group.order,
        "rotations": group.size,
        "axes": [{"direction": list(axis.direction), "fold": axis.fold} for axis in group.axes],
        "frame": group.frame.tolist(),
    }


def bop_model_info(surface: Surface, found: Symmetries) -> dict[str, Any]:
    """Return a model's entry of BOP's models_info.json: its size, and the symmetries of the object with its parts.

    A symmetry is x -> R x + t in the mesh's own unit, which BOP has in millimetres.
    All rotations, which that format cannot say, are stated as the circles about three axes.
    """
    group, centre = found.object, found.shape.centre
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    corners = hull_corners(surface.vertices).points
    info: dict[str, Any] = {"diameter": float(pdist(corners).max()) if len(corners) <= 4_000 else _diameter(corners)}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", low, strict=True)}
    info |= {f"size_{axis}": float(value) for axis, value in zip("xyz", high - low, strict=True)}
    discrete = group.rotations[1:]
    if group.is_continuous:
        axes = np.eye(3) if group.kind == ALL_ROTATIONS else group.frame[:, 2:].T
        info["symmetries_continuous"] = [{"axis": axis, "offset": centre.tolist()} for axis in axes.tolist()]
        half_turn = group.rotations[CIRCLE_STEPS : CIRCLE_STEPS + 1]
        discrete = half_turn if group.kind == CIRCLE_WITH_HALF_TURNS else discrete[:0]
    if len(discrete):
        matrices = np.tile(np.eye(4), (len(discrete), 1, 1))
        matrices[:, :3, :3], matrices[:, :3, 3] = discrete, centre - discrete @ centre
        info["symmetries_discrete"] = matrices.reshape(-1, 16).tolist()
    return info


def _diameter(corners: Points) -> float:
    """Return the largest distance between many points."""
    return max(float(np.linalg.norm(corners - corner, axis=1).max()) for corner in corners)


def _certificate(shape: CertifiedGroup) -> dict[str, Any]:
    failed = shape.failed
    return {
        "residual": shape.residual,
        "bound": shape.bound,
        "triangles_not_bounded": shape.unbounded,
        "candidates": shape.candidates,
        "next_failed": failed
        and {"angle_deg": float(np.degrees(failed.angle_rad)), "axis": list(failed.axis), "residual": failed.residual},
    }
