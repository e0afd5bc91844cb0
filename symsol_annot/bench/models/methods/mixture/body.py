"""What a mixture has to know of a body: its group, and the circle in it."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from symsol_annot.bench.models.methods.mixture.recipe import CIRCLE, MARKED_CIRCLE, MixtureRecipe
from symsol_annot.bench.models.networks.mixture_network import SET_SIZES
from symsol_annot.errors import SettingsError
from symsol_annot.rotations.nearest import find_circles
from symsol_annot.rotations.so3 import Rotations

_SHOWN_SHARE = 8  # a set with fewer members than the circle has steps, over this, is of an image that shows the marking


@dataclass(frozen=True, eq=False)
class Body:
    """A body's group, float32, on a model's device.

    Attributes:
        group: (G, 3, 3) the symmetries, identity first.
        axis: (3,) of its circle, in model coordinates; zeros for a group without one.
        is_directed: whether no symmetry turns the axis round.
        largest_set: the largest measure of a set: the group's order, or more where sets may fill a volume.
        few: how many members a set has at most whose image shows the marking of a body with a circle.
    """

    group: Tensor
    axis: Tensor
    is_directed: bool
    largest_set: int
    few: int

    def cpu(self) -> "Body":
        """Return it in the processor's memory."""
        return replace(self, group=self.group.cpu(), axis=self.axis.cpu())

    @property
    def set_sizes(self) -> Tensor:
        """(8,) the sizes of sets that a network chooses from, by the same factor from 1 to the largest."""
        return self.largest_set ** (torch.arange(SET_SIZES, device=self.group.device) / (SET_SIZES - 1))

    def set_size_class(self, sizes: Tensor) -> Tensor:
        """Return which of `set_sizes` is nearest to sizes (B,), by its logarithm."""
        return (sizes.float().log()[:, None] - self.set_sizes.log()).abs().argmin(dim=1)


def body_for(recipe: MixtureRecipe, symmetry_group: Rotations, device: torch.device) -> Body:
    """Return what a mixture of a recipe's structure has to know of a body.

    Args:
        recipe: names the structure.
        symmetry_group: (G, 3, 3).
        device: the model's.

    Raises:
        SettingsError: the structure needs a circle that the group has not.
    """
    group = torch.tensor(symmetry_group, dtype=torch.float32, device=device)
    circles, largest = find_circles(symmetry_group), recipe.largest_set or len(symmetry_group)
    if circles is None:
        if recipe.structure in (CIRCLE, MARKED_CIRCLE):
            raise SettingsError(
                f"structure: {recipe.structure!r} is for a body with a circle in its group, and this group is of "
                f'{len(group)} isolated rotations; take "group", or "free" for a body with a marking'
            )
        return Body(group, torch.zeros(3, device=device), is_directed=False, largest_set=largest, few=0)
    is_directed = bool((symmetry_group @ circles.axis @ circles.axis > 0).all())
    axis = torch.tensor(np.asarray(circles.axis), dtype=torch.float32, device=device)
    return Body(group, axis, is_directed, largest, circles.index.shape[1] // _SHOWN_SHARE)
