"""The symmetry set of an image: all rotations that could have produced it, whatever they are stored as."""

from collections.abc import Iterator
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt
from numpy.lib.mixins import NDArrayOperatorsMixin

from symsol_annot.annotation.volume import Volume
from symsol_annot.errors import RotationError, SettingsError
from symsol_annot.rotations.nearest import (
    Circles,
    angles_to_arcs,
    find_circles,
    nearest_angles,
    nearest_angles_on_circles,
)
from symsol_annot.rotations.so3 import Angles, Rotations, turned

CONTAINS_RAD = 1e-6  # what rounding a rotation to float32 and multiplying it there can turn it by
_MANY_MEMBERS = 24  # from where the circles are faster than all pairs


class SymmetrySet(NDArrayOperatorsMixin):
    """All rotations R_m2c that draw one image (eq. 2.10).

    It can be used like the array of its members, (k, 3, 3) f8: shape, len, indexing, iteration, `@`, and every function
    of numpy.

    Attributes:
        R_gt: (3, 3) f8, the rotation that the image was drawn at.
        volume: the part of SO(3) that the set fills; None for a set of isolated rotations and circles.
    """

    def __init__(
        self,
        R_gt: Rotations,
        group: Rotations,
        mask: npt.NDArray[np.bool_],
        volume: Volume | None = None,
    ) -> None:
        """Make the set R_gt g, over those g that a mask chooses.

        Args:
            R_gt: (3, 3) the image's rotation.
            group: (G, 3, 3) the symmetries g of the body, identity first.
            mask: (G,) which of them are in the set; the first is.
            volume: what belongs to the set besides, whatever R_gt is, or None.

        Raises:
            RotationError: shapes do not fit, or the set lacks R_gt.
        """
        if np.shape(R_gt) != (3, 3) or np.shape(group)[1:] != (3, 3) or np.shape(mask) != np.shape(group)[:1]:
            raise RotationError(
                "symmetry set: expected shapes (3, 3), (G, 3, 3) and (G,), "
                f"found {np.shape(R_gt)}, {np.shape(group)} and {np.shape(mask)}"
            )
        if not mask[0]:
            raise RotationError("symmetry set: R_gt is not in it; its mask has to begin with True")
        self.R_gt, self.volume = R_gt, volume
        self._group, self._mask = group, mask

    @cached_property
    def members(self) -> Rotations:
        """The (k, 3, 3) f8 isolated rotations and steps of circles, in the group's order; R_gt is the first."""
        return turned(self.R_gt, self.turns)

    @property
    def group(self) -> Rotations:
        """The (G, 3, 3) symmetries g of the body, in model coordinates, identity first."""
        return self._group

    @property
    def turns(self) -> Rotations:
        """The (k, 3, 3) symmetries g of the body whose R_gt g are the members."""
        return self._group[self._mask]

    @property
    def candidates(self) -> Rotations:
        """The (G, 3, 3) rotations R_gt g that draw the image but, perhaps, for its marking."""
        return self.R_gt @ self._group

    @property
    def is_member(self) -> npt.NDArray[np.bool_]:
        """(G,) bool, which of the candidates are members."""
        return self._mask

    @property
    def measure(self) -> float:
        """The number of members; with a volume, beside which they weigh nothing, its share of all rotations."""
        return float(len(self.turns)) if self.volume is None else self.volume.measure

    def contains(self, R_m2c: Rotations, tolerance_rad: float = CONTAINS_RAD) -> npt.NDArray[np.bool_]:
        """Tell which rotations are in the set, up to a tolerance.

        Args:
            R_m2c: (n, 3, 3).
            tolerance_rad: how far from the set a rotation may be.

        Returns:
            (n,) bool.
        """
        return np.asarray(self.distance(R_m2c) <= tolerance_rad)

    def distance(self, R_m2c: Rotations) -> Angles:
        """Return the angles (n,) in rad from rotations (n, 3, 3) to the nearest member or, if nearer, to the volume.

        They are 0 inside the volume, and outside of it as exact as `Volume.distance`.
        """
        circles = self._circles if len(self.turns) > _MANY_MEMBERS else None
        if circles is None:
            angles = nearest_angles(R_m2c, self.members)
        else:
            angles = nearest_angles_on_circles(circles, self.R_gt, self._mask, R_m2c)
        return angles if self.volume is None else np.minimum(angles, self.volume.distance(R_m2c))

    def distance_to_arcs(self, R_m2c: Rotations, to_members: Angles | None = None) -> Angles:
        """Return the angles (n,) in rad from rotations (n, 3, 3) to the continuous set that the members stand for.

        Neighbouring members on a circle are joined by an arc; a set without circles is its members and its volume.

        Args:
            R_m2c: (n, 3, 3).
            to_members: (n,) what `distance` returns, where it is known already.
        """
        if to_members is None:
            to_members = self.distance(R_m2c)
        if self._circles is None:
            return to_members
        return angles_to_arcs(self._circles, self.R_gt, self._mask, R_m2c, to_members)

    def sample(self, n: int, rng: np.random.Generator) -> Rotations:
        """Draw (n, 3, 3) rotations of the set, each member as likely; with a volume, uniformly from that.

        Raises:
            SettingsError: n is negative.
        """
        if n < 0:
            raise SettingsError(f"sample: expected 0 or more rotations, found {n}")
        if self.volume is None:
            return self.members[rng.integers(len(self.members), size=n)]
        return self.volume.sample(n, rng)

    @property
    def along_arcs(self) -> Rotations:
        """The (k, 3, 3) members circle by circle, each from where its longest gap ends; others in the group's order."""
        if self._circles is None:
            return self.members
        found = [self._circles.isolated_index[self._mask[self._circles.isolated_index]]]
        for circle in self._circles.index:
            steps = np.flatnonzero(self._mask[circle])
            if len(steps):
                gaps = np.diff(steps, prepend=steps[-1] - len(circle))
                found.append(circle[np.roll(steps, -int(np.argmax(gaps)))])
        return turned(self.R_gt, self._group[np.concatenate(found)])

    @cached_property
    def _circles(self) -> Circles | None:
        """The circles that the group discretises; None for a group of isolated rotations."""
        return circles_of(self._group)

    def _as_array(self) -> Rotations:
        """Return the members where they are the whole set.

        Raises:
            RotationError: the set has a volume.
        """
        if self.volume is not None:
            raise RotationError(
                "this symmetry set has a volume, so that no array lists its rotations; `.sample(n, rng)` draws n of "
                "them, and `.members` are its isolated ones"
            )
        return self.members

    @property
    def shape(self) -> tuple[int, ...]:
        """(k, 3, 3)."""
        return self._as_array().shape

    @property
    def ndim(self) -> int:
        """How many axes the array of members has: 3."""
        return self._as_array().ndim

    @property
    def dtype(self) -> np.dtype[np.float64]:
        """The members' type, float64."""
        return self._as_array().dtype

    def __len__(self) -> int:
        return len(self._as_array())

    def __getitem__(self, index: Any) -> Any:
        return self._as_array()[index]

    def __iter__(self) -> Iterator[Rotations]:
        return iter(self._as_array())

    def __repr__(self) -> str:
        kind = f"{len(self.turns)} rotations" if self.volume is None else f"{self.measure:.2%} of all rotations"
        return f"<SymmetrySet: {kind}>"

    def __array__(self, dtype: npt.DTypeLike = None, copy: bool | None = None) -> npt.NDArray[Any]:  # noqa: FBT001
        members = self._as_array()
        return np.array(members, dtype=dtype) if copy else np.asarray(members, dtype=dtype)

    def __array_ufunc__(self, ufunc: np.ufunc, method: str, *inputs: Any, **kwargs: Any) -> Any:
        arrays = (value._as_array() if isinstance(value, SymmetrySet) else value for value in inputs)  # noqa: SLF001
        return getattr(ufunc, method)(*arrays, **kwargs)

    def __dlpack__(self, **options: Any) -> Any:
        return self._as_array().__dlpack__(**options)

    def __dlpack_device__(self) -> Any:
        return self._as_array().__dlpack_device__()

    if not TYPE_CHECKING:  # who checks types is better served by `.members`

        def __getattr__(self, name: str) -> Any:
            """Return what an array has by that name, like `mean` or `reshape`."""
            if name.startswith("_") or not hasattr(np.ndarray, name):
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            return getattr(self._as_array(), name)


def circles_of(group: Rotations) -> Circles | None:
    """Return the circles of a group (G, 3, 3), as `find_circles`; those of a few groups are remembered."""
    return _circles_of(np.ascontiguousarray(group, dtype=np.float64).tobytes())


@lru_cache(maxsize=8)
def _circles_of(data: bytes) -> Circles | None:
    return find_circles(np.frombuffer(data).reshape(-1, 3, 3))
