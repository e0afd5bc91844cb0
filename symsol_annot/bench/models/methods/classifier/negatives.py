"""The rotations that a classifier is told are wrong: random ones, some of them near candidates, and rejected ones."""

import math

import roma
import torch
from torch import Tensor
from torch.nn import functional


def random_rotations(shape: tuple[int, ...], rng: torch.Generator) -> Tensor:
    """Draw rotations (*shape, 3, 3), float32, uniform on SO(3): of quaternions with a uniform direction."""
    quaternions = torch.randn((*shape, 4), generator=rng, device=rng.device)
    R: Tensor = roma.unitquat_to_rotmat(functional.normalize(quaternions, dim=-1))
    return R


def hard_negatives(
    R_gt: Tensor, is_rejected: Tensor, symmetry_group: Tensor, count: int, rng: torch.Generator
) -> Tensor:
    """Draw rejected candidates (B, count, 3, 3) of each image, with repeats; random rotations where it has none.

    Args:
        R_gt: (B, 3, 3).
        is_rejected: (B, G) bool.
        symmetry_group: (G, 3, 3).
        count: how many per image.
        rng: on their device.
    """
    has_any = is_rejected.any(dim=1, keepdim=True)
    chosen = torch.multinomial((is_rejected | ~has_any).float(), count, replacement=True, generator=rng)
    rejected = R_gt[:, None] @ symmetry_group[chosen]
    return torch.where(has_any[..., None, None], rejected, random_rotations((len(R_gt), count), rng))


_NEAR_SCALE_RAD = math.radians(10.0)  # of the exponential distribution of angles to candidates
_CANDIDATES = 240  # of a larger group, so many stand for all: a circle's are a degree or two apart


def near_negatives(
    R_gt: Tensor, symmetry_group: Tensor, uniform: Tensor, count: int, rng: torch.Generator
) -> tuple[Tensor, Tensor]:
    """Draw rotations near candidates beside uniform ones, with weights by which all stand for uniform ones.

    A rotation drawn from the mixture q of both, where uniform has density 1, stands for uniform ones with 1 / q
    (importance sampling): the weighted sum over rotations is what as many uniform ones would give on average.

    Args:
        R_gt: (B, 3, 3).
        symmetry_group: (G, 3, 3); where they are to be near, R_gt g.
        uniform: (B, n, 3, 3) uniform rotations.
        count: how many to draw near candidates.
        rng: on their device.

    Returns:
        (B, n + count, 3, 3) rotations and (B, n + count) weights, whose mean is 1 on average.
    """
    group = symmetry_group[:: math.ceil(len(symmetry_group) / _CANDIDATES)]
    shape = (len(R_gt), count)
    chosen = torch.randint(len(group), shape, generator=rng, device=rng.device)
    axis = functional.normalize(torch.randn((*shape, 3), generator=rng, device=rng.device), dim=-1)
    within = 1.0 - math.exp(-math.pi / _NEAR_SCALE_RAD)  # the exponential distribution's share up to pi
    angle = -_NEAR_SCALE_RAD * torch.log1p(-within * torch.rand(shape, generator=rng, device=rng.device))
    near = R_gt[:, None] @ group[chosen] @ roma.rotvec_to_rotmat(axis * angle[..., None])
    drawn = torch.cat([uniform, near], dim=1)
    candidates = (R_gt[:, None] @ group).flatten(2)
    cosines = (torch.bmm(drawn.flatten(2), candidates.mT) - 1.0) / 2.0
    angles = torch.acos(cosines.clamp(-1.0 + 1e-7, 1.0 - 1e-7)).clamp(min=1e-3)
    haar = (1.0 - torch.cos(angles)) / math.pi  # of uniform rotations' angles
    density = (torch.exp(-angles / _NEAR_SCALE_RAD) / (_NEAR_SCALE_RAD * within) / haar).mean(-1)
    share = count / drawn.shape[1]
    return drawn, 1.0 / (1.0 - share + share * density)
