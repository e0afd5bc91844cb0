"""What is known of a split's images, without the images."""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from symsol_annot.annotation.symmetry_set import SymmetrySet, circles_of
from symsol_annot.annotation.volume import Volume
from symsol_annot.rotations.nearest import Circles
from symsol_annot.rotations.so3 import Rotations, angle_between

Indices = npt.NDArray[np.intp]

_ROWS_AT_ONCE = 512  # whose candidates are looked for in a volume together


@dataclass(frozen=True, eq=False)
class Labels:
    """What is known of a split's N images, without the images.

    Attributes:
        rotation: (N, 3, 3) f8, R_m2c.
        symmetry_mask: (N, G) bool over `symmetry_group`.
        symmetry_group: (G, 3, 3) f8, the body's symmetries, identity first.
        marking_pixels: (N,) f4, as `Sample.marking_pixels`.
        marking_visible: (N,) bool, whether that is at least the object's tolerance; False in an imported set, which has
            sets for bodies without marking alone.
        part_pixels: (N, P) f4, as `Sample.part_pixels`; None where that is.
        volume: (N,) i4, which of `volumes` belongs to each image's set besides, -1 for none; None where no set of the
            object can have one.
        volumes: the distinct ones.
    """

    rotation: Rotations
    symmetry_mask: npt.NDArray[np.bool_]
    symmetry_group: Rotations
    marking_pixels: npt.NDArray[np.float32]
    marking_visible: npt.NDArray[np.bool_]
    part_pixels: npt.NDArray[np.float32] | None = None
    volume: npt.NDArray[np.int32] | None = None
    volumes: tuple[Volume, ...] = ()

    def __len__(self) -> int:
        return len(self.rotation)

    def symmetry_set(self, row: int) -> SymmetrySet:
        """Return the set of all rotations R_m2c that draw image `row`."""
        return SymmetrySet(self.rotation[row], self.symmetry_group, self.symmetry_mask[row], self.volume_of(row))

    def volume_of(self, row: int) -> Volume | None:
        """Return the volume of the symmetry set of image `row`; None for a set without."""
        index = -1 if self.volume is None else int(self.volume[row])
        return None if index < 0 else self.volumes[index]

    def candidates(self, row: int) -> Rotations:
        """Return the rotations (G, 3, 3) that draw image `row` but, perhaps, for its marking."""
        return self.symmetry_set(row).candidates

    def members(self, row: int) -> Rotations:
        """Return the members (k, 3, 3) of the symmetry set of image `row`; k is in `set_sizes`."""
        return self.symmetry_set(row).members

    @cached_property
    def set_sizes(self) -> npt.NDArray[np.int64]:
        """(N,) how many members the symmetry set of each image has."""
        return self.symmetry_mask.sum(axis=1)

    @cached_property
    def circles(self) -> Circles | None:
        """The circles that the body's group discretises; None for a group of isolated rotations."""
        return circles_of(self.symmetry_group)

    def rejected_beyond(self, angle_rad: float) -> npt.NDArray[np.bool_]:
        """Tell which candidates (N, G) are farther than an angle from every rotation of the image's set.

        They show the body as the image does and the marking elsewhere; those nearer are hardly told from a member.
        """
        group = self.symmetry_group
        near = np.stack([angle_between(g, group) <= angle_rad for g in group])
        rejected = ~(self.symmetry_mask.astype(np.float32) @ near.astype(np.float32) > 0)
        for volume, row, g in self._of_volumes(rejected):
            rejected[row, g] = ~volume.within(self.rotation[row] @ group[g], angle_rad)
        return rejected

    def _of_volumes(self, mask: npt.NDArray[np.bool_]) -> Iterator[tuple[Volume, Indices, Indices]]:
        """Yield rows and candidates that a mask (N, G) chooses in images whose set has a volume, with that volume."""
        for number, volume in enumerate(self.volumes):
            rows = np.flatnonzero(self.volume == number)
            for start in range(0, len(rows), _ROWS_AT_ONCE):
                some = rows[start : start + _ROWS_AT_ONCE]
                row, g = np.nonzero(mask[some])
                yield volume, some[row], g
