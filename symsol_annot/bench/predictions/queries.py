"""The rotations at which a classifier is asked about an image: its candidates among decoys, shuffled.

A file that said yes to whatever it is asked would find every member of every symmetry set. So the candidates R_gt g
come together with 8 cosets R' g at random R', which a fair classifier claims as rarely as any other rotation.
"""

import hashlib
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import Rotations, rotations_sha256, unit_cube_to_rotation

DECOY_COSETS = 8
QUERIES_VERSION = 1


def query_count(group_order: int) -> int:
    """Return how many queries an image has."""
    return (1 + DECOY_COSETS) * group_order


def group_sha256(symmetry_group: Rotations) -> str:
    """Return the digest of a group (G, 3, 3) in its order, as `so3.rotations_sha256`."""
    return rotations_sha256([symmetry_group])


@dataclass(frozen=True, eq=False)
class Queries:
    """The queries of a split's images, which follow from its fingerprint and an image's index alone.

    SHAKE-256 of "symsol-annot queries 1/FINGERPRINT/INDEX" gives a stream of little-endian 64-bit integers. The
    first 24, divided by 2^64, are the points of the unit cube of the 8 decoys R' (`so3.unit_cube_to_rotation`).
    The next Q, sorted, give the order: query q asks number order[q] of the list R_gt g, R'_1 g, .., R'_8 g.

    Attributes:
        fingerprint: of the split.
        symmetry_group: (G, 3, 3).
    """

    fingerprint: str
    symmetry_group: Rotations

    def __len__(self) -> int:
        return query_count(len(self.symmetry_group))

    def rotations(self, image_index: int, R_gt: Rotations) -> Rotations:
        """Return an image's queries (Q, 3, 3), R_m2c, given the rotation (3, 3) that it was drawn at."""
        decoys, order = self._draw(image_index)
        cosets = np.concatenate([R_gt[None], decoys])[:, None] @ self.symmetry_group
        return cosets.reshape(-1, 3, 3)[order]

    def decoys(self, image_index: int) -> Rotations:
        """Return the rotations R'_j g (8, G, 3, 3) among an image's queries."""
        return self._draw(image_index)[0][:, None] @ self.symmetry_group

    def unshuffle(self, image_index: int, probability: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Return the probabilities (Q,) at an image's queries as (9, G): row 0 at R_gt g, the others at the decoys."""
        _, order = self._draw(image_index)
        in_order = np.empty(len(self), dtype=probability.dtype)
        in_order[order] = probability
        return in_order.reshape(1 + DECOY_COSETS, -1)

    def shuffle(self, image_index: int, in_order: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """Undo `unshuffle`: from (9, G) to the order (Q,) in which the image's queries are asked."""
        _, order = self._draw(image_index)
        return in_order.reshape(-1)[order]

    def _draw(self, image_index: int) -> tuple[Rotations, npt.NDArray[np.intp]]:
        key = f"symsol-annot queries {QUERIES_VERSION}/{self.fingerprint}/{image_index}"
        stream = hashlib.shake_256(key.encode()).digest(8 * (3 * DECOY_COSETS + len(self)))
        numbers = np.frombuffer(stream, dtype="<u8")
        unit_cube = numbers[: 3 * DECOY_COSETS].reshape(-1, 3) / 2.0**64
        return unit_cube_to_rotation(unit_cube), np.argsort(numbers[3 * DECOY_COSETS :], kind="stable")
