"""Is a list of rotations a group? Decided exactly, by generators, in about |G| steps for each of a few of them."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import ORTHONORMAL_TOLERANCE, Rotations, rotation_deviation

Indices = npt.NDArray[np.intp]
_PAIRS_AT_ONCE = 2**21
_APART = 1e-3  # the least Frobenius distance of two elements; those of the largest group are 2.5e-3 apart


@dataclass(frozen=True, eq=False)
class GroupCheck:
    """What was found about a list of rotations.

    Attributes:
        faults: why it is no group, in words; none where it is one.
        generators: (k,) indices of elements whose products are all of it; empty where it is none.
    """

    faults: tuple[str, ...]
    generators: Indices


def check_group(group: Rotations, tolerance: float) -> GroupCheck:
    """Check that (G, 3, 3) are different rotations, the identity first, and closed under multiplication.

    A finite set that holds the identity, and is mapped into itself by left multiplication with each of some elements
    whose products reach all of it, is the group that they generate.

    Args:
        group: the list.
        tolerance: how far a product may be from an element, in the Frobenius norm.
    """
    return _checked(np.ascontiguousarray(group, dtype=np.float64).tobytes(), tolerance)


def right_products(group: Rotations, element: int) -> Indices:
    """Return for each element g of a group (G, 3, 3) the index (G,) of g h, for h the one of index `element`."""
    return _nearest(group @ group[element], group)[0]


@lru_cache(maxsize=64)
def _checked(data: bytes, tolerance: float) -> GroupCheck:
    group = np.frombuffer(data).reshape(-1, 3, 3)
    faults = faults_of_elements(group)
    if faults:
        return GroupCheck(faults, np.zeros(0, dtype=np.intp))
    generators: list[int] = []
    is_reached = np.zeros(len(group), dtype=bool)
    is_reached[0] = True
    steps: list[Indices] = []  # for each generator, where left multiplication takes each element
    while not is_reached.all():
        generators.append(int(np.argmin(is_reached)))
        step, off = _nearest(group[generators[-1]] @ group, group)
        if off.max() > tolerance:
            fault = f"element {generators[-1]} times element {int(np.argmax(off))} is not in it, so it is no group"
            return GroupCheck((fault,), np.zeros(0, dtype=np.intp))
        steps.append(step)
        _reach(is_reached, steps)
    return GroupCheck((), np.array(generators, dtype=np.intp))


def faults_of_elements(group: Rotations) -> tuple[str, ...]:
    """Return why (G, 3, 3) are not different rotations, the identity first, in words; none where they are."""
    bad = ~(rotation_deviation(group) <= ORTHONORMAL_TOLERANCE)
    if bad.any():
        return (f"element {int(np.argmax(bad))} is no rotation",)
    if np.abs(group[0] - np.eye(3)).max() > ORTHONORMAL_TOLERANCE:
        return ("element 0 is not the identity",)
    is_twice = _is_twice(group)
    return (f"element {int(np.argmax(is_twice))} is there twice",) if is_twice.any() else ()


def _is_twice(group: Rotations) -> npt.NDArray[np.bool_]:
    """Tell of each element whether an earlier one is the same, up to what no group of this size can have."""
    flat = group.reshape(-1, 9)
    step = max(1, _PAIRS_AT_ONCE // len(group))
    parts = []
    for start in range(0, len(flat), step):
        is_same = flat[start : start + step] @ flat.T > 3.0 - _APART**2 / 2  # |A - B|^2 = 6 - 2 <A, B>
        parts.append(np.argmax(is_same, axis=1) < np.arange(start, start + len(is_same)))
    return np.concatenate(parts)


def _reach(is_reached: npt.NDArray[np.bool_], steps: list[Indices]) -> None:
    """Mark all that products of the generators reach from what is marked."""
    frontier = np.flatnonzero(is_reached)
    while len(frontier):
        reached = np.unique(np.concatenate([step[frontier] for step in steps]))
        frontier = reached[~is_reached[reached]]
        is_reached[frontier] = True


def _nearest(rotations: Rotations, group: Rotations) -> tuple[Indices, npt.NDArray[np.float64]]:
    """Return the first nearest element (n,) of each of (n, 3, 3) rotations, and how far off it is (Frobenius)."""
    flat, columns = rotations.reshape(-1, 9), group.reshape(-1, 9).T
    step = max(1, _PAIRS_AT_ONCE // len(group))
    parts = [np.argmax(flat[start : start + step] @ columns, axis=1) for start in range(0, len(flat), step)]
    index = np.concatenate(parts)
    return index, np.sqrt(np.square(rotations - group[index]).sum(axis=(1, 2)))
