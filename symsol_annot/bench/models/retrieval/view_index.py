"""Finds the views of known rotation that look most like an image, turned about the camera's axis or not."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.bench.models.retrieval.embedding import Embeddings
from symsol_annot.rotations.so3 import Rotations, rotations_about

QUARTER_TURNS = 4
_IMAGES_AT_ONCE = 64


@dataclass(frozen=True, eq=False)
class NearViews:
    """The k views nearest to each of n images, the nearest first.

    Attributes:
        rotation: (n, k, 3, 3), R_m2c at which the image would look as the view does.
        distance: (n, k), the Euclidean distance of the embeddings.
    """

    rotation: Rotations
    distance: npt.NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.distance)


class ViewIndex:
    """Views of known rotation, searched by their embeddings.

    The light stands on the camera's axis, so an image at R, turned by 90 degrees, is what is seen at Rz(90) R: where
    the image, turned t times, looks like the view of R_i, the image is one of Rz(90)^-t R_i. So each view serves four
    times.
    """

    def __init__(self, embeddings: Embeddings, rotation: Rotations, turns: int = QUARTER_TURNS) -> None:
        """Take the views.

        Args:
            embeddings: (N, s, s, 3).
            rotation: (N, 3, 3), R_m2c.
            turns: how many quarter turns of an image are looked for; 1 where the light does not stand on the axis.
        """
        flat = embeddings.reshape(len(embeddings), -1)
        self._centre = flat.mean(axis=0)  # products of small numbers lose less
        self._views = flat - self._centre
        self._squares = np.einsum("ij,ij->i", self._views, self._views)
        self._rotation, self._turns = rotation, turns
        self._turned_back = rotations_about((0, 0, 1), -np.pi / 2.0 * np.arange(turns))

    def __len__(self) -> int:
        return len(self._views)

    def nearest(self, images: Embeddings, k: int, *, left_out: npt.NDArray[np.int64] | None = None) -> NearViews:
        """Return the views nearest to images.

        Args:
            images: (n, s, s, 3), their embeddings.
            k: how many; fewer where there are not so many.
            left_out: (n,) for each image the view that is not looked at, in any turn.
        """
        there = self._turns * (len(self) - (left_out is not None))
        k = min(k, there)
        rotation, distance = np.empty((len(images), k, 3, 3)), np.empty((len(images), k))
        for start in range(0, len(images), _IMAGES_AT_ONCE):
            rows = slice(start, start + _IMAGES_AT_ONCE)
            absent = None if left_out is None else left_out[rows]
            rotation[rows], distance[rows] = self._nearest_of_block(images[rows], k, absent)
        return NearViews(rotation, distance)

    def _nearest_of_block(
        self, images: Embeddings, k: int, left_out: npt.NDArray[np.int64] | None
    ) -> tuple[Rotations, npt.NDArray[np.float64]]:
        turned = [
            np.rot90(images, -turn, (1, 2)).reshape(len(images), -1) - self._centre for turn in range(self._turns)
        ]
        scores = np.empty((len(images), self._turns, len(self)), dtype=np.float32)  # squared distance but for |image|^2
        for number, flat in enumerate(turned):
            np.matmul(flat, self._views.T, out=scores[:, number])
        scores *= -2.0
        scores += self._squares
        if left_out is not None:
            scores[np.arange(len(images)), :, left_out] = np.inf
        flat_scores = scores.reshape(len(images), -1)
        found = np.argpartition(flat_scores, k - 1, axis=1)[:, :k]
        turn, view = np.divmod(found, len(self))
        asked = np.stack(turned, axis=1)
        distance = np.empty(found.shape)
        for row, (turns, views) in enumerate(zip(turn, view, strict=True)):
            distance[row] = np.linalg.norm(asked[row, turns] - self._views[views], axis=1)
        order = np.argsort(distance, axis=1, kind="stable")
        turn, view = (np.take_along_axis(part, order, axis=1) for part in (turn, view))
        rotation: Rotations = self._turned_back[turn] @ self._rotation[view]
        return rotation, np.take_along_axis(distance, order, axis=1)
