"""Object models as BOP has them: an ASCII PLY in millimetres, and what models_info.json says of it."""

import contextlib
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.spatial import ConvexHull, QhullError
from scipy.spatial.distance import cdist

from symsol_annot.objects.mesh import Mesh
from symsol_annot.rendering.frames.shading import srgb_bytes
from symsol_annot.rendering.settings import RenderSettings
from symsol_annot.rotations.nearest import find_circles
from symsol_annot.rotations.so3 import Rotations

_PROPERTIES = (
    *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
    *(f"property uchar {name}" for name in ("red", "green", "blue")),
)
_POINTS_AT_ONCE = 1024


def to_ply(mesh: Mesh, settings: RenderSettings, radius_mm: float) -> bytes:
    """Return a mesh as an ASCII PLY with normals and colours per vertex.

    A vertex at which triangles of several normals or colours meet is written once for each of these.

    Args:
        mesh: whose bounding sphere has radius 1.
        settings: which colours the parts have.
        radius_mm: the bounding sphere's radius in the file.
    """
    vertices = mesh.vertices[mesh.triangles].reshape(-1, 3) * radius_mm
    colours = srgb_bytes(np.array([settings.body_colour, settings.marking_colour]))
    colour = np.repeat(colours[mesh.part_ids.astype(int) - 1], 3, axis=0)
    corners = np.concatenate([vertices, mesh.corner_normals.reshape(-1, 3), colour], axis=1)
    rows, index = np.unique(corners, axis=0, return_inverse=True)
    lines = ["ply", "format ascii 1.0", "comment millimetres", f"element vertex {len(rows)}", *_PROPERTIES]
    lines += [f"element face {len(mesh.triangles)}", "property list uchar int vertex_indices", "end_header"]
    for row in rows:
        numbers = [f"{value:.9g}" for value in row[:6] + 0.0]  # no -0
        lines.append(" ".join([*numbers, *(str(int(value)) for value in row[6:])]))
    lines += [f"3 {a} {b} {c}" for a, b, c in index.reshape(-1, 3)]
    return ("\n".join(lines) + "\n").encode("ascii")


def model_info(mesh: Mesh, symmetries: Rotations, radius_mm: float) -> dict[str, Any]:
    """Return an object's entry of models_info.json, in millimetres.

    Args:
        mesh: whose bounding sphere has radius 1.
        symmetries: (G, 3, 3) the rotations that map the object onto itself, identity first.
        radius_mm: the bounding sphere's radius in the file.
    """
    used = mesh.vertices[np.unique(mesh.triangles)] * radius_mm
    least, size = used.min(axis=0), np.ptp(used, axis=0)
    info: dict[str, Any] = {"diameter": diameter(used)}
    info |= {f"min_{axis}": float(value) for axis, value in zip("xyz", least, strict=True)}
    info |= {f"size_{axis}": float(value) for axis, value in zip("xyz", size, strict=True)}
    return {**info, **symmetries_of(symmetries)}


def symmetries_of(group: Rotations) -> dict[str, Any]:
    """Return a group (G, 3, 3), identity first, in the terms of models_info.json; nothing for the identity alone.

    `symmetries_discrete` lists 4x4 transformations row by row, without the identity; `symmetries_continuous` the axes
    of circles. A symmetry of the object is one of the circle after a discrete one. All leave the origin where it is.
    """
    circles = find_circles(group)
    discrete = group[1:] if circles is None else circles.starts[1:]
    found: dict[str, Any] = {}
    if len(discrete):
        found["symmetries_discrete"] = [_transformation(R) for R in discrete]
    if circles is not None:
        found["symmetries_continuous"] = [{"axis": circles.axis.tolist(), "offset": [0.0, 0.0, 0.0]}]
    return found


def diameter(points: npt.NDArray[np.float64]) -> float:
    """Return the largest distance between two of the points (n, 3)."""
    with contextlib.suppress(QhullError):  # all in one plane
        points = points[ConvexHull(points).vertices]
    starts = range(0, len(points), _POINTS_AT_ONCE)
    return max(float(cdist(points[start : start + _POINTS_AT_ONCE], points).max()) for start in starts)


def _transformation(R: Rotations) -> list[float]:
    whole = np.eye(4)
    whole[:3, :3] = R
    return [float(value) for value in (whole + 0.0).ravel()]
