"""The closed surfaces that a mesh consists of: found, wound so that they look outwards, cut apart where they touch."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import breadth_first_order, connected_components

from symsol_annot.errors import ObjectError
from symsol_annot.objects.importing.repairs import Soup, open_edges

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_ASKED, _INSIDE = 16, 0.75


@dataclass(frozen=True, eq=False)
class _Edges:
    """The edges of triangles, each from its lower to its higher vertex.

    Attributes:
        number: (T, 3) of the edge from corner k to corner k + 1.
        is_forward: (T, 3) whether the triangle goes along it from the lower vertex to the higher.
        times: (E,) how many triangles have it.
    """

    number: Indices
    is_forward: Flags
    times: Indices


def closed_shells(soup: Soup) -> Indices:
    """Wind a mesh, and cut shells apart that share an edge or a corner.

    Args:
        soup: changed in place: its triangles, vertices and notes.

    Returns:
        (T,) the number of each triangle's shell.

    Raises:
        ObjectError: it is not closed, or it has one side only.
    """
    _refuse_open(soup)
    edges = _edges(soup.triangles)
    _wind(soup, edges)
    edges = _edges(soup.triangles)
    if (edges.times > 2).any():
        _cut_apart(soup, edges)
    shell_of = _joined_triangles(soup.triangles)
    turned = np.bincount(shell_of, _volumes(soup)) < 0
    if turned.any() and not turned.all():
        turned &= ~_is_cavity(soup, shell_of, turned)
    if turned.any():
        soup.triangles[turned[shell_of]] = soup.triangles[turned[shell_of]][:, ::-1]
        soup.notes.append(
            f"{np.count_nonzero(turned)} surface{'s' if turned.sum() > 1 else ''} that looked inwards turned outwards"
        )
    return shell_of


def winding_number(point: Points, corners: Points) -> float:
    """Return how many times closed triangles (T, 3, 3) go round a point (3,): 0 outside, 1 inside."""
    a, b, c = np.moveaxis(corners - point, 1, 0)
    lengths = [np.linalg.norm(side, axis=1) for side in (a, b, c)]
    spanned = np.einsum("ti,ti->t", a, np.cross(b, c))
    below = lengths[0] * lengths[1] * lengths[2]
    below += np.einsum("ti,ti->t", a, b) * lengths[2] + np.einsum("ti,ti->t", b, c) * lengths[0]
    below += np.einsum("ti,ti->t", c, a) * lengths[1]
    return float(np.arctan2(spanned, below).sum() / (2.0 * np.pi))


def lies_inside(shell: Points, others: Points) -> bool:
    """Tell whether a shell (T, 3, 3) that crosses no other one lies inside closed triangles (U, 3, 3).

    On their surface, where the shell may touch them, a point is half inside; so some points are asked.
    """
    chosen = np.unique(np.linspace(0, len(shell) - 1, _ASKED).astype(int))
    return all(winding_number(point, others) > _INSIDE for point in shell[chosen].mean(axis=1))


def _refuse_open(soup: Soup) -> None:
    edges = open_edges(soup.triangles)
    if not len(edges):
        return
    middle = soup.vertices[edges[0]].mean(axis=0)
    place = ", ".join(f"{value:.6g}" for value in middle)
    raise ObjectError(
        f"the surface is not closed: {len(edges):,} edges have no face on one side, the first of them at "
        f"({place}) of the file. Close it: in Blender's edit mode, with all selected, Mesh > Merge > By Distance and "
        "Mesh > Clean Up > Fill Holes; a sheet needs the modifier 'Solidify'. In MeshLab: 'Close Holes'. From CAD, "
        "export solids"
    )


def _edges(triangles: Indices) -> _Edges:
    following = np.roll(triangles, -1, axis=1)
    ends = np.sort(np.stack([triangles, following], axis=-1), axis=-1)
    keys = ends[..., 0] * (int(triangles.max()) + 1) + ends[..., 1]
    _, number, times = np.unique(keys.ravel(), return_inverse=True, return_counts=True)
    return _Edges(number.reshape(-1, 3), triangles < following, times)


def _wind(soup: Soup, edges: _Edges) -> None:
    """Turn triangles over until neighbours across edges with two faces go along them in opposite directions."""
    sides = np.flatnonzero(edges.times[edges.number.ravel()] == 2)
    order = sides[np.argsort(edges.number.ravel()[sides], kind="stable")]
    one, other = order[0::2], order[1::2]
    is_against = edges.is_forward.ravel()[one] == edges.is_forward.ravel()[other]
    if not is_against.any():
        return
    count = len(soup.triangles)
    rows, columns = one // 3, other // 3
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(count, count)).tocsr()
    against = dict(zip(zip(rows.tolist(), columns.tolist(), strict=True), is_against.tolist(), strict=True))
    is_turned = np.zeros(count, dtype=bool)
    _, patch = connected_components(graph, directed=False)
    for start in np.unique(patch, return_index=True)[1].tolist():
        reached, before = breadth_first_order(graph, start, directed=False)
        for triangle in reached[1:].tolist():
            previous = int(before[triangle])
            pair = (previous, triangle) if (previous, triangle) in against else (triangle, previous)
            is_turned[triangle] = is_turned[previous] ^ against[pair]
        if 2 * np.count_nonzero(is_turned[reached]) > len(reached):
            is_turned[reached] = ~is_turned[reached]
    if ((is_turned[rows] ^ is_turned[columns]) != is_against).any():
        raise ObjectError(
            "the surface has one side only, like a Moebius strip or a Klein bottle, so it has no inside; cut it, or "
            "give it a thickness (in Blender: the modifier 'Solidify')"
        )
    soup.triangles[is_turned] = soup.triangles[is_turned][:, ::-1]
    count = int(np.count_nonzero(is_turned))
    soup.notes.append(f"{count:,} triangle{'s' if count > 1 else ''} wound as their neighbours are")


def _cut_apart(soup: Soup, edges: _Edges) -> None:
    """Give surfaces that share an edge, or touch in a corner, vertices of their own.

    Around an edge with four faces or more, each face that a solid ends at is joined to the one that it begins at.
    """
    flat = edges.number.ravel()
    order = np.argsort(flat, kind="stable")
    ends = np.cumsum(edges.times)
    pairs: list[tuple[int, int]] = []
    for edge, (end, times) in enumerate(zip(ends.tolist(), edges.times.tolist(), strict=True)):
        sides = order[end - times : end]
        pairs += [(int(sides[0]), int(sides[1]))] if times == 2 else _around(soup, edges, sides, edge)
    one, other = np.array(pairs, dtype=np.intp).T
    starts = np.concatenate([one, one // 3 * 3 + (one + 1) % 3])
    fits = np.concatenate([other // 3 * 3 + (other + 1) % 3, other])
    count = 3 * len(soup.triangles)
    graph = coo_array((np.ones(len(starts)), (starts, fits)), shape=(count, count))
    corner = connected_components(graph, directed=False)[1]
    _, first = np.unique(corner, return_index=True)
    soup.vertices = soup.vertices[soup.triangles.ravel()[first]]
    soup.triangles = np.asarray(corner.reshape(-1, 3), dtype=np.intp)
    soup.notes.append(f"surfaces that touch along {np.count_nonzero(edges.times > 2):,} edges were cut apart there")


def _around(soup: Soup, edges: _Edges, sides: Indices, edge: int) -> list[tuple[int, int]]:
    """Return the pairs of sides (triangle x 3 + corner) at an edge with more than two faces, solid by solid."""
    is_forward = edges.is_forward.ravel()[sides]
    if 2 * int(np.count_nonzero(is_forward)) != len(sides):
        raise ObjectError(
            f"the surface is not closed: {len(sides)} faces meet at one edge and do not bound solids; in MeshLab use "
            f"'Repair non Manifold Edges', or export the solids one by one (edge {edge + 1})"
        )
    triangle, corner = sides // 3, sides % 3
    start = soup.triangles[triangle, corner]
    end = soup.triangles[triangle, (corner + 1) % 3]
    low, high = np.minimum(start, end)[0], np.maximum(start, end)[0]
    axis = soup.vertices[high] - soup.vertices[low]
    axis /= np.linalg.norm(axis)
    across = soup.vertices[soup.triangles[triangle, (corner + 2) % 3]] - soup.vertices[low]
    x = across[0] - axis * (across[0] @ axis)
    y = np.cross(axis, x)
    angle = np.round(np.arctan2(across @ y, across @ x) % (2.0 * np.pi), 9) % round(2.0 * np.pi, 9)
    order = np.lexsort((is_forward, angle))
    sides, is_forward = sides[order], is_forward[order]
    first = int(np.argmax(~is_forward))  # a face behind which, as the angle grows, is a solid
    sides, is_forward = np.roll(sides, -first), np.roll(is_forward, -first)
    if is_forward[0::2].any() or not is_forward[1::2].all():
        raise ObjectError(
            f"the surface crosses itself: {len(sides)} faces meet at one edge, and solids overlap there; unite them "
            "(in Blender: the modifier 'Boolean' or 'Remesh')"
        )
    return list(zip(sides[0::2].tolist(), sides[1::2].tolist(), strict=True))


def _joined_triangles(triangles: Indices) -> Indices:
    start, middle, end = triangles.T
    rows, columns = np.concatenate([start, middle]), np.concatenate([middle, end])
    size = int(triangles.max()) + 1
    graph = coo_array((np.ones(len(rows)), (rows, columns)), shape=(size, size))
    _, shell_of = np.unique(connected_components(graph, directed=False)[1][start], return_inverse=True)
    return np.asarray(shell_of, dtype=np.intp)


def _volumes(soup: Soup) -> Points:
    """Return six times the volume (T,) between each triangle and the mean vertex."""
    a, b, c = np.moveaxis((soup.vertices - soup.vertices.mean(axis=0))[soup.triangles], 1, 0)
    return np.asarray(np.einsum("ti,ti->t", a, np.cross(b, c)))


def _is_cavity(soup: Soup, shell_of: Indices, turned: Flags) -> Flags:
    """Tell of each shell whether it looks inwards in a shell that looks outwards: the wall of a hollow."""
    corners = soup.vertices[soup.triangles]
    outer = corners[~turned[shell_of]]
    inside = np.zeros(len(turned), dtype=bool)
    for shell in np.flatnonzero(turned).tolist():
        inside[shell] = lies_inside(corners[shell_of == shell], outer)
    return inside
