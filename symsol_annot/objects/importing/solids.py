"""The shells of a mesh as solids: none crosses itself, none is out of sight, and all of them are one object."""

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from symsol_annot.errors import ObjectError
from symsol_annot.objects.finding.distance.distances import SurfaceDistance
from symsol_annot.objects.importing.crossings import crossing_pairs
from symsol_annot.objects.importing.repairs import Soup
from symsol_annot.objects.importing.shells import lies_inside

Indices = npt.NDArray[np.intp]
Flags = npt.NDArray[np.bool_]

_GAP = 0.01  # of the size: shells that are no farther apart belong together, as a ball and a bearing's ring of facets
_SHOWN = 4


def sort_out(soup: Soup, shell_of: Indices) -> Indices:
    """Leave out shells that no camera sees, and check the others.

    Args:
        soup: changed in place.
        shell_of: (T,) the number of each triangle's shell.

    Returns:
        (T,) the number of each shell of the triangles that are left.

    Raises:
        ObjectError: a shell crosses itself, or shells do not touch.
    """
    crossing = crossing_pairs(soup.vertices, soup.triangles)
    shells = shell_of[crossing]
    is_own = shells[:, 0] == shells[:, 1]
    if is_own.any():
        x, y, z = (f"{value:.6g}" for value in soup.vertices[soup.triangles[crossing[is_own][0, 0]]].mean(axis=0))
        raise ObjectError(
            f"the surface crosses itself: {np.count_nonzero(is_own):,} pairs of triangles, the first at "
            f"({x}, {y}, {z}) of the file. In Blender the modifier 'Remesh' or, for solids that overlap, "
            "'Boolean' with 'Self Intersection' mends it; in MeshLab 'Select Self Intersecting Faces' shows it"
        )
    hidden = _hidden(soup, shell_of, shells)
    if hidden.any():
        count = int(np.count_nonzero(hidden))
        soup.notes.append(f"{count} surface{'s' if count > 1 else ''} inside others, which no camera sees, left out")
        is_left = ~hidden[shell_of]
        soup.kept(is_left)
        number = np.cumsum(~hidden) - 1
        shells = number[shells]
        shell_of = number[shell_of[is_left]]
    _refuse_apart(soup, shell_of, shells)
    return shell_of


def _hidden(soup: Soup, shell_of: Indices, crossing: Indices) -> Flags:
    """Tell of each shell whether it lies inside others and crosses none."""
    count = int(shell_of.max()) + 1
    hidden = np.zeros(count, dtype=bool)
    if count == 1:
        return hidden
    corners = soup.vertices[soup.triangles]
    low, high = _boxes(corners, shell_of, count)
    spanned = np.einsum("ti,ti->t", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    looks_outwards = np.bincount(shell_of, spanned, count) > 0
    for shell in np.setdiff1d(np.arange(count), crossing).tolist():
        around = looks_outwards & (low <= low[shell]).all(axis=1) & (high[shell] <= high).all(axis=1)
        around[shell] = False
        if around.any():
            hidden[shell] = lies_inside(corners[shell_of == shell], corners[around[shell_of]])
    return hidden


def _boxes(corners: npt.NDArray[np.float64], shell_of: Indices, count: int) -> tuple[npt.NDArray[np.float64], ...]:
    low, high = np.full((count, 3), np.inf), np.full((count, 3), -np.inf)
    np.minimum.at(low, shell_of, corners.min(axis=1))
    np.maximum.at(high, shell_of, corners.max(axis=1))
    return low, high


def _refuse_apart(soup: Soup, shell_of: Indices, crossing: Indices) -> None:
    """Refuse shells that neither cross nor come near each other: they are several objects."""
    count = int(shell_of.max()) + 1
    group = _joined(count, crossing)
    if group.max() == 0:
        return
    corners = soup.vertices[soup.triangles]
    gap = _GAP * soup.size
    low, high = _boxes(corners, shell_of, count)
    links = [crossing]
    areas = np.bincount(shell_of, np.linalg.norm(np.cross(*_sides(corners)), axis=1), count)
    for shell in np.argsort(-areas).tolist():
        near = (low <= high[shell] + gap).all(axis=1) & (high >= low[shell] - gap).all(axis=1) & (group != group[shell])
        if not near.any():
            continue
        distance = SurfaceDistance(corners[shell_of == shell])
        for other in np.flatnonzero(near).tolist():
            points = SurfaceDistance(corners[shell_of == other])
            tried = np.concatenate([points.centres, points.pieces[:, 0]])
            if group[other] != group[shell] and float(distance(tried, gap).min()) <= gap:
                links.append(np.array([[shell, other]]))
                group = _joined(count, np.concatenate(links))
    if group.max() > 0:
        raise ObjectError(_apart_in_words(group, shell_of))


def _apart_in_words(group: Indices, shell_of: Indices) -> str:
    faces = np.sort(np.bincount(group[shell_of]))[::-1]
    listed = ", ".join(f"{size:,}" for size in faces[:_SHOWN]) + (" and more" if len(faces) > _SHOWN else "")
    return (
        f"the file holds {len(faces)} objects that do not touch each other, of {listed} faces; an object is one thing: "
        "export one of them alone (in Blender: Mesh > Separate > By Loose Parts takes them apart; then 'Selection "
        "Only' in the exporter), or move them together"
    )


def _sides(corners: npt.NDArray[np.float64]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]:
    return corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]


def _joined(count: int, links: Indices) -> Indices:
    graph = coo_array((np.ones(len(links)), (links[:, 0], links[:, 1])), shape=(count, count))
    return np.asarray(connected_components(graph, directed=False)[1], dtype=np.intp)
