"""Does an object's geometry have the symmetries that its object.toml declares?

Points of the surface are turned by elements of the group and must land on the surface again. The marking must
land on itself under its stabiliser, and under no other element. Of an object of format version 2, whose stabiliser is
derived from its parts, the surfaces of the parts that do not break the group are checked.
"""

import numpy as np

from symsol_annot.errors import ObjectError
from symsol_annot.objects.mesh import Mesh
from symsol_annot.objects.spec import ObjectSpec
from symsol_annot.objects.surface import SURFACE_POINTS, SURFACE_TOLERANCE, Points, surface_offsets, surface_points

_ELEMENTS = 12
_FEW_POINTS = 8  # most elements move one of a few points off the marking
_MAX_DISTANCES = 2**28  # of turned points to triangles of the marking: about 20 s


def check_object(spec: ObjectSpec) -> None:
    """Check an object's surface against a sample of its group, and its marking against all of it.

    Raises:
        ObjectError: the surface or the marking lacks a declared symmetry, or the marking has another one.
    """
    triangles = _shell(spec.mesh) if spec.has_general_rule else spec.mesh.vertices[spec.mesh.triangles]
    group = spec.symmetry_group
    sampled = group[np.unique(np.linspace(0, len(group) - 1, _ELEMENTS).astype(int))]
    off = surface_offsets(surface_points(triangles), triangles, np.concatenate([group[1:2], sampled]))
    if not off.max() <= SURFACE_TOLERANCE:
        field = "symmetry" if spec.has_general_rule else "body.group"
        raise ObjectError(
            f"{spec.folder}: the surface of {spec.name!r} is not invariant under {field}: an element of it moves "
            f"points {off.max():.3g} off the surface (allowed {SURFACE_TOLERANCE:g}). {_remedy(spec)}"
        )
    if spec.marking is not None and not spec.has_general_rule:  # whose stabiliser is derived
        _check_marking(spec, triangles[spec.mesh.is_marking])


def _remedy(spec: ObjectSpec) -> str:
    if spec.has_general_rule and spec.marking is not None:
        return (
            "A part that stands out has to be a closed surface of its own, which may reach into the body; a round body "
            "needs a multiple of the group's order of facets"
        )
    return "A round body needs a multiple of the group's order of facets, about the z axis"


def _shell(mesh: Mesh) -> Points:
    """Return the closed surfaces (T, 3, 3) that parts that break no symmetry lie on, with what is painted on them."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - scipy is slow to load, and few objects need this
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    triangles, number = np.arange(len(mesh.triangles)), len(mesh.triangles)
    ends = (np.repeat(triangles, 3), number + mesh.triangles.reshape(-1))
    size = number + len(mesh.vertices)
    _, piece = connected_components(coo_array((np.ones(3 * number), ends), shape=(size, size)), directed=False)
    kept = np.isin(piece[:number], piece[:number][~mesh.is_marking])
    return mesh.vertices[mesh.triangles[kept]]


def _check_marking(spec: ObjectSpec, marking: Points) -> None:
    distances = len(marking) * (SURFACE_POINTS * len(spec.stabiliser) + _FEW_POINTS * len(spec.symmetry_group))
    if distances > _MAX_DISTANCES:
        raise ObjectError(
            f"{spec.folder}: the marking of {spec.name!r} has {len(marking):,} triangles, too many to hold against "
            f"{len(spec.symmetry_group):,} rotations; simplify it to {len(marking) * _MAX_DISTANCES // distances:,}"
        )
    points = surface_points(marking)
    kept = surface_offsets(points, marking, spec.stabiliser)
    if not kept.max() <= SURFACE_TOLERANCE:
        raise ObjectError(
            f"{spec.folder}: marking.stabiliser moves the marking of {spec.name!r} {kept.max():.3g} off itself "
            f"(allowed {SURFACE_TOLERANCE:g})"
        )
    others = spec.symmetry_group[spec.cosets[1:, 0]]
    suspects = others[surface_offsets(points[-_FEW_POINTS:], marking, others) <= SURFACE_TOLERANCE]
    corners = np.unique(marking.reshape(-1, 3), axis=0)
    extra = surface_offsets(np.concatenate([points, corners]), marking, suspects) <= SURFACE_TOLERANCE
    if extra.any():
        raise ObjectError(
            f"{spec.folder}: {np.count_nonzero(extra) + 1} cosets of marking.stabiliser in body.group map the marking "
            f"of {spec.name!r} onto itself, expected 1: the stabiliser is larger than declared"
        )
