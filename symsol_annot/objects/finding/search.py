"""Which of the candidates are symmetries: a verified one brings its subgroup, a refuted one its coset."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from symsol_annot.objects.finding.surface import Indices
from symsol_annot.rotations.so3 import Rotations

Passes = Callable[[Rotations], tuple[bool, float]]


@dataclass(frozen=True, eq=False)
class SearchResult:
    """What a search found.

    Attributes:
        elements: (n, 3, 3) the candidates that are symmetries, the identity first.
        refuted: (m, 3, 3) candidates that were measured and are none.
        refuted_by: (m,) how far they carry a point at least.
        generators: (k, 3, 3) the symmetries that were measured; the others are products of them.
    """

    elements: Rotations
    refuted: Rotations
    refuted_by: npt.NDArray[np.float64]
    generators: Rotations


def search_group(candidates: Rotations, passes: Passes, same: float) -> SearchResult:
    """Return the group that the candidates which pass are.

    Args:
        candidates: (n, 3, 3) the identity first, the smallest turns first.
        passes: tells whether a rotation is a symmetry, and how far it carries a point.
        same: Frobenius distance within which a product is a candidate.
    """
    tree = cKDTree(candidates.reshape(-1, 9))

    def places(rotations: Rotations) -> Indices:
        """Return the candidates that rotations are; those that are none are left out."""
        distance, index = tree.query(rotations.reshape(-1, 9), distance_upper_bound=same)
        return np.asarray(index[np.isfinite(distance)], dtype=np.intp)

    is_member = np.zeros(len(candidates), dtype=bool)
    is_member[0] = True
    is_open = ~is_member
    generators: list[int] = []
    refuted: list[int] = []
    refuted_by: list[float] = []
    for index in range(1, len(candidates)):
        if not is_open[index]:
            continue
        is_symmetry, off = passes(candidates[index])
        if is_symmetry:
            generators.append(index)
            is_member = _generated(candidates, is_member, generators, places)
            is_open &= ~is_member
        else:
            refuted.append(index)
            refuted_by.append(off)
            members = candidates[is_member]
            is_open[places(candidates[index] @ members)] = False
            is_open[places(members @ candidates[index])] = False
            is_open[index] = False
    chosen = np.array(generators, dtype=np.intp)
    failed = np.array(refuted, dtype=np.intp)
    return SearchResult(candidates[is_member], candidates[failed], np.array(refuted_by), candidates[chosen])


def _generated(
    candidates: Rotations,
    is_member: npt.NDArray[np.bool_],
    generators: list[int],
    places: Callable[[Rotations], Indices],
) -> npt.NDArray[np.bool_]:
    """Return the members of the group that a subgroup and a new element, the last of the generators, make."""
    subgroup = candidates[is_member]
    is_member = is_member.copy()
    waiting = [generators[-1]]
    while waiting:
        representative = waiting.pop()
        if is_member[representative]:
            continue
        is_member[representative] = True
        is_member[places(candidates[representative] @ subgroup)] = True
        waiting += places(candidates[generators] @ candidates[representative]).tolist()
    return is_member
