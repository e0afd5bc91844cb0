"""Is an object as bright in each place as in those that its symmetries carry it to?

A surface may have symmetries that its normals have not: an exporter has smoothed one face of a cube, or one half of a
lathe. Members of a symmetry set would then draw other pictures.
"""

import numpy as np

from symsol_annot.errors import ObjectError
from symsol_annot.objects.checking.shell import breaks_itself
from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.finding.surface import Surface
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.objects.surface import SURFACE_TOLERANCE, Points
from symsol_annot.rotations.so3 import Rotations

_POINTS = 96
_LEVELS = 8.0 / 255.0  # of the light: less than what counts as another shade
_ELEMENTS = 12  # of a stabiliser
_INSIDE = 0.1  # least barycentric weight: at a kink a point has several normals


def refuse_other_shading(spec: ObjectSpec, shell: Surface, elements: Rotations) -> None:
    """Refuse an object whose normals lack symmetries that its surface has.

    Args:
        spec: the object.
        shell: the surface that has the declared group, made from its mesh.
        elements: (n, 3, 3) of the declared group.

    Raises:
        ObjectError: a point is lit otherwise than where a symmetry carries it; the message says where and by how much.
    """
    mesh = spec.mesh
    if not breaks_itself(spec):
        _refuse(spec, "the surface", shell.corners, mesh.corner_normals[shell.source], elements)
    for part in mesh.breaking if spec.marking is not None else ():
        name, normals = spec.parts[part - 1].name, mesh.corner_normals[mesh.part_ids == part]
        _refuse(spec, f"part {name!r}", mesh.triangles_of(part), normals, spec.stabiliser[:_ELEMENTS])


def _refuse(spec: ObjectSpec, what: str, corners: Points, normals: Points, elements: Rotations) -> None:
    distance = SurfaceDistance(corners)
    points, lit = _points(corners, normals)
    for R in elements:
        turned = points @ R.T
        off, triangle = distance.nearest(turned, SURFACE_TOLERANCE)
        there = np.einsum("nk,nki->ni", _weights(turned, corners[triangle]), normals[triangle])
        differs = np.where(off <= SURFACE_TOLERANCE, np.linalg.norm(lit @ R.T - there, axis=1), 0.0)
        worst = int(differs.argmax())
        if differs[worst] > _LEVELS:
            place = ", ".join(f"{value + 0.0:.3g}" for value in points[worst])
            raise ObjectError(
                f"{spec.folder}: the shading of {what} of {spec.name!r} is not that of its shape: at ({place}) and "
                f"where a symmetry carries that point, the light differs by {differs[worst]:.0%}. Recompute the mesh's "
                "normals (vn), or leave them out where the surface is flat"
            )


def _points(corners: Points, normals: Points) -> tuple[Points, Points]:
    """Return points (n, 3) within triangles, always the same, and their interpolated normals (n, 3)."""
    rng = np.random.default_rng(0)
    areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    chosen = rng.choice(len(corners), size=_POINTS, p=areas / areas.sum())
    weights = _INSIDE + (1.0 - 3.0 * _INSIDE) * rng.dirichlet(np.ones(3), size=_POINTS)
    points, lit = (np.einsum("nk,nki->ni", weights, of[chosen]) for of in (corners, normals))
    return points, lit


def _weights(points: Points, corners: Points) -> Points:
    """Return the barycentric weights (n, 3) of points (n, 3) in their triangles' planes (n, 3, 3)."""
    a, b, c = np.moveaxis(corners, 1, 0)
    normal = np.cross(b - a, c - a)
    squared = np.einsum("ni,ni->n", normal, normal)
    of_b = np.einsum("ni,ni->n", np.cross(points - a, c - a), normal) / squared
    of_c = np.einsum("ni,ni->n", np.cross(b - a, points - a), normal) / squared
    return np.stack([1.0 - of_b - of_c, of_b, of_c], axis=1)
