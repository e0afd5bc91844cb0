"""Finite groups of rotations: the kinds that an object can name, their elements and cosets.

A group is a (G, 3, 3) float64 array of rotations that act on column vectors, the identity first.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
import numpy.typing as npt

from symsol_annot.errors import RotationError
from symsol_annot.rotations.so3 import Rotations, rotations_about

Z_AXIS = (0.0, 0.0, 1.0)
_SAME_ROTATION = 1e-6  # rotations whose entries differ by less, altogether, are the same element of a group
_PRODUCTS = 1 << 22  # of rotations with elements, held at once

GroupParameter: TypeAlias = Literal["order", "axis"]


@dataclass(frozen=True)
class GroupKind:
    """One kind of group, as an object.toml names it.

    Attributes:
        name: the value of `kind`.
        make: gives the group (G, 3, 3) from the parameters, by their names.
        needs: the parameters that have to be given.
        takes: those that may be given.
    """

    name: str
    make: Callable[..., Rotations]
    needs: tuple[GroupParameter, ...] = ()
    takes: tuple[GroupParameter, ...] = ()


def cyclic_group(order: int, axis: npt.ArrayLike = Z_AXIS) -> Rotations:
    """Return the `order` rotations about an axis by multiples of a full turn / order, identity first.

    The end point of the circle is the start point and counts once: order 360 has a step of exactly 1 degree.
    """
    return rotations_about(axis, 2.0 * np.pi * np.arange(order) / order)


def dihedral_group(order: int) -> Rotations:
    """Return the 2 x `order` rotations of a prism about z: the cyclic ones, then each after a half turn about x."""
    turns = cyclic_group(order)
    flip_about_x = np.diag([1.0, -1.0, -1.0])
    return np.concatenate([turns, turns @ flip_about_x])


def tetrahedral_group() -> Rotations:
    """Return the 12 rotations of the tetrahedron on the alternating corners of a cube, identity first."""
    return _signed_permutations(even_only=True)


def octahedral_group() -> Rotations:
    """Return the 24 rotations of the cube with faces across the axes, identity first."""
    return _signed_permutations(even_only=False)


def icosahedral_group() -> Rotations:
    """Return the 60 rotations of the icosahedron with corners (0, ±1, ±phi) and cyclic shifts, identity first."""
    phi = (1.0 + np.sqrt(5.0)) / 2.0
    fifths = cyclic_group(5, axis=(0.0, 1.0, phi))
    return (fifths[:, None] @ tetrahedral_group()[None]).reshape(-1, 3, 3)


def _signed_permutations(*, even_only: bool) -> Rotations:
    """Return the rotations whose entries are 0 and ±1; `even_only` keeps the cyclic shifts of the axes."""
    shifts = [(0, 1, 2), (1, 2, 0), (2, 0, 1)]
    swaps = [] if even_only else [(1, 0, 2), (0, 2, 1), (2, 1, 0)]
    found = []
    for permutation in shifts + swaps:
        for signs in np.ndindex(2, 2, 2):
            R = np.eye(3)[list(permutation)] * (1.0 - 2.0 * np.array(signs))[:, None]
            if np.linalg.det(R) > 0:
                found.append(R)
    return np.stack(found)


ALL_ROTATIONS = "so3"  # the kind of what no list holds
CIRCLE_STEPS = 360  # that stand for a circle, of exactly 1 degree
GROUP_KINDS = {
    kind.name: kind
    for kind in (
        GroupKind("cyclic", cyclic_group, needs=("order",), takes=("axis",)),
        GroupKind("dihedral", dihedral_group, needs=("order",)),
        GroupKind("tetrahedral", tetrahedral_group),
        GroupKind("octahedral", octahedral_group),
        GroupKind("icosahedral", icosahedral_group),
    )
}


def nearest_element(group: Rotations, R: Rotations) -> npt.NDArray[np.intp]:
    """Return the index in `group` (G, 3, 3) of each rotation in R (..., 3, 3).

    Raises:
        RotationError: a rotation is not an element of the group.
    """
    elements, asked = group.reshape(-1, 9), R.reshape(-1, 9)
    step = max(_PRODUCTS // len(group), 1)
    parts = [asked[start : start + step] for start in range(0, max(1, len(asked)), step)]
    index = np.concatenate([(part @ elements.T).argmax(axis=1) for part in parts])  # the largest tr(R^T g) is nearest
    is_other = np.linalg.norm(asked - elements[index], axis=1) > _SAME_ROTATION
    if is_other.any():
        raise RotationError(
            f"{np.count_nonzero(is_other)} of {len(asked)} rotations "
            f"are not among the {len(group)} elements of the group; the group is not closed or the wrong one"
        )
    return index.reshape(R.shape[:-2])


def left_cosets(group: Rotations, subgroup: Rotations) -> npt.NDArray[np.intp]:
    """Partition a group into the left cosets g H of a subgroup H.

    Args:
        group: (G, 3, 3) the group, identity first.
        subgroup: (H, 3, 3) elements of the group that form a group, identity first.

    Returns:
        (G / H, H) indices into `group`, one coset per row; row 0 is the subgroup itself.

    Raises:
        RotationError: the subgroup's products leave the group.
    """
    unseen, cosets = np.ones(len(group), dtype=bool), []
    for first in range(len(group)):
        if unseen[first]:
            members = nearest_element(group, group[first] @ subgroup)
            unseen[members] = False
            cosets.append(members)
    return np.stack(cosets)
