"""What is mended in a mesh without changing what a camera sees, and what is said about it."""

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from symsol_annot.errors import ObjectError

Points = npt.NDArray[np.float64]
Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_WELDS = (1e-8, 1e-6, 1e-5)  # of the size: tried in this order until the surface is closed
_NO_HEIGHT = 1e-9  # of the size: a triangle that is no higher is a line
_MOST_PASSES = 12
_LEAST_SIZE = 1e-30


@dataclass(eq=False)
class Soup:
    """Triangles that are being mended.

    Attributes:
        vertices: (V, 3) f8.
        triangles: (T, 3) indices of vertices.
        label_of: (T,) the part of each triangle.
        notes: what was mended, in words.
    """

    vertices: Points
    triangles: Indices
    label_of: Indices
    notes: list[str] = field(default_factory=list)

    def kept(self, is_kept: Flags) -> None:
        """Keep the triangles that (T,) flags choose."""
        self.triangles, self.label_of = self.triangles[is_kept], self.label_of[is_kept]

    @property
    def size(self) -> float:
        """The longest side of the box around the vertices."""
        return float(np.ptp(self.vertices, axis=0).max())


def mend(soup: Soup) -> Soup:
    """Return a mesh with corners in one place welded, without doubles, flaps and triangles without area.

    A part that is closed by itself stays a shell of its own; all others are welded together.

    Raises:
        ObjectError: there are no triangles, or vertices that are no numbers or all in one place, or two parts have the
            same triangles.
    """
    soup = used_vertices(soup)
    if not np.isfinite(soup.vertices).all():
        raise ObjectError("the mesh has vertices that are no numbers")
    if soup.size <= _LEAST_SIZE:
        raise ObjectError("the mesh has no size: all its vertices are in one place")
    _refuse_same_faces(soup)
    labels = np.unique(soup.label_of)
    alone = [label for label in labels if len(labels) > 1 and _is_closed_alone(soup, soup.label_of == label)]
    groups = [soup.label_of == label for label in alone]
    rest = ~np.isin(soup.label_of, alone)
    mended = [_mend_group(_chosen(soup, chosen), soup.size) for chosen in [*groups, rest] if chosen.any()]
    starts = np.cumsum([0, *(len(one.vertices) for one in mended)])
    return Soup(
        np.concatenate([one.vertices for one in mended]),
        np.concatenate([one.triangles + start for one, start in zip(mended, starts[:-1], strict=True)]),
        np.concatenate([one.label_of for one in mended]),
        list(dict.fromkeys(note for one in mended for note in one.notes)),
    )


def is_closed(triangles: Indices) -> bool:
    """Tell whether each edge of triangles (T, 3) has as many faces on one side as on the other."""
    return len(open_edges(triangles)) == 0


def open_edges(triangles: Indices) -> Indices:
    """Return the edges (n, 2) that have an odd number of faces."""
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    known, times = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(known[times % 2 == 1], dtype=np.intp)


def used_vertices(soup: Soup) -> Soup:
    """Return a mesh without the vertices that no triangle has."""
    used, triangles = np.unique(soup.triangles, return_inverse=True)
    return Soup(soup.vertices[used], triangles.reshape(-1, 3), soup.label_of, soup.notes)


def _chosen(soup: Soup, is_chosen: Flags) -> Soup:
    return used_vertices(Soup(soup.vertices, soup.triangles[is_chosen], soup.label_of[is_chosen]))


def _is_closed_alone(soup: Soup, is_chosen: Flags) -> bool:
    part = _chosen(soup, is_chosen)
    place = _places(part.vertices, _WELDS[0] * soup.size)
    welded = place[part.triangles]
    has_corners = (welded != np.roll(welded, 1, axis=1)).all(axis=1)
    return bool(has_corners.any()) and is_closed(welded[has_corners])


def _mend_group(soup: Soup, size: float) -> Soup:
    """Weld by the smallest distance that closes the surface; by the smallest of all where none does."""
    first: Soup | None = None
    for weld in _WELDS:
        mended = _welded(soup, weld * size)
        if weld > _WELDS[0]:
            mended.notes.append(f"vertices up to {weld:g} of the mesh's size apart were welded")
        _drop_collapsed(mended)
        _drop_doubles(mended)
        _flip_slivers(mended, _NO_HEIGHT * size)
        mended = used_vertices(mended)
        if not len(mended.triangles):
            raise ObjectError("the mesh has no triangle with an area")
        if is_closed(mended.triangles):
            return mended
        first = first or mended
    return first or soup


def _welded(soup: Soup, distance: float) -> Soup:
    place = _places(soup.vertices, distance)
    count = int(place.max()) + 1
    first = np.full(count, len(place))
    np.minimum.at(first, place, np.arange(len(place)))
    notes = []
    if count < len(place):
        notes.append(f"{len(place):,} vertices were welded to {count:,}")
    return Soup(soup.vertices[first], place[soup.triangles], soup.label_of.copy(), notes)


def _places(vertices: Points, distance: float) -> Indices:
    """Return the number (V,) of the place that each vertex is in; vertices nearer than a distance are in one."""
    known, place = np.unique(vertices, axis=0, return_inverse=True)
    pairs = cKDTree(known).query_pairs(distance, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(known), len(known)))
    joined = connected_components(graph, directed=False)[1]
    return np.asarray(joined[place.reshape(-1)], dtype=np.intp)


def _drop_collapsed(soup: Soup) -> None:
    has_corners = (soup.triangles != np.roll(soup.triangles, 1, axis=1)).all(axis=1)
    _say_dropped(soup, int(np.count_nonzero(~has_corners)))
    soup.kept(has_corners)


def _say_dropped(soup: Soup, count: int) -> None:
    if count:
        soup.notes.append(f"{count:,} triangle{'s' if count > 1 else ''} without area left out")


def _drop_doubles(soup: Soup) -> None:
    """Keep one of triangles in one place that look the same way, and none of two back to back."""
    order = np.sort(soup.triangles, axis=1)
    turn = np.where(_is_even(soup.triangles), 1, -1)
    known, place = np.unique(order, axis=0, return_inverse=True)
    place = place.reshape(-1)
    if len(known) == len(place):
        return
    net = np.zeros(len(known), dtype=int)
    np.add.at(net, place, turn)
    wanted = np.sign(net)[place] == turn
    kept = np.zeros(len(place), dtype=bool)
    candidates = np.flatnonzero(wanted)
    _, first = np.unique(place[candidates], return_index=True)
    kept[candidates[first]] = True
    backs = int(np.count_nonzero((net == 0)[place]))
    twice = len(place) - int(np.count_nonzero(kept)) - backs
    if twice:
        soup.notes.append(f"{twice:,} triangle{'s' if twice > 1 else ''} there twice left out")
    if backs:
        soup.notes.append(f"{backs:,} triangles back to back, which enclose nothing, left out")
    soup.kept(kept)


def _is_even(triangles: Indices) -> Flags:
    """Tell of each triangle whether its corners are an even permutation of their order."""
    a, b, c = triangles.T
    return np.asarray(((a < b) & (b < c)) | ((b < c) & (c < a)) | ((c < a) & (a < b)))


def _refuse_same_faces(soup: Soup) -> None:
    """Refuse triangles of two parts that are in one place and look the same way."""
    place = _places(soup.vertices, _WELDS[0] * soup.size)[soup.triangles]
    rows = np.column_stack([np.sort(place, axis=1), _is_even(place)])
    _, group = np.unique(rows, axis=0, return_inverse=True)
    group = group.reshape(-1)
    least, most = np.full(len(group), len(soup.label_of)), np.full(len(group), -1)
    np.minimum.at(least, group, soup.label_of)
    np.maximum.at(most, group, soup.label_of)
    count = int(np.count_nonzero((least < most)[group]))
    if count:
        raise ObjectError(
            f"{count:,} triangles of two parts are in one place: parts cannot select the same faces; remove those of "
            "one of them"
        )


def _flip_slivers(soup: Soup, least_height: float) -> None:
    """Replace each triangle that is a line, and its neighbour across the longest edge, by two on the other diagonal."""
    gone = 0
    for _ in range(_MOST_PASSES):
        corners = soup.vertices[soup.triangles]
        sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
        doubled = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        slivers = np.flatnonzero(doubled < least_height * sides.max(axis=1))
        if not len(slivers):
            break
        owner = {
            edge: index for index, (a, b, c) in enumerate(soup.triangles.tolist()) for edge in ((a, b), (b, c), (c, a))
        }
        touched: set[int] = set()
        kept = np.ones(len(soup.triangles), dtype=bool)
        for sliver in slivers.tolist():
            gone += _flip(soup, sliver, int(sides[sliver].argmax()), owner, touched, kept)
        if not touched:
            break
        soup.kept(kept)
    _say_dropped(soup, gone)


def _flip(soup: Soup, sliver: int, side: int, owner: dict[tuple[int, int], int], touched: set[int], kept: Flags) -> int:
    """Flip one sliver; return how many triangles fewer are lines now, 0 where it has to wait or cannot be done."""
    p, q, r = np.roll(soup.triangles[sliver], -side).tolist()
    neighbour = owner.get((q, p))
    if neighbour is None or neighbour == sliver or {sliver, neighbour} & touched:
        return 0
    (s,) = set(soup.triangles[neighbour].tolist()) - {p, q} or {r}
    touched |= {sliver, neighbour}
    if s == r:
        kept[[sliver, neighbour]] = False
        return 2
    label = soup.label_of[neighbour]
    soup.triangles[sliver], soup.triangles[neighbour] = (r, p, s), (s, q, r)
    soup.label_of[sliver] = label
    return 1
