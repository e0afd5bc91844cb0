"""The rotations that a classifier is told are wrong for an image: random ones, and rejected candidates."""

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
