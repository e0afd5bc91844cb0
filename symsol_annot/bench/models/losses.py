"""The losses, one pure function per equation; `loss_tables` has what recipes, learners and pictures know of each.

A batch's loss is the mean over its images (eq. 4.2). Of hypotheses there are two: an embedded loss of each of them
(section 4.2.1), and a meta loss over all (section 4.1.2), which assigns the truth to some of them. Such as

    relaxed_winner_takes_all(von_mises_loss(hypotheses, R_gt[:, None])).mean()

The functions work on torch's tensors; torch itself is imported by those that need more, as recipes are read without.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from symsol_annot.errors import SettingsError

if TYPE_CHECKING:
    from torch import Tensor

CONCENTRATION = 4.0  # of the von Mises loss, its calligraphic K
EPSILON = 0.05  # of RWTA
_LARGEST_SINE = 1.0 - 1e-6  # of half the angle; the arcsine's slope is infinite at 1

# Embedded losses: of rotations R_p and R_gt (..., 3, 3), broadcast against each other, to (...)


def cyclic_cosine_loss(R_p: Tensor, R_gt: Tensor) -> Tensor:
    """Return 1 - cos(angle) (eq. 4.21), in [0, 2].

    Args:
        R_p: (..., 3, 3) predicted rotations.
        R_gt: (..., 3, 3) true ones; broadcasts against R_p.

    Returns:
        (...) losses.
    """
    return 1.0 - _cosine(R_p, R_gt)


def von_mises_loss(R_p: Tensor, R_gt: Tensor, concentration: float = CONCENTRATION) -> Tensor:
    """Return 1 - exp(K (cos(angle) - 1)) (eq. 4.22), in [0, 1).

    Args:
        R_p: (..., 3, 3) predicted rotations.
        R_gt: (..., 3, 3) true ones; broadcasts against R_p.
        concentration: K.

    Returns:
        (...) losses.
    """
    return -(concentration * (_cosine(R_p, R_gt) - 1.0)).expm1()


def geodesic_loss(R_p: Tensor, R_gt: Tensor) -> Tensor:
    """Return the angle (eq. 4.20), by the arcsine of eq. 5.6, in [0, pi); constant within 0.0029 rad of pi.

    The arccosine's gradient is infinite at 0 and at pi, the arcsine's at pi alone.

    Args:
        R_p: (..., 3, 3) predicted rotations.
        R_gt: (..., 3, 3) true ones; broadcasts against R_p.

    Returns:
        (...) angles in rad.
    """
    import roma  # noqa: PLC0415 - needs torch

    angles: Tensor = roma.rotmat_geodesic_distance(R_p, R_gt, clamping=_LARGEST_SINE)
    return angles


def _cosine(R_p: Tensor, R_gt: Tensor) -> Tensor:
    """Return the cosine of the angle between rotations, (Tr(R_p R_gt^T) - 1) / 2 (eq. A.3)."""
    return ((R_p * R_gt).sum(dim=(-2, -1)) - 1.0) / 2.0


# Meta losses: of the embedded losses (..., M) of an image's hypotheses, to (...)


def winner_takes_all(losses: Tensor) -> Tensor:
    """Return the least loss (...) of an image's hypotheses (..., M) (eq. 4.15)."""
    return evolving_winner_takes_all(losses, 1)


def relaxed_winner_takes_all(losses: Tensor, epsilon: float = EPSILON) -> Tensor:
    """Return the relaxed loss (eq. 4.16): 1 - epsilon of the winner, epsilon / (M - 1) of each other hypothesis.

    Args:
        losses: (..., M) of an image's hypotheses.
        epsilon: what all but the winner share.

    Returns:
        (...) losses.

    Raises:
        SettingsError: M is 1, so that there is no other hypothesis, or epsilon is outside [0, 1].
    """
    M = losses.shape[-1]
    if M < 2:
        raise SettingsError(f"expected 2 hypotheses or more for RWTA, found {M}")
    if not 0.0 <= epsilon <= 1.0:
        raise SettingsError(f"expected an epsilon in [0, 1] for RWTA, found {epsilon}")
    winner_term = (1.0 - epsilon * M / (M - 1)) * winner_takes_all(losses)
    return winner_term + epsilon / (M - 1) * losses.sum(dim=-1)


def evolving_winner_takes_all(losses: Tensor, k: int) -> Tensor:
    """Return the sum (...) of the k least losses of an image's hypotheses (..., M) (eq. 4.17).

    `winners_in_epoch` gives the thesis's k.

    Raises:
        SettingsError: k is outside 1 .. M.
    """
    M = losses.shape[-1]
    if not 1 <= k <= M:
        raise SettingsError(f"expected between 1 and {M} winners, the number of hypotheses, found {k}")
    return losses.topk(k, dim=-1, largest=False, sorted=False).values.sum(dim=-1)


def winners_in_epoch(epoch: int, hypotheses: int, epochs_to_one: int) -> int:
    """Return the k of an epoch: M at first, then halved at equal intervals, so that it is 1 from `epochs_to_one` on.

    Two things that the thesis leaves open (section 5.3.1): halves are rounded down, and every k above 1 gets the same
    share of the epochs, up to a whole one. With M = 30 and 20 epochs: 30, 15, 7, 3 for 5 epochs each, then 1.

    Args:
        epoch: 0 for the first.
        hypotheses: M.
        epochs_to_one: how many epochs begin with a k above 1: 20 in the thesis for objects without marking, else 30.

    Raises:
        SettingsError: a number that is negative, or M is 0.
    """
    if epoch < 0 or hypotheses < 1 or epochs_to_one < 0:
        raise SettingsError(
            f"expected an epoch from 0, 1 hypothesis or more and 0 epochs or more, found {epoch}, {hypotheses} and "
            f"{epochs_to_one}"
        )
    halvings = hypotheses.bit_length() - 1
    if epoch >= epochs_to_one:
        return 1
    return hypotheses >> (epoch * halvings // epochs_to_one)


# The classifier's


def classification_loss(logit_gt: Tensor, negative_logits: Tensor) -> Tensor:
    """Return -log f(R_gt) - the sum over K of log(1 - f(R_i)) (eq. 6.15), f the sigmoid of the logits.

    It is finite for all finite logits, and exact for large ones: log(1 - f(x)) is log f(-x).

    Args:
        logit_gt: (...) at the rotation that an image was drawn at.
        negative_logits: (..., K) at rotations drawn at random.

    Returns:
        (...) summed over K, not averaged.
    """
    from torch.nn.functional import logsigmoid  # noqa: PLC0415 - recipes are read without torch

    return -logsigmoid(logit_gt) - logsigmoid(-negative_logits).sum(dim=-1)
