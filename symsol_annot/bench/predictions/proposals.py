"""The rotations that a method proposes for one image, as pictures show them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from symsol_annot.rotations.so3 import Rotations

MAX_ROTATIONS = 1000  # of one image


@dataclass(frozen=True, eq=False)
class Predicted:
    """What is predicted for one image.

    Attributes:
        rotations: (n, 3, 3) R_m2c, the heaviest first.
        weights: (n,) in (0, 1], relative to the heaviest.
        left_out: how many more there are.
    """

    rotations: Rotations
    weights: npt.NDArray[np.float64]
    left_out: int


def heaviest(rotations: Rotations, weights: npt.NDArray[np.float64], left_out: int = 0) -> Predicted:
    """Return the rotations with the greatest weights, 1,000 at most.

    Args:
        rotations: (n, 3, 3) R_m2c.
        weights: (n,) at least 0, in any unit.
        left_out: how many rotations were left out before.
    """
    order = np.argsort(-weights, kind="stable")[:MAX_ROTATIONS]
    largest = weights.max(initial=0.0)
    relative = weights[order] / largest if largest else weights[order]
    return Predicted(rotations[order], relative, left_out + len(weights) - len(order))
