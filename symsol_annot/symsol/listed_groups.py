"""The group that lists of rotations stand for: each list is R g with g of one group, whatever its order.

The rotations come from a source that says nothing of their convention, in float32, with duplicates.
"""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.spatial import cKDTree

from symsol_annot.errors import DataError
from symsol_annot.rotations.so3 import Rotations, angle_between, nearest_rotations

SAME_RAD = 1e-4  # the source's float32 is off by 1e-6; neighbours on its circles are 0.0175 apart


@dataclass(frozen=True, eq=False)
class ListedGroup:
    """How an object's lists of rotations are to be read.

    Attributes:
        group: (G, 3, 3) symmetries, identity first, each of them once; the identity alone where no sets are given.
        element: (m,) which of them each listed rotation belongs to.
        is_transposed: whether the source's matrices are to be transposed, so that symmetries act on the right.
    """

    group: Rotations
    element: npt.NDArray[np.intp]
    is_transposed: bool

    @property
    def duplicates(self) -> int:
        """How many rotations of a list are another one of it again."""
        return len(self.element) - len(self.group)

    def off_rad(self, listed: Rotations) -> npt.NDArray[np.float64]:
        """Return how far (n,) the rotations of each list (n, m, 3, 3) are from its R g at most; inf for another set."""
        relative = _relative(listed, is_transposed=self.is_transposed)
        off = angle_between(relative, self.group[self.element]).max(axis=1)
        for row in np.flatnonzero(~(off <= SAME_RAD)):  # in another order, perhaps
            off[row] = self._off_as_a_set(relative[row])
        return np.asarray(off)

    def _off_as_a_set(self, relative: Rotations) -> float:
        """Return how far (m, 3, 3) elements are from the group's, inf where they are not all of it."""
        if not np.isfinite(relative).all():
            return np.inf
        group = self.group
        nearest = cKDTree(group.reshape(-1, 9)).query(relative.reshape(-1, 9))[1]
        is_all = len(np.unique(nearest)) == len(group)
        return float(angle_between(relative, group[nearest]).max()) if is_all else np.inf


def listed_group(listed: Rotations, what: str) -> ListedGroup:
    """Find the group whose elements take the first rotation of every image to the others.

    Args:
        listed: (n, m, 3, 3) the rotations of some images, as the source has them.
        what: how an error message names them.

    Raises:
        DataError: there is no such group.
    """
    for is_transposed in (False, True):
        relative = _relative(listed, is_transposed=is_transposed)
        if angle_between(relative, relative[:1]).max() <= SAME_RAD:
            break
    else:
        raise DataError(
            f"{what}: the lists of the first {len(listed)} images are not R g, nor g R, with g of one group"
        )
    mean = nearest_rotations(relative.mean(axis=0))
    first_same = np.argmax(angle_between(mean[:, None], mean[None]) <= SAME_RAD, axis=1)
    is_first = first_same == np.arange(len(mean))
    group = mean[is_first]
    group[0] = np.eye(3)
    products = (group[:, None] @ group[None]).reshape(-1, 9)
    if cKDTree(group.reshape(-1, 9)).query(products)[0].max() > SAME_RAD:
        raise DataError(f"{what}: the {len(group)} different rotations of a list make no group: a product is not in it")
    return ListedGroup(group, (np.cumsum(is_first) - 1)[first_same], is_transposed)


def _relative(listed: Rotations, *, is_transposed: bool) -> Rotations:
    """Return R_0^-1 R_j (n, m, 3, 3) of lists of rotations R_j, transposed first or not."""
    R = np.swapaxes(listed, -1, -2) if is_transposed else listed
    with np.errstate(invalid="ignore", over="ignore"):  # what is not finite is found to be no member
        relative: Rotations = np.swapaxes(R[:, :1], -1, -2) @ R
    return relative
