"""The surface whose group an object declares: what is left without the parts that break its symmetry."""

import numpy as np
import numpy.typing as npt

from symsol_annot.objects.finding.surface import Surface, make_surface
from symsol_annot.objects.mesh import BODY_ID, Mesh
from symsol_annot.objects.spec import ObjectSpec

Indices = npt.NDArray[np.intp]


def shell_of(spec: ObjectSpec) -> Surface:
    """Return the closed surfaces that the parts which break no symmetry lie on, with what is painted on them.

    Painted on is a breaking part that shares edges with them, whose faces fill the gap that they are cut out of; they
    count to the part around them. A marking of format version 1 is always painted on. A closed surface of its own, such
    as a handle, is left out where it breaks the symmetry. Where each part does, as of `symmetry.of = []`, nothing is.

    Args:
        spec: the object.

    Returns:
        The surface, of the parts that break no symmetry, in the object's frame.
    """
    mesh = spec.mesh
    numbers = np.asarray(mesh.part_ids, dtype=np.intp) - BODY_ID
    if not spec.has_general_rule or breaks_itself(spec):
        kept, part_of = np.ones(len(mesh.triangles), dtype=bool), np.zeros(len(mesh.triangles), dtype=np.intp)
    else:
        pieces = _pieces(mesh)
        kept = np.isin(pieces, pieces[~mesh.is_marking])
        part_of = _with_painted(mesh, numbers, kept)
    if breaks_itself(spec):
        part_of = numbers
    present, dense = np.unique(part_of[kept], return_inverse=True)
    names = tuple(spec.parts[number].name for number in present.tolist())
    return make_surface(mesh.vertices, mesh.triangles[kept], dense.reshape(-1), names)


def breaks_itself(spec: ObjectSpec) -> bool:
    """Tell whether every part of an object breaks its group, so that images are compared as a whole."""
    return spec.has_general_rule and bool(spec.mesh.is_marking.all())


def _pieces(mesh: Mesh) -> Indices:
    """Return the number of the connected piece, by shared vertices, that each triangle (T,) belongs to."""
    from scipy.sparse import coo_array  # noqa: PLC0415 - scipy is slow to load, and few objects need this
    from scipy.sparse.csgraph import connected_components  # noqa: PLC0415

    number = len(mesh.triangles)
    ends = (np.repeat(np.arange(number), 3), number + mesh.triangles.reshape(-1))
    size = number + len(mesh.vertices)
    _, piece = connected_components(coo_array((np.ones(3 * number), ends), shape=(size, size)), directed=False)
    return np.asarray(piece[:number], dtype=np.intp)


def _with_painted(mesh: Mesh, numbers: Indices, kept: npt.NDArray[np.bool_]) -> Indices:
    """Return the part (T,) of each triangle, for one that is painted on that of the faces around it."""
    around = numbers.copy()
    is_open = mesh.is_marking & kept
    neighbours = _neighbours(mesh)
    while is_open.any():
        facing = np.where(neighbours < 0, -1, np.where(is_open[neighbours], -1, around[neighbours]))
        reached = is_open & (facing.max(axis=1) >= 0)
        if not reached.any():
            break
        around[reached] = facing[reached].max(axis=1)
        is_open &= ~reached
    return around


def _neighbours(mesh: Mesh) -> Indices:
    """Return the triangle across each edge (T, 3), from corner k to k + 1; -1 where there is none, or more than one."""
    part_of = np.zeros(len(mesh.triangles), dtype=np.intp)
    source = np.arange(len(mesh.triangles))
    return Surface(mesh.vertices, mesh.triangles, part_of, ("surface",), source).neighbours
